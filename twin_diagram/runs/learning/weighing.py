"""Swings what is held, and the empty hand, and tells what the torques and the shape say of its inertia."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pydrake.math import RigidTransform

from twin_diagram.assets.building.backends import ColouredSurface
from twin_diagram.assets.building.measured import MeasuredInertia
from twin_diagram.estimation.weighing import (
    ArmDoubt,
    EmptyRun,
    Excitation,
    ExcitationPlan,
    Grip,
    LoadedRun,
    Shape,
    ShapePrior,
    WeighingError,
    feed_forward,
    optimise_excitation,
    weigh,
    weight_torque,
)
from twin_diagram.logs.measured_log import Log
from twin_diagram.model.model import Model
from twin_diagram.runs.learning.bearing import holding
from twin_diagram.runs.learning.cell import TUNING as CELL
from twin_diagram.runs.learning.cell import Cell, Recording
from twin_diagram.runs.learning.felt_weight import first_mass
from twin_diagram.runs.learning.motion import Mover, NoWay
from twin_diagram.runs.learning.picking import go
from twin_diagram.runs.learning.swing_room import first_with_room, goals_for_swinging
from twin_diagram.runs.learning.swung_log import Swung, way_slipped
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    friction: float = 0.3
    """Between pad and object that the swinging counts on."""

    share: float = 0.25
    """Of what the grip carries by that friction, the swinging asks for: with 0.5 a tapered flask, which the pads touch
    along a slanted strip, was lost."""

    beyond_rest: float = 1.5
    """How many times what an object takes of the grip at rest the swinging may take, where that is more: it was turned
    to all sides before and has not fallen."""

    most: float = 2.5
    """The same share at most: friction on the pads is up to 0.9."""

    pad_half: float = 0.0105
    """Half of the pads' width [m]."""

    pad: tuple[float, float] = (-0.035, 0.010)
    """z of the pads' ends in the tool's frame [m]."""

    pressed: tuple[float, ...] = (0.001, 0.008)
    """Points this near to a pad's face are pressed by it [m]: as far as soft pads give way, and depth errs. Of what is
    round that is a strip, slanted where it is held so. The second one counts where there are too few."""

    few: int = 12
    """Points that make a patch."""

    least: float = 0.003
    """Edge of the smallest patch [m]."""

    harmonics: int = 15
    """Of the motion: 1.5 Hz at the most in 10 s."""

    clear: float = 0.02
    """Kept from everything while swinging [m], …"""

    bends: float = 0.02
    """… and so much more for each kilogram held [m/kg]: with 1.42 kg an arm that neither bore it nor was told what
    torques its swing takes left its path by 23 mm, and its wrist met a bin's wall. With both it leaves it by 3 mm; less
    was not tried."""

    turning: float = 0.0005
    """By which fingers move when what they hold turns between them [m]: what is round goes 2 mm before it is lost."""

    starts: int = 3
    """Of the search for the best motion: a long box's, from one, told the reference object's worst moment to 19 %
    instead of 16."""

    steps: int = 320
    """Of it, from the best of them: with half of them that was 16 % instead of 14. Some 15 s of a core."""

    rest: float = 0.3
    """Before and after [s]."""

    slipping: float = 0.25
    """Share of a slip by which the pose in its middle may be off, as a standard deviation: slips are not even."""

    creep: tuple[float, float] = (1e-4, 5e-4)
    """By how much it may move in the hand while it is swung where no slip was seen [m], [rad]."""

    mass: float = 0.001
    """By what held objects seem heavier or lighter than they are, beside what noise does: of 17, 0.9 g [kg]."""


TUNING = Tuning()


class Slipping(WeighingError):
    """What is held turns in the hand while it is swung."""


def weigh_at_rest(model: Model, mover: Mover, cell: Cell) -> float:
    """Go to where there is room to swing what is held, and return about how heavy it is [kg]; see `first_mass`.

    Raises:
        NoWay: no such place is reached.
    """
    for goals in goals_for_swinging(mover, cell.commanded):
        go(cell, mover.timed(mover.path(cell.commanded, goals)))
        return first_mass(model, cell)
    raise NoWay("no place to weigh it is reached")


def grip_on(points_T: Array, opening: float, force: float) -> Grip:
    """Return what the pads hold with, by how much of them the object covers.

    Args:
        points_T: (N, 3) of the object's surface in the tool's frame [m].
        opening: between the pads [m].
        force: with which each presses [N].
    """
    x, z = points_T[:, 0], points_T[:, 2]
    under = (np.abs(x) < TUNING.pad_half) & (z > TUNING.pad[0]) & (z < TUNING.pad[1])
    off = np.abs(np.abs(points_T[:, 1]) - 0.5 * opening)
    edges = np.array([2.0 * TUNING.pad_half, TUNING.pad[1] - TUNING.pad[0]])
    middle = np.array([0.0, 0.5 * (TUNING.pad[0] + TUNING.pad[1])])
    for reach in TUNING.pressed:
        patch = points_T[under & (off < reach)][:, [0, 2]]
        if len(patch) >= TUNING.few:
            # How wide it is at one height, how long at one side: an even rectangle's edges are √12 standard deviations.
            spread = np.linalg.inv(np.cov(patch.T) + TUNING.least**2 / 12.0 * np.eye(2))
            edges, middle = np.minimum(np.sqrt(12.0 / np.diag(spread)), edges), patch.mean(axis=0)
            break
    centre = (float(middle[0]), 0.0, float(middle[1]))
    return Grip(force, TUNING.friction, float(edges[0]), float(edges[1]), centre, TUNING.share)


def best_motion(
    model: Model,
    mover: Mover,
    posture: Array,
    X_TS: Array,
    points_S: Array,
    p_SO: Array,
    cell: Cell,
    seconds: float,
    mass: float,
    gentle: float = 1.0,
) -> Excitation:
    """Return the motion that tells most of an object, as far as it was seen.

    Args:
        model: the arm with its rotors (motor side), whose motors' torques are limited.
        mover: knows what is held.
        posture: (n,) about which it swings [rad].
        X_TS: (4, 4) of the object's S in the tool.
        points_S: (N, 3) of its surface [m]: the box about them stands for its shape.
        p_SO: (3,) where its centre of mass is thought to be [m].
        cell: whose fingers hold it.
        seconds: length of the motion [s].
        mass: that it is taken to have [kg].
        gentle: see `share_of`.

    Raises:
        WeighingError: no motion is within the limits.
    """
    low, high = points_S.min(axis=0), points_S.max(axis=0)
    X_TO = placed(X_TS, p_SO)
    grip = grip_on(points_S @ X_TS[:3, :3].T + X_TS[:3, 3], cell.apart, cell.force)
    kept = TUNING.clear + TUNING.bends * mass
    return optimise_excitation(
        model,
        RigidTransform(X_TO),
        Shape.box(high - low).even(mass),
        posture,
        grip=replace(grip, share=share_of(grip, mass, X_TO[:3, 3], gentle)),
        clear=lambda q: np.asarray((mover.room(q, kept) >= 0.0).all(axis=1)),
        plan=ExcitationPlan(period=seconds, harmonics=TUNING.harmonics, starts=TUNING.starts, steps=TUNING.steps),
        room=lambda q: mover.room(q, kept),
    )


def share_of(grip: Grip, mass: float, centre_T: Array, gentle: float = 1.0) -> float:
    """Return the share of what a grip carries that swinging may ask for, never less than what is asked of it at rest.

    Args:
        grip: that holds it.
        mass: of what hangs in it [kg], the tool pointing down.
        centre_T: (3,) its centre of mass in the tool's frame [m].
        gentle: share of what may usually be asked beyond what it takes at rest.
    """
    force = np.array([0.0, 0.0, 9.81 * mass])
    wrench = np.concatenate([force, np.cross(centre_T - np.array(grip.centre), force)])
    at_rest = float(replace(grip, share=1.0).use(wrench[None])[0])
    beyond = 1.0 + gentle * (TUNING.beyond_rest - 1.0)
    return float(np.clip(beyond * at_rest, gentle * TUNING.share, TUNING.most))


def swing_held(
    driven: Model,
    mover: Mover,
    cell: Cell,
    X_TS: Array,
    points_S: Array,
    p_SO: Array,
    seconds: float,
    mass: float,
    gentle: float = 1.0,
) -> tuple[Swung, Excitation]:
    """Swing what is held about where the arm is, or another posture with room; return the arm's messages, the motion.

    Args:
        driven: the arm with its rotors (motor side).
        mover: knows what is held.
        cell: whose arm holds it.
        X_TS: (4, 4) of the object's S in the tool.
        points_S: (N, 3) of its surface [m].
        p_SO: (3,) where its centre of mass is thought to be [m].
        seconds: length of the motion [s].
        mass: of `first_mass` [kg].
        gentle: see `share_of`.

    Raises:
        NoWay: there is no way to where it begins.
        WeighingError: no motion is within the limits.
    """

    def search(posture: Array) -> Excitation:
        return best_motion(driven, mover, posture, X_TS, points_S, p_SO, cell, seconds, mass, gentle)

    motion = first_with_room(mover, cell.commanded, search)
    cell.borne.tell(holding(driven, mass, placed(X_TS, p_SO)[:3, 3]), cell.time)
    go(cell, mover.timed(mover.path(cell.commanded, motion.posture[None])))
    noted = list[tuple[float, float]]()
    low, high = points_S.min(axis=0), points_S.max(axis=0)
    added = torques_of(driven, motion, placed(X_TS, p_SO), Shape.box(high - low).even(mass))
    log = swing(cell, motion, driven.joints, "loaded", noted, added)
    return Swung(log, cell.fingers, X_TS, way=way_slipped(log.time, np.array(noted))), motion


def placed(X_TS: Array, p_SO: Array) -> Array:
    """Return X_TO (4, 4): an object's axes are those of S (4, 4) in the tool, its origin a place (3,) in S [m]."""
    X_TO = X_TS.copy()
    X_TO[:3, 3] = X_TS[:3, :3] @ p_SO + X_TS[:3, 3]
    return X_TO


def torques_of(driven: Model, motion: Excitation, X_TO: Array, parameters: Array) -> Array:
    """Return torques (M, n) with which the driver follows a motion, one a tick while torques are recorded [N·m].

    By its spring alone an iiwa's leaves a fast swing by up to 9 cm. What holds the object up is left out: it is borne
    before and after, too.

    Args:
        driven: the arm with its rotors (motor side).
        motion: that is to be followed.
        X_TO: (4, 4) of the object in the tool.
        parameters: (10,) that it is thought to have there; zeros: the hand is empty.
    """
    q, v, a = motion.at(_times(motion))
    there = RigidTransform(X_TO)
    return feed_forward(driven, there, parameters, (q, v, a)) - weight_torque(driven, there, parameters, q)


def _times(motion: Excitation) -> Array:
    """Return when commands of a motion are due [s]."""
    return np.arange(0.0, motion.harmonics.period + 1e-9, CELL.weighed_tick)


def swing_empty(driven: Model, mover: Mover, cell: Cell, motion: Excitation, opening: float) -> Swung:
    """Swing the empty hand as what was held was swung, its fingers as far apart.

    Raises:
        NoWay: there is no way to where that began.
    """
    go(cell, mover.timed(mover.path(cell.commanded, motion.posture[None])))
    cell.grip(opening / cell.widest)  # not before: the fingers may be beside what was just set down
    added = torques_of(driven, motion, np.eye(4), np.zeros(10))
    swung = Swung(swing(cell, motion, driven.joints, "empty", torque=added), cell.fingers, np.eye(4))
    cell.grip(1.0)
    return swung


def swing(
    cell: Cell,
    motion: Excitation,
    joints: tuple[str, ...],
    source: str,
    noted: list[tuple[float, float]] | None = None,
    torque: Array | None = None,
) -> Log:
    """Go along a motion and return the arm's messages on the way.

    Args:
        cell: whose arm goes.
        motion: along which.
        joints: names of the arm's.
        source: what the log is called.
        noted: takes times, and the fingers' opening then [s], [m], where they hold something, which may turn between
            them; None: they hold nothing.
        torque: (M, n) of `torques_of`; None: the driver's spring alone follows.

    Raises:
        Slipping: the fingers come nearer to each other, or are pushed apart: what they hold turns. The arm is at rest.
    """
    # Each command lies on the motion: between two of them, every other one would lie on their chord, the arm's
    # acceleration would jump to and fro, and messages would show one side of that alone.
    times = _times(motion)
    q = motion.at(times)[0]
    opening = cell.opening

    def watch(now: float) -> None:
        if noted is None:
            return
        noted.append((cell.time, cell.opening))
        if abs(noted[-1][1] - opening) > TUNING.turning:
            raise Slipping("it turns between the fingers when it is swung; grip elsewhere")

    with cell.recording() as messages:
        cell.wait(TUNING.rest)
        try:
            cell.follow(times, q, watch, torque)
        except Slipping:
            cell.brake()
            raise
        cell.wait(TUNING.rest)
    return log_of(messages, joints, source)


def log_of(messages: Recording, joints: tuple[str, ...], source: str) -> Log:
    """Return messages as a log, each once."""
    time = np.array(messages.time)
    new = np.concatenate([[True], np.diff(time) > 1e-9])
    return Log(
        time[new],
        joints,
        np.array(messages.position)[new],
        velocity=np.array(messages.velocity)[new],
        torque=np.array(messages.torque)[new],
        source=source,
    )


def inertia_of(model: Model, swung: Swung, empty: Swung | None, surface: ColouredSurface) -> MeasuredInertia:
    """Return what torques and shape say of an object's inertia, in S.

    Raises:
        WeighingError: logs or a surface that tell nothing.
    """
    vertices = surface.corners.reshape(-1, 3)
    faces = np.arange(len(vertices)).reshape(-1, 3)
    prior = ShapePrior(Shape.of_mesh(vertices, faces))
    loaded = LoadedRun(swung.log, RigidTransform(swung.X_TS), swung.fingers, swung.way)
    runs = [] if empty is None else [EmptyRun(empty.log, empty.fingers)]
    doubt = ArmDoubt.of_side("link" if model.arm.link_side else "motor")
    p, r = np.hypot(doubt.pose, TUNING.slipping * np.array(swung.slip)).tolist()
    along, about = np.hypot(TUNING.creep, swung.slip).tolist()
    doubt = replace(doubt, pose=(p, r), creep=(along, about), mass=TUNING.mass)
    found = weigh(model, [loaded], runs, prior, doubt=doubt)
    if not (np.isfinite(found.mass) and found.mass > 0.0):
        raise WeighingError(f"the torques tell a mass of {found.mass:g} kg")
    return found.measured()
