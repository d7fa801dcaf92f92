"""The terms of an arm's equation of motion that a filter needs, on any Drake plant.

    M(q) v̇ + b(q, v) + f(q, v) = τ + d        (Hybrid Reality Twins, section 2.4, with friction f and a disturbance d)

b holds Coriolis, centrifugal, gravity and viscous terms and the smooth torque of the model's effects; f is dry
friction, which jumps where v changes sign and is therefore kept apart for the implicit step: the terms give its
bounds alone. τ is the motors' torque on the joints' side. The payload that the filter learns enters as spatial
inertia of the last link, so that M, b and every derivative hold it without further formulas.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable, MultibodyForces, PrismaticJoint, SpatialInertia, UnitInertia
from pydrake.systems.framework import Context

from twin_diagram.errors import ModelError, expect
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Laws:
    """What a model's effects add to the rigid arm, for one sample at a time.

    Attributes:
        load: (q, v, τ) → (n,) smooth torque that the motors must give beyond the rigid arm's at zero acceleration
            [N·m].
        dry: (q, v, τ) → (n,), (n,) bounds of dry friction against positive and against negative motion [N·m].
        applied: (τ) → (n,) torque that reaches the joints when τ is measured [N·m].
        true_position: (q) → (n,) joint positions when q is measured [rad].
    """

    load: Callable[[Array, Array, Array], Array] | None = None
    dry: Callable[[Array, Array, Array], tuple[Array, Array]] | None = None
    applied: Callable[[Array], Array] | None = None
    true_position: Callable[[Array], Array] | None = None


@dataclass(frozen=True)
class Tuning:
    """What stands in where a model names none: chosen by hand, generous on purpose."""

    brisk: float = 10.0
    """Where the model names no effort limit: enough for twice the largest weight and for this acceleration [rad/s²]."""

    largest_com: float = 0.5
    """A payload's centre lies within this distance of the last link's origin [m], or `beyond_tool` times the tool's,
    where that is more; one that is said to lie farther off counts as there."""

    beyond_tool: float = 2.0
    """Times the tool's distance: large arms carry what is farther off."""


TUNING = Tuning()

_EYE: Final = np.eye(3)
"""Not to be changed."""
_LEAST_MASS: Final = float(np.finfo(float).tiny)
"""Of the last link with its payload [kg]: what is divided by it stays finite."""


class ArmTerms:
    """M, b, f and their derivatives for n joints of a plant whose other joints are held.

    It keeps one plant Context as scratch: each call sets all that it depends on.

    Attributes:
        n: number of joints.
        prismatic: (n,) which of them are; what is theirs is in m and N.
        velocity_limit, effort_limit: (n,) from the plant; where it names none, what `assumptions` says [rad/s], [N·m].
        damping: (n,) [N·m·s/rad] of the joints in the plant itself; part of b, made implicit in the step.
        link_name, link_frame: of the last link, which carries the payload.
        tool: (3,) p of the tool frame in the last link [m]: where a payload is expected.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        joints: Sequence[str],
        *,
        tool_frame: str | None = None,
        laws: Laws | None = None,
        context: Context | None = None,
    ) -> None:
        """Wrap a plant.

        Args:
            plant: finalized; joints of one degree of freedom each, on a fixed base.
            joints: the n joints in order from the base; `model::joint` where several models have one of that name.
            tool_frame: where a payload is expected; the last link's own origin where None.
            laws: what the model's effects add.
            context: of the plant, with its parameters set; copied. The plant's default where None.

        Raises:
            ModelError: a plant that is not finalized, a name that it does not have, or a joint of several degrees of
                freedom.
        """
        expect(plant, MultibodyPlant, "plant", "a MultibodyPlant (of a Model: ArmTerms.from_model(model))")
        if not plant.is_finalized():
            raise ModelError("the plant is not finalized: call Finalize() before a filter is made for it")
        if tool_frame and not plant.HasFrameNamed(tool_frame):
            raise ModelError(f"no frame {tool_frame!r} in the plant")
        self.plant = plant
        self.n = len(joints)
        self.laws = laws or Laws()
        handles = _joints(plant, joints)
        self._joints = handles
        self.prismatic = np.array([isinstance(joint, PrismaticJoint) for joint in handles])
        self.position_index = np.array([joint.position_start() for joint in handles])
        self.velocity_index = np.array([joint.velocity_start() for joint in handles])

        self._context: Context = plant.CreateDefaultContext() if context is None else context.Clone()
        self.damping = np.array([float(joint.GetDampingVector(self._context)[0]) for joint in handles])
        self._forces = MultibodyForces(plant)
        self._x = plant.GetPositionsAndVelocities(self._context).copy()
        self._x[plant.num_positions() :] = 0.0
        self._now = b""
        self._at_q = self.position_index
        self._at_v = plant.num_positions() + self.velocity_index
        self._rows = np.ix_(self.velocity_index, self.velocity_index)
        self._a: Any = np.zeros(plant.num_velocities())
        self._origin: Any = np.zeros(3)
        self._world = plant.world_frame()
        self._gravity = plant.gravity_field().gravity_vector()
        self._find_last_link(tool_frame)
        brisk, inertia = self._brisk_effort()
        efforts, speeds = _efforts(plant, handles), [joint.velocity_upper_limits()[0] for joint in handles]
        self.effort_limit = _limit(efforts, brisk)
        # What the motor's whole effort makes of the joint's inertia over one turn, or one metre, from rest.
        way = np.where(self.prismatic, 1.0, 2.0 * np.pi)
        self.velocity_limit = _limit(speeds, np.sqrt(2.0 * self.effort_limit * way / inertia))
        self._named = np.isfinite(_limit(speeds, np.inf)), np.isfinite(_limit(efforts, np.inf))

    def assumptions(self) -> list[str]:
        """Return a sentence on each limit that the plant does not name and the filter therefore assumes."""
        said = []
        quantities = (("speed", self.velocity_limit, ("m/s", "rad/s")), ("effort", self.effort_limit, ("N", "N·m")))
        for (quantity, limit, units), named in zip(quantities, self._named, strict=True):
            for joint, value, known, prismatic in zip(self._joints, limit, named, self.prismatic, strict=True):
                if not known:
                    unit = units[0] if prismatic else units[1]
                    known_by = f"{joint.name()}: the description names no {quantity} limit"
                    said.append(f"{known_by}; the filter assumes {value:.3g} {unit}")
        return said

    def _find_last_link(self, tool_frame: str | None) -> None:
        self._link = self._joints[-1].child_body()
        self.link_frame = self._link_frame = self._link.body_frame()
        self.link_name: str = self._link.name()
        tool = self.plant.GetFrameByName(tool_frame) if tool_frame else self._link_frame
        X_WL = self._link_frame.CalcPoseInWorld(self._context)
        self.tool: Array = (X_WL.inverse() @ tool.CalcPoseInWorld(self._context)).translation().copy()
        self._farthest = max(TUNING.largest_com, TUNING.beyond_tool * float(np.linalg.norm(self.tool)))
        inertia = self._link.CalcSpatialInertiaInBodyFrame(self._context)
        self._mass0 = inertia.get_mass()
        self._moment0 = inertia.CalcComMoment()
        self._inertia0 = inertia.CalcRotationalInertia().CopyToFullMatrix3()
        self._payload = b""
        self.set_payload(np.zeros(4))  # as it will be set ever after: rounding must not depend on what came before

    @staticmethod
    def of(arm: ArmTerms | Model) -> ArmTerms:
        """Return an arm's terms: those that are given, or those of a model; raises ArgumentError for anything else."""
        return arm if isinstance(arm, ArmTerms) else ArmTerms.from_model(arm)

    @staticmethod
    def from_model(model: Model) -> ArmTerms:
        """Return the terms of a twin's model with its effects."""
        expect(model, Model, "model", "a Model (as Model.load(PATH) returns it; of a plant: ArmTerms(plant, joints))")
        laws = [effect for effect in model.present if not effect.folds]
        smooth = [effect for effect in laws if not effect.dry]
        zero = np.zeros((1, len(model.joints)))

        def load(q: Array, v: Array, tau: Array) -> Array:
            rows = (q[None], v[None], zero, tau[None])
            return np.sum([effect.torque(model.bodies, *rows)[0] for effect in smooth], axis=0)

        def dry(q: Array, v: Array, tau: Array) -> tuple[Array, Array]:
            forward, backward = model.law.friction_level(q[None], v[None], tau[None])
            return forward[0], backward[0]

        levels = dry(zero[0], zero[0], zero[0])

        def even(q: Array, v: Array, tau: Array) -> tuple[Array, Array]:
            return levels[0].copy(), levels[1].copy()

        # Worked out once where it can be: it is asked for three times a message.
        friction = even if all(effect.even for effect in model.law.dry) else dry

        return ArmTerms(
            model.plant,
            model.joints,
            tool_frame=model.spec.tool_frame,
            laws=Laws(
                load=load if smooth else None,
                dry=friction if len(laws) > len(smooth) else None,
                applied=model.applied if smooth else None,
                true_position=model.true_position if smooth else None,
            ),
            context=model.make_context(),  # it holds what effects change in the plant's own parameters
        )

    def _set(self, q: Array, v: Array | float) -> None:
        self._x[self._at_q] = q
        self._x[self._at_v] = v
        now = self._x.tobytes()
        if now != self._now:  # the plant forgets all that it has worked out, even where nothing is new
            self.plant.SetPositionsAndVelocities(self._context, self._x)
            self._now = now

    def at(self, q: Array, v: Array | float) -> Context:
        """Return the scratch Context with the joints at q, v (n,): to be read at once and not kept."""
        self._set(q, v)
        return self._context

    def _brisk_effort(self) -> tuple[Array, Array]:
        """Return (n,) torque for twice the largest weight on each joint and a brisk start [N·m], and its inertia.

        Both are the largest over a spread of poses [N·m], [kg·m²].
        """
        poses = np.random.default_rng(0).uniform(-np.pi, np.pi, (16, self.n))
        weight = np.max([np.abs(self.inverse_dynamics(q, np.zeros(self.n), 0.0)) for q in poses], axis=0)
        inertia = np.asarray(np.max([self.mass_matrix(q).diagonal() for q in poses], axis=0), dtype=np.float64)
        return 2.0 * weight + TUNING.brisk * inertia, inertia

    def set_payload(self, payload: Array) -> None:
        """Set what the last link carries, for all calls that follow.

        Args:
            payload: (4,) mass m [kg] and first moment m·c [kg·m] about the last link's origin, in its frame. Its own
                inertia is taken as that of a point at c.
        """
        told = payload.tobytes()
        if told == self._payload:
            return
        self._payload = told
        mass = max(float(payload[0]), 0.0)
        centre: Array = np.zeros(3)
        square = 0.0
        if mass > 0.0:
            centre = payload[1:4] / mass
            square = float(centre @ centre)
            reach = math.sqrt(square)
            if reach > self._farthest:
                centre = centre * (self._farthest / reach)
                square = float(centre @ centre)
        total = max(self._mass0 + mass, _LEAST_MASS)
        inertia = self._inertia0 + mass * (square * _EYE - centre[:, None] * centre)
        centre = (self._moment0 + mass * centre) / total
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = (inertia / total).tolist()
        unit = UnitInertia(xx, yy, zz, xy, xz, yz)
        self._link.SetSpatialInertiaInBodyFrame(
            self._context, SpatialInertia(total, centre, unit, skip_validity_check=True)
        )

    def mass_matrix(self, q: Array) -> Array:
        """Return M(q) (n, n) [kg·m²], the plant's other joints held."""
        self._set(q, self._x[self._at_v])  # whatever the speeds are
        mass: Array = self.plant.CalcMassMatrix(self._context)[self._rows]
        return mass

    def inverse_dynamics(self, q: Array, v: Array, a: Array | float) -> Array:
        """Return the torque of the plant, M(q) a + b(q, v), without the laws of effects (n,) [N·m]."""
        self._set(q, v)
        self._a[self.velocity_index] = a
        self.plant.CalcForceElementsContribution(self._context, self._forces)
        torque: Array = self.plant.CalcInverseDynamics(self._context, self._a, self._forces)[self.velocity_index]
        return torque

    def load(self, q: Array, v: Array, tau: Array) -> Array:
        """Return b(q, v): torque of plant and smooth effects at zero acceleration (n,) [N·m].

        Args:
            q: (n,) [rad].
            v: (n,) [rad/s].
            tau: (n,) motor torque, for effects that depend on load [N·m].
        """
        bias = self.inverse_dynamics(q, v, 0.0)
        return bias if self.laws.load is None else bias + self.laws.load(q, v, tau)

    def dry(self, q: Array, v: Array, tau: Array) -> tuple[Array, Array]:
        """Return bounds of dry friction against positive and against negative motion, each (n,), ≥ 0 [N·m]."""
        if self.laws.dry is None:
            return np.zeros(self.n), np.zeros(self.n)
        return self.laws.dry(q, v, tau)

    def applied(self, tau: Array) -> Array:
        """Return the torque that reaches the joints when τ (n,) is measured [N·m]."""
        return tau if self.laws.applied is None else self.laws.applied(tau)

    def true_position(self, q: Array) -> Array:
        """Return the joint positions when q (n,) is measured [rad]."""
        return q if self.laws.true_position is None else self.laws.true_position(q)

    def derivatives(self, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
        """Return forward differences of inverse dynamics: ∂τ/∂q and ∂τ/∂v, each (n, n), at constant acceleration."""
        step = 1e-6
        base = self.inverse_dynamics(q, v, a)
        by_q, by_v = np.empty((self.n, self.n)), np.empty((self.n, self.n))
        plant, context, forces, x = self.plant, self._context, self._forces, self._x
        velocities = x[plant.num_positions() :]
        self._now = b""
        # Speeds first: while positions stay as they are, the plant keeps what it has worked out of them.
        for out, index, put, part in (
            (by_v, self._at_v, plant.SetVelocities, velocities),
            (by_q, self._at_q, plant.SetPositionsAndVelocities, x),
        ):
            for column, i in enumerate(index):
                kept = x[i]
                x[i] = kept + step
                put(context, part)
                plant.CalcForceElementsContribution(context, forces)
                out[:, column] = plant.CalcInverseDynamics(context, self._a, forces)[self.velocity_index]
                x[i] = kept
        by_q -= base[:, None]
        by_v -= base[:, None]
        by_q /= step
        by_v /= step
        return by_q, by_v

    def payload_regressor(self, q: Array, v: Array, a: Array) -> Array:
        """Return Y with τ_payload = Y·(m, m·c): linear in mass and first moment (n, 4) [N·m/kg, N·m/(kg·m)].

        With the last link's origin L accelerating by a_L, angular velocity ω and acceleration α, a payload needs the
        force m (a_L − g) + α × mc + ω × (ω × mc) and about L the moment mc × (a_L − g); the inertia about L,
        quadratic in c, is left to M.
        """
        self._set(q, v)
        plant, context = self.plant, self._context
        J: Array = plant.CalcJacobianSpatialVelocity(
            context, JacobianWrtVariable.kV, self._link_frame, self._origin, self._world, self._world
        )[:, self.velocity_index]
        bias = plant.CalcBiasSpatialAcceleration(
            context, JacobianWrtVariable.kV, self._link_frame, self._origin, self._world, self._world
        )
        R_WL = plant.EvalBodyPoseInWorld(context, self._link).rotation().matrix()
        acceleration = J @ a
        alpha = acceleration[:3] + bias.rotational()
        lift = acceleration[3:] + bias.translational() - self._gravity
        omega = J[:3] @ v
        spin = skew(omega)
        Y = np.empty((self.n, 4))
        Y[:, 0] = J[3:].T @ lift
        Y[:, 1:] = (J[3:].T @ (skew(alpha) + spin @ spin) - J[:3].T @ skew(lift)) @ R_WL
        return Y


def _joints(plant: MultibodyPlant, names: Sequence[str]) -> list[Any]:
    found = []
    for name in names:
        joint = _joint(plant, name)
        if joint.num_velocities() != 1:
            raise ModelError(
                f"joint {name!r} has {joint.num_velocities()} degrees of freedom; the filter takes one each"
            )
        found.append(joint)
    if not found:
        raise ModelError("a filter needs at least one joint")
    return found


def _efforts(plant: MultibodyPlant, joints: Sequence[Any]) -> list[float]:
    """Return the effort limit of each joint's actuator [N·m]; infinite where it has none."""
    effort = {joint.index(): np.inf for joint in joints}
    for index in plant.GetJointActuatorIndices():
        actuator = plant.get_joint_actuator(index)
        effort[actuator.joint().index()] = actuator.effort_limit()
    return [effort[joint.index()] for joint in joints]


def _joint(plant: MultibodyPlant, name: str) -> Any:
    model, _, alone = name.rpartition("::")
    if not model:
        if plant.HasJointNamed(name):
            return plant.GetJointByName(name)
    elif plant.HasModelInstanceNamed(model):
        instance = plant.GetModelInstanceByName(model)
        if plant.HasJointNamed(alone, instance):
            return plant.GetJointByName(alone, instance)
    raise ModelError(f"no joint {name!r} in the plant")


def skew(w: Array) -> Array:
    """Return (3, 3) of the cross product with w (3,)."""
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def _limit(values: Sequence[float], default: Array | float) -> Array:
    limits = np.array(values, dtype=float)
    return np.where(np.isfinite(limits) & (limits > 0.0), limits, default)
