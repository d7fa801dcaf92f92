"""Parallel grippers: what of their shape and force a grasp needs; two that come along, and one's own from YAML.

Frame G is the gripper's tool frame, as in the arms that come along: origin between the finger tips, z along the
approach, y along the closing axis. The thesis's axes (x approach, y closing) are G's (z, y).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Final

import numpy as np

from twin_diagram.errors import TwinError
from twin_diagram.signals.arrays import Array

ROUNDED: Final = 1e-6
"""By which lengths may miss one another: they come from files with few digits [m]."""


class GripperError(TwinError):
    """A gripper that is not known, or whose figures cannot be."""


@dataclass(frozen=True)
class Gripper:
    """A gripper with two fingers that move together; lengths in m, in G.

    A finger is a box that carries the pad (the tip), and behind it a thicker one (the root). `root_thickness` 0: none.

    Attributes:
        name: for people and files.
        frame: the tool frame's name in the arm's description; G.
        opening_least: between the pads, closed.
        opening_most: between the pads, open.
        finger_front: z of the finger tips.
        finger_length: from the tips back to the palm.
        finger_thickness: of the tips along y, from the pad's face outwards.
        finger_width: of the tips along x.
        root_front: z from which backwards the roots begin.
        root_thickness: of the roots along y, from the pad's face outwards.
        root_width: of the roots along x.
        root_setback: how far the roots' inner faces stand behind the pads'.
        palm_size: (x, y, z) edges of the palm's box, which ends where the fingers do.
        pad_length: of the pads along z, from `pad_front` backwards.
        pad_front: z of the pads' front edge.
        pad_width: of the pads along x.
        force: with which a finger presses [N].
        friction: coefficient between pad and object that may be counted on.
    """

    name: str
    frame: str
    opening_least: float
    opening_most: float
    finger_front: float
    finger_length: float
    finger_thickness: float
    finger_width: float
    palm_size: tuple[float, float, float]
    pad_length: float
    pad_front: float
    pad_width: float
    force: float
    friction: float = 0.5
    root_front: float = 0.0
    root_thickness: float = 0.0
    root_width: float = 0.0
    root_setback: float = 0.0

    def __post_init__(self) -> None:
        """Refuse figures of no gripper."""
        for name in ("name", "frame"):
            if not isinstance(getattr(self, name), str):
                raise GripperError(f"gripper: {name} must be text, not {getattr(self, name)!r}; put it in quotes")
        numbers = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("name", "frame", "palm_size")}
        for name, value in numbers.items():
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
                raise GripperError(f"gripper {self.name}: {name} must be a finite number, not {value!r}")
        palm = self.palm_size
        if (
            not isinstance(palm, tuple)
            or len(palm) != 3
            or not all(isinstance(x, (int, float)) and np.isfinite(x) and x > 0 for x in palm)
        ):
            raise GripperError(f"gripper {self.name}: palm_size must be three positive lengths [m], not {palm}")
        for name in (
            *("opening_most", "finger_length", "finger_thickness", "finger_width"),
            *("pad_length", "pad_width", "force", "friction"),
        ):
            if not numbers[name] > 0:
                raise GripperError(f"gripper {self.name}: {name} must be positive, not {numbers[name]:g}")
        for name in ("opening_least", "root_thickness", "root_width", "root_setback"):
            if numbers[name] < 0:
                raise GripperError(f"gripper {self.name}: {name} must not be negative, not {numbers[name]:g}")
        if self.opening_least >= self.opening_most:
            raise GripperError(
                f"gripper {self.name}: opening_least {self.opening_least:g} must be below opening_most "
                f"{self.opening_most:g}"
            )
        if self.opening_most > 1.0:
            raise GripperError(
                f"gripper {self.name}: opening_most {self.opening_most:g} m is over a metre; lengths are in m"
            )
        self._check_places()

    def _check_places(self) -> None:
        """Refuse pads and roots that are not on the fingers: what lies beside a finger would count as held."""
        back, front = self.palm_front - ROUNDED, self.finger_front + ROUNDED
        fingers = (
            f"the fingers, from {self.palm_front:g} to {self.finger_front:g} m along z and {self.finger_width:g} wide"
        )
        if self.pad_back < back or self.pad_front > front or self.pad_width > self.finger_width + ROUNDED:
            raise GripperError(
                f"gripper {self.name}: pad_front, pad_length, pad_width: the pads, from {self.pad_back:g} to "
                f"{self.pad_front:g} m and {self.pad_width:g} wide, reach beyond {fingers}"
            )
        if self.root_thickness > 0.0 and not (back <= self.root_front <= front and self.root_width > 0.0):
            raise GripperError(
                f"gripper {self.name}: root_front, root_width: roots that end at {self.root_front:g} m along z and are "
                f"{self.root_width:g} wide are not on {fingers}"
            )

    @property
    def palm_front(self) -> float:
        """The palm's z where it faces the object [m]."""
        return self.finger_front - self.finger_length

    @property
    def pad_back(self) -> float:
        """The z of the pads' rear edge [m]."""
        return self.pad_front - self.pad_length

    def apart(self, travel: float) -> float:
        """Return how far the pads are apart where the fingers have come a travel together from their closed end [m].

        Pads need not touch there: those of a WSG-50 keep 5 mm.
        """
        return min(self.opening_least + travel, self.opening_most)

    def boxes(self, opening: float | None = None, retreat: float = 0.0) -> tuple[Array, Array]:
        """Return the lower and upper corners of the gripper's boxes in G, (b, 3) each [m]: tips, roots, palm.

        Args:
            opening: between the pads; None: all the way.
            retreat: how far backwards the boxes are drawn out, to hold what they sweep on a straight approach [m].
        """
        half = (self.opening_most if opening is None else opening) / 2
        parts = [(self.finger_width, 0.0, self.finger_thickness, self.palm_front, self.finger_front)]
        if self.root_thickness > 0:
            parts.append((self.root_width, self.root_setback, self.root_thickness, self.palm_front, self.root_front))
        low, high = [], []
        for width, inner, outer, back, front in parts:
            for y0, y1 in ((half + inner, half + outer), (-half - outer, -half - inner)):
                low.append((-width / 2, y0, back - retreat))
                high.append((width / 2, y1, front))
        x, y, z = self.palm_size
        low.append((-x / 2, -y / 2, self.palm_front - z - retreat))
        high.append((x / 2, y / 2, self.palm_front))
        return np.array(low), np.array(high)


PANDA_HAND: Final = Gripper(
    name="panda_hand",
    frame="panda_tcp",
    opening_least=0.0004,
    opening_most=0.0804,
    finger_front=0.009,
    finger_length=0.0454,
    finger_thickness=0.0143,
    finger_width=0.021,
    root_front=-0.012,
    root_thickness=0.0263,
    root_width=0.021,
    root_setback=0.0023,
    palm_size=(0.048, 0.208, 0.077),
    pad_length=0.021,
    pad_front=0.009,
    pad_width=0.021,
    force=70.0,
)
"""The collision boxes, stroke and effort of `models/arms/panda_hand.urdf`, taken to its frame `panda_tcp`."""

WSG50: Final = Gripper(
    name="wsg50",
    frame="wsg_tcp",
    opening_least=0.005,
    opening_most=0.115,
    finger_front=0.010,
    finger_length=0.081633,
    finger_thickness=0.015,
    finger_width=0.021,
    root_front=-0.035,
    root_thickness=0.022,
    root_width=0.030,
    root_setback=0.003,
    palm_size=(0.050, 0.146, 0.073),
    pad_length=0.045,
    pad_front=0.010,
    pad_width=0.021,
    force=80.0,
)
"""The same of `models/arms/iiwa7_wsg.urdf`, taken to its frame `wsg_tcp`."""

SHIPPED: Final = {gripper.name: gripper for gripper in (PANDA_HAND, WSG50)}
"""By name."""


def gripper_of(name: str) -> Gripper:
    """Return a gripper that comes along, or read one's own from a YAML file with `Gripper`'s fields.

    Raises:
        GripperError: no such name or file, a field that is unknown, missing or not possible; the message names it.
    """
    if name in SHIPPED:
        return SHIPPED[name]
    path = Path(name)
    if not path.is_file():
        raise GripperError(f"--gripper {name}: no such gripper or file; these come along: {', '.join(SHIPPED)}")
    import yaml

    try:
        said = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError, OSError) as error:
        raise GripperError(f"{path}: not a readable YAML file ({' '.join(str(error).split())[:200]})") from None
    if not isinstance(said, dict):
        raise GripperError(f"{path}: must hold a gripper's fields: {', '.join(f.name for f in fields(Gripper))}")
    known = {f.name for f in fields(Gripper)}
    for field in said:
        if field not in known:
            raise GripperError(f"{path}: a gripper has no field {field!r}; these are: {', '.join(sorted(known))}")
    said = {"name": path.stem, "frame": "", **said}
    if isinstance(said.get("palm_size"), list):
        said["palm_size"] = tuple(said["palm_size"])
    try:
        return Gripper(**said)
    except TypeError as error:
        missing = str(error).partition("argument")[2].lstrip("s: ")
        raise GripperError(f"{path}: the gripper lacks {missing or error}") from None
