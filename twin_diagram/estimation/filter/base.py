"""What all parts of the filter share: the arm, the tuning, the belief, its recent past, and scratch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.errors import ScenarioError
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.dynamics.link_frame import LinkFrame
from twin_diagram.estimation.dynamics.parameters import ParameterSet
from twin_diagram.estimation.dynamics.positive_definite import solve_positive
from twin_diagram.estimation.filter.belief import Belief
from twin_diagram.estimation.filter.delayed_measurements import History
from twin_diagram.estimation.filter.sensor_registry import Declared, FilterError
from twin_diagram.estimation.sensors import Instant, JointEncoder, JointState, JointVelocity, Linear, Sensor
from twin_diagram.model.model import Model
from twin_diagram.scenario import Filter
from twin_diagram.scenario.validation import check_filter
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """How far the model is followed, and how finely: chosen by hand."""

    impossible: float = 2.0
    """No joint is predicted to move faster than this many times its speed limit, or its speed where that is more."""

    longest_step: float = 0.01
    """A longer prediction is cut into steps no longer than this [s]."""


TUNING = Tuning()


class Core:
    """A filter's parts. What it knows is in `belief` and `history` alone; the rest is tuning or scratch.

    Attributes:
        terms: the arm.
        params: tuning.
        parameters: what θ means.
        belief: all that the filter knows; may be exchanged with `load`.
        declared: the further sensors.
        history: the recent past, for readings that arrive late.
        encoder, velocity: the arm's own sensors.
        joints: both together, as a message brings them.
        own: the arm's own sensors by name.
        period: of the filter [s].
        F: (N, N) scratch: derivative of the newest prediction.
        by_torque: (2n, n) of [q, v] by torque over the newest prediction; None before the first of this belief:
            the other scratch may then be of another's.
        wander: (n,) variance of the disturbance of a joint that slides, as given [N²·m²].
        creep: (n,) variance of the torque that friction may bring to joints that creep, over the newest step [N²·m²].
        step_mass: (n, n) mass matrix of the newest prediction [kg·m²].
    """

    belief: Belief
    history: History

    def __init__(self, terms: ArmTerms | Model, params: Filter) -> None:
        """Make the parts.

        Args:
            terms: the arm; of a model they are worked out.
            params: tuning.

        Raises:
            ArgumentError: something else than these.
            ScenarioError: a parameter or a rule that does not exist, or a figure that cannot be.
        """
        check_filter(params)
        if params.rule not in ("covariance", "gradient"):
            raise ScenarioError("twin.filter.rule", f"{params.rule!r} is neither 'covariance' nor 'gradient'")
        self.terms = terms = ArmTerms.of(terms)
        self.params = params
        self.parameters = ParameterSet(terms, params)
        self.encoder = JointEncoder(terms.n, params.encoder_std)
        self.velocity = JointVelocity(terms.n, params.velocity_std)
        self.joints = JointState(terms.n, params.encoder_std, params.velocity_std)
        self.own: dict[str, Sensor] = {sensor.name: sensor for sensor in (self.encoder, self.velocity, self.joints)}
        self.declared = Declared()
        self.period = 1.0 / params.rate
        self._last = LinkFrame(terms, terms.link_frame)
        self._widest = np.concatenate([np.full(terms.n, np.pi**2), (TUNING.impossible * terms.velocity_limit) ** 2])
        self.resize()

    def resize(self) -> None:
        """Make an empty belief and the scratch for it, as large as the sensors ask for."""
        n, p = self.terms.n, self.parameters.size
        self.belief = Belief(n, p, self.declared.own, self.declared.sizes)
        size = self.belief.size
        rate = self.params.rate * np.ceil(self.period / TUNING.longest_step - 1e-9)  # of steps
        self.history = History(n, p, size, int(np.ceil(self.params.history * rate)) + 2)
        self.F = np.eye(size)
        self.by_torque: Array | None = None
        self.step_mass = np.eye(n)
        self.wander: Array = np.ones(n)
        self.creep: Array = np.zeros(n)
        self.walk = self.declared.walk()

    def load(self, vector: Array, history: Array | None = None) -> None:
        """Take a belief's vector as its own (copied).

        Args:
            vector: of a `Belief` of the same sensors and parameters.
            history: of its `History`; None: late readings cannot be fused across the exchange.
        """
        self.belief.vector[:] = vector
        self.by_torque = None
        if history is not None:
            self.history.vector[:] = history
        elif self.belief.valid:
            self.history.begin(self.belief.time, self.belief.x, self.belief.P)
        else:
            self.history.clear()

    def find(self, sensor: Sensor | str) -> Sensor:
        """Return the sensor of that name, or that very model.

        Raises:
            FilterError: it was never declared.
        """
        name = sensor if isinstance(sensor, str) else sensor.name
        found = self.own.get(name) or self.declared.sensors.get(name)
        if found is None or not (isinstance(sensor, str) or found is sensor):
            known = ", ".join([*self.own, *self.declared.sensors])
            raise FilterError(f"sensor {name!r} was never declared: add it first; there are {known}")
        return found

    def linear(self, sensor: Sensor, x: Array, P: Array, back: int) -> Linear:
        """Return a sensor's model at x (N,) of covariance P (N, N), `back` steps ago."""
        if sensor.name in self.own or not self.history.count:
            return Linear(sensor.reading(x), sensor.jacobian(x), sensor.noise(x))
        still, by_state, noise = self.history.motion(back)
        noise = noise + self._swing_noise(x, P, by_state, noise)
        steady, acceleration = self.history.steady(back), still + by_state @ x
        return sensor.linear(Instant(x, self.terms.n, self.belief.p, acceleration, by_state, noise, P, steady))

    def _swing_noise(self, x: Array, P: Array, by_state: Array, noise: Array) -> Array | float:
        """Return (n, n) what an unknown payload's own inertia adds to the accelerations' error: δM δv̇, of second order.

        Both come from one cause, hence three times the product of their variances.
        """
        if self.parameters.payload is None:
            return 0.0
        n = self.terms.n
        mass = 3 * n + self.parameters.payload.start
        J = self._last.jacobian(x[:n])[2][3:]
        swing = solve_positive(self._mass(), J.T @ J)
        return 3.0 * float(P[mass, mass]) * (swing @ (by_state @ P @ by_state.T + noise) @ swing.T)

    def _mass(self) -> Array:
        """Return the mass matrix (n, n) of the newest prediction, or of the state before the first."""
        if self.by_torque is not None:
            return self.step_mass
        self.terms.set_payload(self.parameters.payload_of(self.belief.model))
        return self.terms.mass_matrix(self.terms.true_position(self.belief.q))

    def bound(self) -> None:
        """Bound the covariance: no angle is less certain than a turn, no speed than twice its limit, even blind.

        Scaling rows and columns alike keeps it positive.
        """
        belief, n = self.belief, self.terms.n
        variance = belief.P.diagonal()[: 2 * n]
        if np.all(variance <= self._widest):
            return
        scale = np.sqrt(np.minimum(self._widest / np.maximum(variance, np.finfo(float).tiny), 1.0))
        belief.P[: 2 * n, :] *= scale[:, None]
        belief.P[:, : 2 * n] *= scale
