"""Swings one object, sees where it lies in the hand afterwards, and swings it once more where it slid far."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from twin_diagram.estimation.weighing import Excitation, WeighingError
from twin_diagram.runs.learning.display import HeldPicture, NothingHeld, display
from twin_diagram.runs.learning.felt_weight import Centre
from twin_diagram.runs.learning.following import follow, found_again
from twin_diagram.runs.learning.handling import Tools, hold_seen
from twin_diagram.runs.learning.held_turns import weight_felt
from twin_diagram.runs.learning.motion import NoWay
from twin_diagram.runs.learning.picking import TUNING as PICKING
from twin_diagram.runs.learning.record import SWUNG
from twin_diagram.runs.learning.shown_object import ShownObject
from twin_diagram.runs.learning.swung_log import Swung, slid_by, slipped, write_swung
from twin_diagram.runs.learning.weighing import Slipping, swing_empty, swing_held, weigh_at_rest
from twin_diagram.scenario.poses import pose


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    glances: int = 6
    """Pictures of what is held after it was swung."""

    glance: tuple[float, ...] = (0.7,)
    """Tilts of the tool at which they are taken [rad]: sides and far end show alike."""

    crept: tuple[float, float] = (0.006, 0.03)
    """By how much it may have crept meanwhile, as standard deviations [m], [rad]."""

    turned: tuple[float, float] = (0.02, 0.4)
    """By how much it may have turned where it was noticed at once, as standard deviations [m], [rad]."""

    tallest: float = 0.22
    """Height of what may stand in the other bin while things are swung [m]: a cracker box on its end."""

    beyond: float = 0.35
    """How far beyond bins and platform the hand may be swung [m]: what stands farther off, behind the arm, nobody told,
    and what is lost there no camera sees."""

    highest: float = 1.3
    """Height up to which it may be [m]: straight above an iiwa's shoulder."""

    camera: float = 0.06
    """Half of the edge of the box that stands for a camera [m]."""

    gentler: float = 0.5
    """Share of what the first swing asked of the grip, beyond what it takes at rest, that one asks after that in which
    it slid far, or turned: what was slid by was asked for once too much, by how much nobody knows."""


TUNING = Tuning()


def weigh_held(tools: Tools, shown: ShownObject, folder: Path, gentle: float = 1.0) -> float:
    """Swing what is held, keep the arm's messages in a folder, and return the mass that was first thought of [kg].

    What slid far meanwhile is swung once more, more gently, from where it lies then; kept is the swing in which it
    slid less. How far that was stands with its messages.

    Args:
        tools: of the cell.
        shown: what is held.
        folder: of its data.
        gentle: share of what may usually be asked of the grip beyond what it takes at rest.

    Raises:
        NoWay: there is no room for it.
        WeighingError: no motion is within the limits.
        NothingHeld: it was lost.
    """
    with kept_clear(tools):
        mass = weigh_at_rest(tools.model, tools.mover, tools.cell)
        shown.mass_at_rest = mass if tools.cell.opening > PICKING.empty else shown.mass_at_rest
        swung, shown.swung = _swing(tools, shown, mass, gentle)
    swung = _seen_after(tools, shown, swung)
    write_swung(folder / SWUNG, swung)
    if slid_by(swung) < 1.0:
        return mass
    shown.notes.append(f"it {_told(swung)} while it was swung, and was swung once more")
    try:
        with kept_clear(tools):
            again, motion = _swing(tools, shown, mass, gentle * TUNING.gentler)
    except (NoWay, WeighingError) as why:
        shown.notes.append(f"not swung once more: {why}")
        return mass
    seen = _seen_after(tools, shown, again)
    if seen is not again and slid_by(seen) < slid_by(swung):
        shown.swung = motion
        write_swung(folder / SWUNG, seen)
    if slid_by(seen) >= 1.0:
        shown.notes.append(f"then it {_told(seen)}")
    return mass


@contextmanager
def kept_clear(tools: Tools) -> Iterator[None]:
    """Keep what is swung clear of the other bin, which may hold more later, and cameras, and before the arm."""
    learning, mover = tools.learning, tools.mover
    low, high = (np.array(corner) for corner in learning.into_bin)
    boxes = np.array([learning.from_bin, learning.into_bin, learning.platform])
    least, most = boxes[:, 0].min(axis=0) - TUNING.beyond, boxes[:, 1].max(axis=0) + TUNING.beyond
    with ExitStack() as kept:
        # The empty hand is swung alike when one thing more stands there.
        kept.enter_context(mover.blocked(low, np.array([*high[:2], low[2] + TUNING.tallest])))
        kept.enter_context(mover.fenced(np.array([*least[:2], 0.0]), np.array([*most[:2], TUNING.highest])))
        for name in (learning.bin_camera, learning.scan_camera):
            p_WC = np.array(pose(tools.cameras[name].X_WC).translation())
            corners = p_WC + TUNING.camera * np.array(list(product((-1.0, 1.0), repeat=3)))
            mover.stand(f"camera {name}", [corners], float(p_WC[2]) - TUNING.camera)
            kept.callback(mover.stand, f"camera {name}", [], 0.0)
        yield


def _swing(tools: Tools, shown: ShownObject, mass: float, gentle: float) -> tuple[Swung, Excitation]:
    """Swing what is held; raises as `weigh_held`. Where it turns between the fingers, how it lies then is seen."""
    X_TS = np.asarray(np.linalg.inv(shown.X_ST[-1]), dtype=float)
    points = shown.followed.points
    held = X_TS, points, (shown.centre or Centre.within(points)).mean, tools.learning.weigh_seconds
    try:
        found = swing_held(tools.driven, tools.mover, tools.cell, *held, mass, gentle)
    except Slipping:
        _find_turned(tools, shown)
        raise
    if tools.cell.opening < PICKING.empty:
        raise NothingHeld("it was lost while it was swung")
    return found


def _seen_after(tools: Tools, shown: ShownObject, swung: Swung) -> Swung:
    """Return what was swung with how it crept in the hand: where it is afterwards is seen, and is where it is held."""
    try:
        X_ST = found_again(shown.followed, _glance(tools, shown), shown.X_ST[-1], TUNING.crept)
    except NoWay as why:
        shown.notes.append(f"not looked at after it was swung: {why}")
        return swung
    if X_ST is None:
        return swung
    shown.R_WT = shown.R_WT @ shown.X_ST[-1][:3, :3].T @ X_ST[:3, :3]
    shown.X_ST[-1] = X_ST
    hold_seen(tools, shown)
    return slipped(swung, np.asarray(np.linalg.inv(X_ST), dtype=float))


def _told(swung: Swung) -> str:
    return f"slid by {1e3 * swung.slip[0]:.0f} mm and {np.rad2deg(swung.slip[1]):.0f}° in the fingers"


def _glance(tools: Tools, shown: ShownObject) -> list[HeldPicture]:
    """Return a few pictures of what is held."""
    few = replace(tools.learning, frames=TUNING.glances)
    number, weight = (
        len(shown.X_ST) - 1,
        weight_felt(shown.mass_at_rest, shown.centre, shown.X_ST[-1], tools.cell.force),
    )
    return display(tools.mover, tools.cell, few, tools.robot, number, TUNING.glance, weight=weight)


def _find_turned(tools: Tools, shown: ShownObject) -> None:
    """See how what was about to slip out of the hand lies in it now; the pictures are not kept."""
    X_ST = follow(shown.followed, _glance(tools, shown), shown.X_ST[-1], TUNING.turned).X_ST[-1]
    shown.R_WT, shown.X_ST[-1] = shown.R_WT @ shown.X_ST[-1][:3, :3].T @ X_ST[:3, :3], X_ST
    hold_seen(tools, shown)


def weigh_empty(tools: Tools, shown: ShownObject, opening: float, file: Path) -> None:
    """Swing the empty hand as the object was, with the fingers as far apart, and keep the arm's messages in a file.

    Raises:
        NoWay: there is no way to where that begins.
    """
    if shown.swung is not None:
        write_swung(file, swing_empty(tools.driven, tools.mover, tools.cell, shown.swung, opening))
