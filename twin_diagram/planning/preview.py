"""Where the arm will be a second from now, and how sure that is: for a teleoperator, who acts on what is late."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, cast

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, EventStatus, LeafSystem

from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array

AHEAD: Final = 1.0
"""How far a preview looks ahead [s]: the round trip over a slow link, and the time that a hand takes to react."""
RATE: Final = 15.0
"""Previews that are kept and looked at when they come due [1/s]: a camera's rate, well above an arm's motions."""
SLOW: Final = 0.02
"""An arm none of whose joints is foreseen to go faster rests [rad/s, m/s]: a hundredth of what arms do at their
fastest, ten times what plans creep by at their goals."""
SETS_OFF: Final = 1.0 / 3.0
"""How far joints go at most that may set off at any time within that second, in the root mean square, of what they go
at their greatest speed: √(1/3) as they may begin at any time, √0.3 as on a way of seven joints one alone is so fast."""
CLEARLY: Final = 10.0
"""Its present speed foretells an arm where the squares of its errors are so many times smaller than the plan's [1]: of
one that something else moves, while its plan stays behind, soon far more; one for which another way was found is missed
by both, by the way foreseen for it mostly by more, and does follow its plan."""
REMEMBERED: Final = 10.0
"""Errors are averaged over this long [s]: some motions, so that those of one do not pass for all."""


@dataclass(frozen=True)
class Foresight:
    """What is remembered of two ways to foresee n joints, apart of where the arm is on its way and where it rests.

    A plan that comes to rest says nothing of what is asked next: the one is off by centimetres, the other by all of
    the next way.

    Attributes:
        counts: (2,) how many previews have come due: of an arm that rests by then, and of one that is on its way.
        squares: (2, 2, n, n) mean square of the errors of each way to foresee it, those of late counting most.
        waiting: (K, 2, n) those that are not due yet, the oldest first; NaN: there was none.
        on_way: (K,) whether they are of an arm that is on its way then.
    """

    counts: Array
    squares: Array
    waiting: Array
    on_way: Array

    @staticmethod
    def begin(n: int) -> Foresight:
        """Return that of n joints of which nothing was foreseen."""
        K = round(AHEAD * RATE)
        return Foresight(np.zeros(2), np.zeros((2, 2, n, n)), np.full((K, 2, n), np.nan), np.zeros(K))

    @property
    def better(self) -> int:
        """Which way was nearer of late: the plan's, unless that which goes on at the present speed clearly was."""
        plan, speed = self.counts @ np.trace(self.squares, axis1=2, axis2=3)
        return int(CLEARLY * speed < plan)

    def goes_on(self, foreseen: Array, back: int = 1) -> bool:
        """Return whether a plan (2, n), `foreseen` now, is on its way: since so many previews ago it moved on."""
        return bool(np.abs(foreseen[0] - self.waiting[-back, 0]).max() * RATE > back * SLOW)

    def square(self, foreseen: Array, q: Array, reach: Array | None = None) -> Array:
        """Return the mean square (n, n) of the errors of such a preview made at q (n,).

        Before one like it came due it may be off by the whole way. In which directions they are off is known as well as
        there were motions, of a second each: until there are more of these than joints, mostly by their size. An arm
        that rests may be told to go at any time: as if it had been, for a second, beside what was seen.

        Args:
            foreseen: (2, n) the preview [rad].
            q: (n,) where the arm is [rad].
            reach: (n,) how far joints go in `AHEAD` at most [rad]; None: nobody tells them to go.
        """
        kind, n = int(self.goes_on(foreseen, back=2)), len(q)  # the last preview may be of this very moment
        way = foreseen[self.better] - q
        square = self.squares[kind, self.better] if self.counts[kind] else np.outer(way, way)
        if kind == 0 and reach is not None:
            one = AHEAD * RATE
            square = (self.counts[0] * square + one * np.diag((SETS_OFF * reach) ** 2)) / (self.counts[0] + one)
        motions = min(self.counts[kind] / RATE, REMEMBERED) / AHEAD
        even = n / (n + motions)
        return np.asarray((1.0 - even) * square + even * np.trace(square) / n * np.eye(n))

    def learned(self, q: Array, foreseen: Array) -> Foresight:
        """Return it a period later: q (n,) is where the arm is, `foreseen` (2, n) joins what waits.

        What is not finite is no error. Old ones fade, see `REMEMBERED`.
        """
        waiting = np.concatenate([self.waiting[1:], foreseen[None]])
        after = replace(self, waiting=waiting, on_way=np.append(self.on_way[1:], self.goes_on(foreseen)))
        errors = q - self.waiting[0]
        if not np.isfinite(errors).all():
            return after
        kind, counts, squares = int(self.on_way[0]), self.counts.copy(), self.squares.copy()
        counts[kind] += 1
        weight = 1.0 / min(counts[kind], REMEMBERED * RATE)
        squares[kind] += weight * (errors[:, :, None] * errors[:, None, :] - squares[kind])
        return replace(after, counts=counts, squares=squares)

    def pack(self) -> Array:
        """Return it as a vector."""
        return np.concatenate([self.counts, self.squares.ravel(), self.waiting.ravel(), self.on_way])

    @staticmethod
    def unpack(vector: Array, n: int) -> Foresight:
        """Return the inverse of `pack`, of n joints."""
        ends = np.cumsum([2, 4 * n * n, round(AHEAD * RATE) * 2 * n])
        counts, squares, waiting, on_way = np.split(vector, ends)
        return Foresight(counts, squares.reshape(2, 2, n, n), waiting.reshape(-1, 2, n), on_way)


class Preview(LeafSystem):
    """Foresees the arm, and learns from each preview that comes due how far off they are.

    .. pydrake_system::

        name: Preview
        input_ports:
        - arm_state
        - covariance
        - position_planned (optional)
        - measurement_time (optional)
        output_ports:
        - position_previewed
        - preview_covariance

    Ports:
        arm_state: (2n) estimated joint angles [rad] and speeds [rad/s].
        covariance: ((2n + p)²) of [q, v, θ], row by row.
        position_planned: (n) where the plan, or the way on from its goal, is `AHEAD` from now [rad]. Not connected:
            where the arm is.
        measurement_time: (1) time of the arm's newest message [s]; before there is one nothing is learned.
        position_previewed: (n) where the arm will be `AHEAD` from now [rad]: by the plan, or moved on at the speed that
            it has, within its joints' limits, where that has clearly been nearer of late. An arm that something else
            moves follows no plan.
        preview_covariance: (n²) of that, row by row: the mean square of the errors that such previews had of late, of
            an arm that rests by then or is on its way, and what the filter is not sure of. Before one comes due, it may
            be off by the whole way; one that rests may be told to go, see `Foresight.square`.

    Rate: previews are kept at `RATE`. Latency: none.

    State: discrete: how many came due, the mean squares of errors, and the previews that are not due yet.
    """

    def __init__(self, model: Model, covariance_size: int, speed: Array | None = None) -> None:
        """Size the ports.

        Args:
            model: the arm.
            covariance_size: of the port.
            speed: (n,) of joints that are told to go at any time [rad/s]; None: nobody tells them.
        """
        super().__init__()
        self.set_name("preview")
        n = self._n = len(model.joints)
        self._lower, self._upper = model.lower, model.upper
        self._reach: Final = None if speed is None else AHEAD * speed
        self._size = round(np.sqrt(covariance_size))
        self._arm_in = self.DeclareVectorInputPort("arm_state", 2 * n)
        self._covariance_in = self.DeclareVectorInputPort("covariance", covariance_size)
        self._planned_in = self.DeclareVectorInputPort("position_planned", n)
        self._time_in = self.DeclareVectorInputPort("measurement_time", 1)
        self._state = self.DeclareDiscreteState(Foresight.begin(n).pack())
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / RATE, 0.0, self._learn)
        self.DeclareVectorOutputPort("position_previewed", n, self._calc_position)
        self.DeclareVectorOutputPort("preview_covariance", n * n, self._calc_covariance)

    def recount(self, context: Context, change: Array) -> None:
        """Count angles anew: the arm is where it was, but its angles are others by `change` (n,) [rad]."""
        kept = self._kept(context)
        context.SetDiscreteState(int(self._state), replace(kept, waiting=kept.waiting + change).pack())

    def _kept(self, context: Context) -> Foresight:
        return Foresight.unpack(cast(Array, context.get_discrete_state(int(self._state)).value()), self._n)

    def _foreseen(self, context: Context) -> Array:
        """Return where the arm will be (2, n): by the plan, and at the speed that it has."""
        q, v = cast(Array, self._arm_in.Eval(context)).reshape(2, -1)
        planned = cast(Array, self._planned_in.Eval(context)) if self._planned_in.HasValue(context) else q
        return np.stack([planned, np.clip(q + AHEAD * v, self._lower, self._upper)])

    def _learn(self, context: Context, discrete: DiscreteValues) -> EventStatus:
        if self._time_in.HasValue(context) and cast(Array, self._time_in.Eval(context))[0] < 0.0:
            return EventStatus.DidNothing()
        q = cast(Array, self._arm_in.Eval(context))[: self._n]
        discrete.set_value(int(self._state), self._kept(context).learned(q, self._foreseen(context)).pack())
        return EventStatus.Succeeded()

    def _calc_position(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._foreseen(context)[self._kept(context).better])

    def _calc_covariance(self, context: Context, output: BasicVector) -> None:
        n, q = self._n, cast(Array, self._arm_in.Eval(context))[: self._n]
        square = self._kept(context).square(self._foreseen(context), q, self._reach)
        P = cast(Array, self._covariance_in.Eval(context)).reshape(self._size, self._size)
        output.SetFromVector((square + P[:n, :n]).ravel())
