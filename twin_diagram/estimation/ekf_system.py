"""The adaptive EKF as a LeafSystem: a thin shell around `Ekf`."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, EventStatus, LeafSystem

from twin_diagram.estimation.arm_terms import ArmTerms
from twin_diagram.estimation.belief import HEADER, Belief, Entry
from twin_diagram.estimation.ekf import Ekf
from twin_diagram.model import Model
from twin_diagram.scenario import Filter
from twin_diagram.signals import Array
from twin_diagram.timing import timed


class AdaptiveEkf(LeafSystem):
    """Estimates the arm's state and the parameters that the model was not told of.

    .. pydrake_system::

        name: AdaptiveEkf
        input_ports:
        - position_measured
        - velocity_estimated
        - torque_measured
        - measurement_time
        output_ports:
        - arm_state
        - parameters
        - covariance
        - innovation
        - nis

    Rate: `Filter.rate`, a periodic discrete update that reads its inputs as they are before other updates of the same
    instant. Latency: `arm_state` none, it is carried on from the newest message to the present (by 20 ms at most,
    then it is held); the other outputs are as of the newest message's measurement time.

    Inputs: joint positions (n) [rad], velocities (n) [rad/s], motor torques (n) [N·m, joint side], time of that message
    (1) [s], negative (`NEVER`) before the first. A message that is not newer than the last is not used again; NaN,
    infinities and absurd values are refused and counted. Nothing that arrives can spoil the state.

    Outputs: `arm_state` x̂ = [q (n) rad, v (n) rad/s], `home` before the first message; `parameters` θ̂ (p), see
    `Ekf.parameters`, for a payload its mass [kg] and first moment [kg·m] in the last link's frame; `covariance` of
    [q, v, θ], (2n + p)² numbers, row by row; `innovation` (n), of the velocities, as joint torque and whitened: about
    standard normal per joint; `nis` (1), normalised innovation squared of positions and velocities, 2n on average.
    """

    def __init__(self, model: Model | ArmTerms, params: Filter, home: Array | None = None) -> None:
        """Declares ports and state.

        Args:
            model: the twin's model, or the terms of any arm.
            params: tuning.
            home: (n,) joint angles that are reported before the first message [rad]; zeros where None.
        """
        super().__init__()
        self.ekf = Ekf(model if isinstance(model, ArmTerms) else ArmTerms.from_model(model), params)
        ekf, n, p = self.ekf, self.ekf.terms.n, self.ekf.parameters.size
        self._view = Belief(n, p)
        self._inputs = [
            self.DeclareVectorInputPort(name, size)
            for name, size in (
                ("position_measured", n),
                ("velocity_estimated", n),
                ("torque_measured", n),
                ("measurement_time", 1),
            )
        ]
        start = Belief(n, p)
        if home is not None:
            start.q[:] = home
        start.theta[:] = ekf.parameters.mean
        # Before the first message all is possible within the joints' speed limits and one turn.
        start.P[: 2 * n, : 2 * n] = np.diag(np.concatenate([np.full(n, np.pi**2), ekf.terms.velocity_limit**2]))
        start.P[3 * n :, 3 * n :] = ekf.parameters.covariance
        state = self.DeclareDiscreteState(start.vector)
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / params.rate, 0.0, self._update)
        for name, size, calc in (
            ("arm_state", 2 * n, self._calc_state),
            ("parameters", p, self._calc_parameters),
            ("covariance", (2 * n + p) ** 2, self._calc_covariance),
            ("innovation", n, self._calc_innovation),
            ("nis", 1, self._calc_nis),
        ):
            known = {self.discrete_state_ticket(state)} | ({self.time_ticket()} if name == "arm_state" else set())
            self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc=known)

    @staticmethod
    def of_plant(
        plant: MultibodyPlant, joints: list[str], params: Filter, tool_frame: str | None = None
    ) -> AdaptiveEkf:
        """A filter for n joints of any finalized plant on a fixed base, without a `Model`."""
        return AdaptiveEkf(ArmTerms(plant, joints, tool_frame=tool_frame), params)

    def belief(self, context: Context) -> Belief:
        """A copy of all that the filter knows, its counters included."""
        belief = Belief(self._view.n, self._view.p)
        belief.vector[:] = context.get_discrete_state_vector().value()
        return belief

    def counters(self, context: Context) -> dict[str, int]:
        """How many messages were accepted, refused and so on: see `belief.Entry`."""
        header = context.get_discrete_state_vector().value()[:HEADER]
        return {entry.name.lower(): int(header[entry]) for entry in Entry if entry >= Entry.ACCEPTED}

    @timed("AdaptiveEkf")
    def _update(self, context: Context, discrete: DiscreteValues) -> EventStatus:
        q, v, tau, t = (cast(Array, port.Eval(context)) for port in self._inputs)
        ekf = self.ekf
        ekf.load(cast(Array, context.get_discrete_state_vector().value()))
        ekf.observe(q, v, tau, float(t[0]))
        discrete.set_value(ekf.belief.vector)
        return EventStatus.Succeeded()

    def _of(self, context: Context) -> Belief:
        self._view.vector[:] = context.get_discrete_state_vector().value()
        return self._view

    def _calc_state(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(cast(Any, self._of(context).state_at(context.get_time())))

    def _calc_parameters(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._of(context).theta)

    def _calc_covariance(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(cast(Any, self._of(context).outside_covariance().ravel()))

    def _calc_innovation(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._of(context).innovation)

    def _calc_nis(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._of(context).header[Entry.NIS : Entry.NIS + 1])
