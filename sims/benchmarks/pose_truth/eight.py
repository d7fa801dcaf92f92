"""Eight things on a table, of which two are alike and one is unknown to the library, before one camera."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from pose_truth import raycast, spoil
from pose_truth.things import YCB, Thing, thing
from twin_diagram.perception.depth_noise import DepthSigma
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.perception.registration.resting import resting
from twin_diagram.perception.registration.rotation import exp
from twin_diagram.scenario.depth_sheets import SHEETS

Array = npt.NDArray[np.float64]
KNOWN = 6
"""The library's objects are the first so many; the next is the last of them again, and the last is unknown."""
WORKSPACE = [[-0.4, -0.5, -0.02], [1.0, 0.8, 0.6]]


@dataclass(frozen=True)
class Scene:
    """Things that stand, and who looks at them: (thing, R_WO, p_WO), and the camera."""

    things: list[tuple[Thing, Array, Array]]
    camera: Pinhole

    @staticmethod
    def drawn(data: Path, profile: str, rng: np.random.Generator) -> Scene:
        """Return them in two rows, each turned at random about the vertical."""
        kinds = [*(thing(name, data) for name in YCB[: KNOWN - 1]), thing("can"), thing("can"), thing("mug")]
        turns = exp(rng.uniform(-np.pi, np.pi, (len(kinds), 1)) * np.array([[0.0, 0.0, 1.0]]))
        things = []
        for k, (one, turn) in enumerate(zip(kinds, turns, strict=True)):
            rest, height = resting(one.asset)[0]
            things.append((one, turn @ rest, np.array([0.18 * (k % 4), 0.2 * (k // 4), height])))
        camera = raycast.look_at(np.array([0.27, -0.8, 0.9]), np.array([0.27, 0.1, 0.05]))
        return Scene(things, replace(camera, depth_noise=DepthSigma(*SHEETS[profile])))

    def frames(
        self, profile: str, count: int, rng: np.random.Generator
    ) -> Iterator[tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]]:
        """Return so many frames, colour and depth: noise anew in each, waves those of the run."""
        picture = raycast.take(self.camera, self.things)
        waves = spoil.field(picture.depth.shape, 15.0, rng)
        for _ in range(count):
            depth, rgb = spoil.spoiled(picture, profile, rng, waves)
            yield rgb, depth
