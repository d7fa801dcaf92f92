"""What every effect is: named parameters, a smooth torque law, and a stable realisation in a simulator's plant."""

from __future__ import annotations

import copy
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import ClassVar, TypeVar

import numpy as np
import numpy.typing as npt
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PdControllerGains

from twin_diagram.errors import ModelError
from twin_diagram.model.description.add_arm import Arm
from twin_diagram.model.effects.parameter import Parameter, ParameterKind
from twin_diagram.model.effects.realisation import Brake, Fitting, RigidChange
from twin_diagram.model.rigid_body.arm_bodies import ArmBodies, DescribedLinks
from twin_diagram.scenario import EffectSpec
from twin_diagram.signals.arrays import Array

E_ = TypeVar("E_", bound="type[Effect]")


class Effect:
    """One named physical phenomenon that the given model lacks.

    Subclasses say where they act by overriding one of three laws, all smooth and vectorised over N samples:

    - `torque`: what the motor must give in addition because of a load on the joint (friction, payload, spring);
    - `applied` and `logged`: what becomes of the logged torque before it reaches the joint (bias, gain, saturation),
      and `delay`: how much later;
    - `true_position` and `measured_position`: what the encoder's reading means (offset).

    A law that depends on acceleration must also be a `change` of the rigid model (`folds`), for integrators to know.
    `fittings` and `brakes` tell how they are realised in a discrete plant, and `before_finalize` where that is not
    enough. None of the laws knows of time: an effect that starts or ends within a log has an `onset` or an `end`, and
    `Model` asks it only for the samples between them.

    Attributes:
        name: of the catalogue.
        kinds: the parameters, by their exact keys.
        per_joint: whether parameters hold a value per joint.
        joints: that it sits on.
        links: that it sits on.
        parameters: values.
        given: whether the arm's own description states it, so that it is no addition to it.
        onset: when it starts, on the log's own clock [s]; None: it was there before.
        end: when it ends; None: it stays.
        log: which log the two are about (`logs.fingerprint`); later ones come after it. Empty: any log.
        mark: tells its actuators in a plant from those of its equals on the same joint.
        prismatic: which of its joints are, as far as it was told (`on_arm`); words depend on it, no law does.
    """

    name: ClassVar[str] = ""
    kinds: ClassVar[Mapping[str, ParameterKind]] = {}
    per_joint: ClassVar[bool] = True
    folds: ClassVar[bool] = False
    """Whether `change` holds all of its torque, which is then not added a second time."""
    dry: ClassVar[bool] = False
    """Whether its torque is dry friction, of which `friction_level` tells the bound."""
    last: ClassVar[bool] = False
    """Whether its torque comes beside what the motor gives, so that `applied` counts it after all others."""
    motor_side: ClassVar[bool] = False
    """Whether `torque` acts on the motor's side of an elastic gear."""
    replaces_joints: ClassVar[bool] = False
    """Whether `before_finalize` puts other joints in the place of the arm's."""
    changes_plant: ClassVar[bool] = False
    """Whether a plant holds it in what cannot change during a run, so that it can have neither onset nor end there."""

    def __init__(
        self, joints: Iterable[str] = (), links: Iterable[str] = (), parameters: Mapping[str, Parameter] | None = None
    ) -> None:
        self.joints = tuple(joints)
        self.links = tuple(links)
        self.parameters = dict(parameters or {})
        self.given = False
        self.onset: float | None = None
        self.end: float | None = None
        self.log = ""
        self.elsewhere: Mapping[str, float] = {}
        self.mark = ""
        self.prismatic: frozenset[str] = frozenset()

    @property
    def timed(self) -> bool:
        """Whether it starts or ends within a log."""
        return self.onset is not None or self.end is not None

    def active(self, time: Array) -> npt.NDArray[np.bool_]:
        """At which times (…) it acts [s]."""
        after = -math.inf if self.onset is None else self.onset
        before = math.inf if self.end is None else self.end
        return np.asarray((time >= after) & (time < before))

    def always(self) -> Effect:
        """Return the same without onset and end."""
        result = copy.copy(self)
        result.onset, result.end, result.log, result.elsewhere = None, None, "", {}
        return result

    def told(self, moments: Mapping[str, float]) -> Effect:
        """Return the same, told when its onset or end came in other runs; see `EffectSpec.elsewhere`."""
        result = copy.copy(self)
        result.elsewhere = {**self.elsewhere, **moments}
        return result

    def in_run(self, mark: str) -> Effect | None:
        """As it is in the run of a fingerprint, where its onset or end may be about another; None: it is not there.

        What started is there from then on, what ended is over, unless `elsewhere` says otherwise.
        """
        if self.log in ("", mark):
            return self
        moment = self.elsewhere.get(mark, -math.inf)
        if self.end is not None and self.onset is not None:
            return None
        if not math.isfinite(moment):
            return self.always() if (moment < 0.0) == (self.end is None) else None
        result = self.always()
        result.log = mark
        if self.end is None:
            result.onset = moment
        else:
            result.end = moment
        return result

    def on_arm(self, prismatic: Collection[str]) -> Effect:
        """Return the same, told which of an arm's joints are prismatic; itself where that is nothing new."""
        own = frozenset(prismatic) & frozenset(self.joints)
        if own == self.prismatic:
            return self
        result = copy.copy(self)
        result.prismatic = own
        return result

    @classmethod
    def from_spec(cls, spec: EffectSpec) -> Effect:
        """Return the effect of a scenario or an `effects.yaml`.

        Raises:
            ModelError: an unknown or missing parameter, a wrong number of values, or a value out of bounds.
        """
        if cls.per_joint and not spec.joints:
            raise ModelError(f"effects.{cls.name}.joints: name the joints that it sits on")
        if len(set(spec.joints)) != len(spec.joints):
            raise ModelError(f"effects.{cls.name}.joints: a joint is named twice in {', '.join(spec.joints)}")
        parameters: dict[str, Parameter] = {}
        for key in spec.parameters:
            if key not in cls.kinds:
                raise ModelError(f"effects.{cls.name}.{key}: no such parameter; it has {', '.join(cls.kinds)}")
        for key, kind in cls.kinds.items():
            where = f"effects.{cls.name}.{key}"
            size = len(spec.joints) if cls.per_joint and kind.size is not None else kind.size
            value = spec.parameters.get(key)
            if value is None:
                if kind.default is None:
                    if cls.optional(key):
                        continue
                    raise ModelError(f"{where}: is missing")
                value = [kind.default] * (size or 1)
            if size is not None and len(value) != size:
                per = " (one per joint)" if cls.per_joint else ""
                raise ModelError(f"{where}: needs {size} value(s){per}, got {len(value)}")
            parameters[key] = Parameter.of(kind, value, where)
        result = cls(spec.joints, spec.links, parameters)
        result.onset, result.end, result.log = spec.onset, spec.end, spec.log
        result.elsewhere = dict(spec.elsewhere)
        for run, when in spec.elsewhere.items():
            if math.isnan(when):
                raise ModelError(f"effects.{cls.name}.elsewhere: the time in {run} is not a number")
        for key, moment in (("onset", spec.onset), ("end", spec.end)):
            if moment is not None and not math.isfinite(moment):
                raise ModelError(f"effects.{cls.name}.{key}: {moment} is not finite")
        if spec.onset is not None and spec.end is not None and not spec.onset < spec.end:
            raise ModelError(f"effects.{cls.name}.end: {spec.end:g} s is not after the onset at {spec.onset:g} s")
        result.check()
        return result

    @classmethod
    def optional(cls, key: str) -> bool:
        """Return whether a parameter without a default may be left out."""
        del key
        return False

    def check(self) -> None:
        """Raise ModelError where the parameters do not fit together."""

    def spec(self) -> EffectSpec:
        """As a scenario or an `effects.yaml` holds it."""
        values = {key: [float(x) for x in parameter.value] for key, parameter in self.parameters.items()}
        return EffectSpec(
            name=self.name,
            joints=list(self.joints),
            links=list(self.links),
            parameters=values,
            onset=self.onset,
            end=self.end,
            log=self.log,
            elsewhere=dict(self.elsewhere),
        )

    def value(self, key: str) -> Array:
        """Return a parameter's value."""
        return self.parameters[key].value

    def with_values(self, values: Mapping[str, Sequence[float] | Array], *, check: bool = True) -> Effect:
        """Return the same effect with other values of some parameters; bounds are checked unless told otherwise."""
        parameters = dict(self.parameters)
        for key, value in values.items():
            where = f"effects.{self.name}.{key}"
            value = Parameter.of(self.kinds[key], value, where).value if check else np.array(value, dtype=float)
            parameters[key] = replace(parameters[key], value=value)
        result = copy.copy(self)
        result.parameters = parameters
        if check:
            result.check()
        return result

    def vector(self) -> Array:
        """Return all parameters that are not frozen, one after the other."""
        free = [parameter.value for parameter in self.parameters.values() if not parameter.frozen]
        return np.concatenate(free) if free else np.zeros(0)

    def with_vector(self, vector: Array, *, check: bool = True) -> Effect:
        """Return the inverse of `vector`."""
        values, start = {}, 0
        for key, parameter in self.parameters.items():
            if not parameter.frozen:
                values[key] = vector[start : start + len(parameter.value)]
                start += len(parameter.value)
        return self.with_values(values, check=check)

    # The smooth laws.

    def torque(self, bodies: ArmBodies, q: Array, v: Array, a: Array, tau: Array) -> Array:
        """Return what the motors must give in addition, joint side.

        Args:
            bodies: of the arm that it sits on.
            q: (N, n) positions [rad].
            v: (N, n) velocities [rad/s].
            a: (N, n) accelerations [rad/s²].
            tau: (N, n) torque that the joints transmit [N·m].

        Returns:
            (N, n) [N·m]
        """
        del bodies, v, a, tau
        return np.zeros_like(q)

    def applied(self, joints: Sequence[str], tau: Array) -> Array:
        """Return the torque (…, n) that reaches the joints of an arm when `tau` is logged."""
        del joints
        return tau

    def logged(self, joints: Sequence[str], tau: Array) -> Array:
        """Return the inverse of `applied`."""
        del joints
        return tau

    @property
    def delay(self) -> float:
        """How much later the logged torque reaches the joints [s]."""
        return 0.0

    @property
    def loses(self) -> bool:
        """Whether `applied` forgets so much of what is logged that `logged` cannot tell it."""
        return False

    def true_position(self, joints: Sequence[str], q: Array) -> Array:
        """Return the positions (…, n) of an arm's joints when `q` is measured."""
        del joints
        return q

    def measured_position(self, joints: Sequence[str], q: Array) -> Array:
        """Return the inverse of `true_position`."""
        del joints
        return q

    def change(self, links: DescribedLinks) -> RigidChange:
        """Return its part in the rigid model."""
        del links
        return RigidChange()

    def friction_level(self, bodies: ArmBodies, q: Array, v: Array, tau: Array) -> tuple[Array, Array]:
        """Return the largest friction torque at each sample against positive and against negative motion.

        Each (N, n), ≥ 0. Here `tau` is what the motors give, friction included.
        """
        del bodies, v, tau
        return np.zeros_like(q), np.zeros_like(q)

    def sensitivity(self, bodies: ArmBodies, q: Array, v: Array, a: Array, tau: Array) -> Array:
        """Return the derivative (N, n, p) of the logged torque with respect to `vector`, by central differences."""
        theta = self.vector()
        result = np.empty((*q.shape, len(theta)))
        for k, value in enumerate(theta):
            step = 1e-6 * max(1.0, abs(value))
            sides = []
            for sign in (1.0, -1.0):
                moved = theta.copy()
                moved[k] += sign * step
                effect = self.with_vector(moved, check=False)
                sides.append(effect.logged(bodies.joints, tau + effect.torque(bodies, q, v, a, tau)))
            result[..., k] = (sides[0] - sides[1]) / (2.0 * step)
        return result

    # The realisation in a simulator.

    def fittings(self) -> list[Fitting]:
        """Return the actuators that realise it in a discrete plant."""
        return []

    def brakes(self) -> list[Brake]:
        """Return dry friction of changing level that `Drive` works out."""
        return []

    def marked_fittings(self) -> list[Fitting]:
        """Return `fittings` under names of their own in a plant."""
        return [replace(fitting, name=fitting.name + self.mark) for fitting in self.fittings()]

    def marked_brakes(self) -> list[Brake]:
        """Return `brakes` likewise."""
        return [replace(brake, name=brake.name + self.mark) for brake in self.brakes()]

    def before_finalize(self, plant: MultibodyPlant, arm: Arm) -> None:
        """Change a discrete plant that is not finalized; the default adds actuators for `fittings` and `brakes`."""
        for brake in self.marked_brakes():
            for name in brake.joints:
                plant.AddJointActuator(
                    f"{name}_{brake.name}", plant.get_joint(arm.joint_indices[arm.joints.index(name)])
                )
        for fitting in self.marked_fittings():
            joint = plant.get_joint(arm.joint_indices[arm.joints.index(fitting.joint)])
            actuator = plant.AddJointActuator(fitting.name, joint, fitting.limit)
            if fitting.stiffness > 0.0 or fitting.damping > 0.0:
                actuator.set_controller_gains(PdControllerGains(p=fitting.stiffness, d=fitting.damping))

    def after_finalize(self, plant: MultibodyPlant, arm: Arm) -> None:
        """Set what can only be set on a finalized plant."""

    def unit(self, key: str, joint: str = "") -> str:
        """Return a parameter's unit on one of its joints."""
        return self.kinds[key].unit_on(joint in self.prismatic)

    def columns(self, joints: Sequence[str]) -> npt.NDArray[np.int64]:
        """Return its joints' columns in the arrays of an arm."""
        return np.array([joints.index(joint) for joint in self.joints], dtype=np.int64)

    def spread(self, joints: Sequence[str], values: Array) -> Array:
        """Return a value per joint of this effect as (n,), zero on the arm's other joints."""
        result = np.zeros(len(joints))
        result[self.columns(joints)] = values
        return result

    def __repr__(self) -> str:
        values = ", ".join(f"{key}={parameter.value.tolist()}" for key, parameter in self.parameters.items())
        return f"{type(self).__name__}({', '.join(self.joints or self.links)}: {values})"


REGISTRY: dict[str, type[Effect]] = {}
"""Effect classes by their names in the catalogue."""


def register(cls: E_) -> E_:
    """Return the class decorator: makes an effect known by its name."""
    REGISTRY[cls.name] = cls
    return cls


def make(spec: EffectSpec) -> Effect:
    """Return the effect that a specification names.

    Raises:
        ModelError: unknown name, or parameters that do not fit it.
    """
    if spec.name not in REGISTRY:
        raise ModelError(f"effects: no effect is called {spec.name!r}; there are {', '.join(sorted(REGISTRY))}")
    return REGISTRY[spec.name].from_spec(spec)
