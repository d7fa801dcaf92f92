"""Feels where the weight of what is held pulls, while the last joint turns it before the camera.

Held in the middle of its shape, what is loaded to one side hangs beside the pads and turns between them. As the tool
leans and its last joint turns, that joint carries the weight's moment about the tool's axis, once to either side in a
full turn: its amplitude tells how far beside the axis the centre of mass is. What bias and dry friction add stays the
same along a turn and drops out. Along the axis torques of one turn tell nothing; there the middle of the shape stands.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from pydrake.math import RigidTransform

from twin_diagram.estimation.weighing.held import Held
from twin_diagram.model.model import Model
from twin_diagram.runs.learning.bearing import holding
from twin_diagram.runs.learning.cell import Cell
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    ends: float = 0.12
    """Share of a turn at either end that is left out: the joint speeds up and slows down there."""

    off: float = 0.25
    """How far a centre of mass may be off the middle of its shape, as a share of the size: one standard deviation."""

    ripple: float = 0.02
    """Of a torque beside its white noise, one and the same along a turn [N·m]: what cables do, and what the arm's own
    weight is off by. With 1 kg that is 3 mm; with 0.1 kg hardly anything is told."""

    heaviest: float = 2.5
    """What a weighing at rest may say at most [kg]."""

    rest: float = 0.3
    """That it takes [s]."""


TUNING = Tuning()


@dataclass
class Felt:
    """What an arm's joints felt, tick by tick, as it turned what it holds in one grasp.

    Attributes:
        q: (n,) each, as measured [rad].
        torque: (n,) each, as measured [N·m].
        at: time since the begin of its turn, each [s].
    """

    q: list[Array] = field(default_factory=list)
    torque: list[Array] = field(default_factory=list)
    at: list[float] = field(default_factory=list)

    def note(self, cell: Cell, now: float) -> None:
        """Take what the joints feel at a time since the begin of a turn [s]."""
        self.q.append(cell.q)
        self.torque.append(cell.torque)
        self.at.append(now)

    def turns(self) -> list[slice]:
        """Return the even part of each turn."""
        begins = [0, *(1 + np.flatnonzero(np.diff(self.at) < 0.0)).tolist(), len(self.at)]
        cut = [round(TUNING.ends * (end - begin)) for begin, end in pairwise(begins)]
        return [slice(b + c, e - c) for (b, e), c in zip(pairwise(begins), cut, strict=True) if c]


@dataclass(frozen=True)
class Centre:
    """Where a centre of mass is thought to be, in the object's S: the mean (3,) [m] and its covariance (3, 3)."""

    mean: Array
    covariance: Array

    @staticmethod
    def within(points: Array) -> Centre:
        """Return what points (N, 3) of a surface alone say: about in their middle."""
        low, high = points.min(axis=0), points.max(axis=0)
        return Centre(0.5 * (low + high), np.diag(np.maximum(TUNING.off * (high - low), 1e-4) ** 2))


def first_mass(model: Model, cell: Cell) -> float:
    """Return about how heavy what is held is, by the torques of the arm at rest [kg].

    All joints' torques beyond the arm's own, over the levers at which the tool hangs: what is held hangs near it.
    """
    q = cell.q
    with cell.recording() as messages:
        cell.wait(TUNING.rest)
    taken = np.mean(np.array(messages.torque), axis=0)
    own = model.inverse_dynamics(q[None], np.zeros((1, len(q))), np.zeros((1, len(q))))[0]
    J = np.asarray(model.tool_jacobian(q))[3:]  # linear, in W
    lever = -9.81 * J[2]  # torque of gravity on a kilogram at the tool
    off = own - taken
    return float(np.clip(lever @ off / max(float(lever @ lever), 1e-9), 0.05, TUNING.heaviest))


def bear(model: Model, driven: Model, cell: Cell, points_T: Array) -> None:
    """Weigh what was just taken at rest, and have the driver bear it from here on.

    Args:
        model: of the arm as its torques are measured.
        driven: of it with its rotors, as its motors drive it.
        cell: whose hand holds it.
        points_T: (N, 3) of it in the tool's frame [m]: its weight is taken to be in the middle of the box about them.
    """
    middle = 0.5 * (points_T.min(axis=0) + points_T.max(axis=0))
    cell.borne.tell(holding(driven, first_mass(model, cell), middle), cell.time)


def centre_felt(model: Model, felt: Felt, mass: float, X_TS: Array, before: Centre) -> Centre:
    """Return where the centre of mass of what is held is, by what was felt in the turns of one grasp.

    Args:
        model: of the arm as its torques are measured.
        felt: in these turns.
        mass: of what is held [kg].
        X_TS: (4, 4) the object's S in the tool.
        before: what was thought.
    """
    turns = felt.turns()
    if not turns:
        return before
    # What is left of the last joint's torque, turn by turn, once all that is even along a turn is taken out.
    rows, rest = (np.concatenate(part) for part in zip(*(_beyond(model, felt, one) for one in turns), strict=True))
    by_centre = mass * rows[:, 1:] @ X_TS[:3, :3]
    rest = rest - mass * (rows[:, 0] + rows[:, 1:] @ X_TS[:3, 3]) - by_centre @ before.mean
    information, step = np.linalg.inv(before.covariance), np.zeros(3)
    found = before.covariance
    for _ in range(2):
        weight = 1.0 / (float(np.var(rest - by_centre @ step)) + len(rest) / len(turns) * TUNING.ripple**2)
        found = np.asarray(np.linalg.inv(information + weight * by_centre.T @ by_centre), dtype=float)
        step = found @ (weight * by_centre.T @ rest)
    return Centre(before.mean + step, found)


def _beyond(model: Model, felt: Felt, turn: slice) -> tuple[Array, Array]:
    """Return (N, 4) torque of the last joint per mass and mass times centre, and what is felt beyond the arm's own."""
    q, torque = np.array(felt.q[turn]), np.array(felt.torque[turn])
    still = np.zeros_like(q)
    held = Held.in_tool(model, RigidTransform())
    own = model.inverse_dynamics(q, still, still)[:, held.rows[-1]]
    rows = held.regressor(model, q, still, still)[:, -1, :4]
    rest = torque[:, held.rows[-1]] - own
    return rows - rows.mean(axis=0), rest - rest.mean()
