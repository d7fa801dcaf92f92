"""Remembers where everything was when colours and depth were taken, which real cameras do not do at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER

Captured = Callable[[Array, Array, float], None]
"""Takes the states (nx) of colours and of depth, and the time of a capture [s]."""


class ExposureShutter(LeafSystem):
    """Remembers the states in which the camera last took colours and depth.

    .. pydrake_system::

        name: ExposureShutter
        input_ports:
        - state
        output_ports:
        - colour_state
        - depth_state
        - capture_time

    Colours are taken at k / rate, depth `delay` earlier; both stand on `colour_state` and `depth_state` (nx each), as
    the input had them then, from k / rate + latency on, with the colours' `capture_time` (1) [s], `NEVER` before the
    first. Depth of the first frame is that of the start.
    """

    def __init__(
        self,
        start: Array,
        rate: float,
        latency: float,
        delay: float = 0.0,
        stops: float | None = None,
        captured: Captured | None = None,
    ) -> None:
        """Build a shutter.

        Args:
            start: (nx,) shown before the first capture.
            rate: captures per second [1/s].
            latency: less than the time between captures [s].
            delay: at most the time between captures [s].
            stops: nothing is captured from then on [s]; None: it goes on.
            captured: is told of each capture, long before it is shown: the two states and the time [s].
        """
        super().__init__()
        self._captured = captured
        self._stops = np.inf if stops is None else stops
        nx = len(start)
        self._delayed = delay > 0.0
        self._state = self.DeclareVectorInputPort("state", nx)
        self._early = self.DeclareDiscreteState(start)
        self._taken = [self.DeclareDiscreteState(x) for x in (start, start, [NEVER])]
        self._shown = [self.DeclareDiscreteState(x) for x in (start, start, [NEVER])]
        period = 1.0 / rate
        if self._delayed:
            self.DeclarePeriodicDiscreteUpdateEvent(period, period - delay, self._before)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._capture)
        self.DeclarePeriodicDiscreteUpdateEvent(period, latency, self._deliver)
        for name, size, index in zip(
            ("colour_state", "depth_state", "capture_time"), (nx, nx, 1), self._shown, strict=True
        ):

            def calc(context: Context, output: BasicVector, index: int = index) -> None:
                output.SetFromVector(context.get_discrete_state(index).value())

            self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc={self.discrete_state_ticket(index)})

    def _before(self, context: Context, discrete: DiscreteValues) -> None:
        discrete.set_value(self._early, self._state.Eval(context))

    def _capture(self, context: Context, discrete: DiscreteValues) -> None:
        if context.get_time() >= self._stops:
            return
        now = self._state.Eval(context)
        early = context.get_discrete_state(self._early).value() if self._delayed else now
        for index, value in zip(self._taken, (now, early, [context.get_time()]), strict=True):
            discrete.set_value(index, value)
        if self._captured is not None:
            self._captured(now, early, context.get_time())

    def _deliver(self, context: Context, discrete: DiscreteValues) -> None:
        for taken, shown in zip(self._taken, self._shown, strict=True):
            discrete.set_value(shown, context.get_discrete_state(taken).value())
