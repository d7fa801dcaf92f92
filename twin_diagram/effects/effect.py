"""What every effect is: named parameters, a smooth torque law, and a stable realisation in a simulator's plant."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, ClassVar, TypeVar

import numpy as np
import numpy.typing as npt
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PdControllerGains

from twin_diagram.errors import ModelError
from twin_diagram.scenario import EffectSpec

if TYPE_CHECKING:
    from twin_diagram.description import Arm
    from twin_diagram.model import Model

Array = npt.NDArray[np.float64]
E_ = TypeVar("E_", bound="type[Effect]")


@dataclass(frozen=True)
class ParameterKind:
    """What a parameter of the catalogue is.

    Attributes:
        unit: SI unit.
        lower: lowest value that is physical.
        upper: highest.
        size: numbers of one value; ignored where there is a value per joint, None for lists of free length.
        default: value where a specification leaves it out; None: it must be given.
        help: one line for people.
    """

    unit: str
    lower: float = -math.inf
    upper: float = math.inf
    size: int | None = 1
    default: float | None = None
    help: str = ""


@dataclass(frozen=True)
class Parameter:
    """A bounded, freezable value.

    Attributes:
        value: one number per joint for a joint effect, otherwise the value itself.
        lower: bounds that identification keeps to, same shape.
        upper: likewise.
        frozen: identification leaves it alone.
        unit: SI unit.
    """

    value: Array
    lower: Array
    upper: Array
    frozen: bool = False
    unit: str = ""

    @staticmethod
    def of(kind: ParameterKind, value: Sequence[float] | Array, where: str) -> Parameter:
        """A value of a kind, checked.

        Raises:
            ModelError: it is not finite or outside the bounds; `where` names it in the message.
        """
        array = np.array(value, dtype=float)
        if not np.all(np.isfinite(array)):
            raise ModelError(f"{where}: {list(value)} is not finite")
        if np.any(array < kind.lower) or np.any(array > kind.upper):
            raise ModelError(f"{where}: {list(value)} {kind.unit} is not within [{kind.lower:g}, {kind.upper:g}]")
        array.setflags(write=False)
        return Parameter(array, np.full_like(array, kind.lower), np.full_like(array, kind.upper), False, kind.unit)


@dataclass
class RigidChange:
    """What an effect changes in the rigid model itself, so that plain dynamics already hold it.

    Attributes:
        inertia: (10,) per link name, as in `rigid_tree.RigidTree`, but about the link's own frame.
        rotor: reflected inertia per joint name [kg·m²].
        damping: per joint name [N·m·s/rad].
    """

    inertia: dict[str, Array] = field(default_factory=dict)
    rotor: dict[str, float] = field(default_factory=dict)
    damping: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Fitting:
    """An actuator beside the motor, by which a discrete plant realises an effect implicitly.

    It gives −stiffness (q − rest) − damping v + torque + curve(q), held within ±limit; the first two are solved for
    together with the step, so that they are stable at any step.

    Attributes:
        name: of the actuator.
        joint: that it drives.
        limit: largest torque [N·m].
        stiffness: [N·m/rad].
        damping: [N·m·s/rad].
        rest: [rad].
        torque: constant [N·m].
        curve: torque [N·m] for an angle [rad], explicit in time: keep its slope times step² below the joint's inertia.
    """

    name: str
    joint: str
    limit: float = math.inf
    stiffness: float = 0.0
    damping: float = 0.0
    rest: float = 0.0
    torque: float = 0.0
    curve: Callable[[float], float] | None = None


class Effect:
    """One named physical phenomenon that the given model lacks.

    Subclasses say where they act by overriding one of three laws, all smooth and vectorised over N samples:

    - `torque`: what the motor must give in addition because of a load on the joint (friction, payload, spring);
    - `applied` and `logged`: what becomes of the logged torque before it reaches the joint (bias, gain, saturation);
    - `true_position` and `measured_position`: what the encoder's reading means (offset).

    A law that depends on acceleration must also be a `change` of the rigid model (`folds`), for integrators to know.
    `fittings` tells how they are realised in a discrete plant, and `before_finalize` where that is not enough.

    Attributes:
        name: of the catalogue.
        kinds: the parameters, by their exact keys.
        per_joint: whether parameters hold a value per joint.
        joints: that it sits on.
        links: that it sits on.
        parameters: values.
        given: whether the arm's own description states it, so that it is no addition to it.
    """

    name: ClassVar[str] = ""
    kinds: ClassVar[Mapping[str, ParameterKind]] = {}
    per_joint: ClassVar[bool] = True
    folds: ClassVar[bool] = False
    """Whether `change` holds all of its torque, which is then not added a second time."""
    dry: ClassVar[bool] = False
    """Whether its torque is dry friction, of which `friction_level` tells the bound."""

    def __init__(
        self, joints: Iterable[str] = (), links: Iterable[str] = (), parameters: Mapping[str, Parameter] | None = None
    ) -> None:
        self.joints = tuple(joints)
        self.links = tuple(links)
        self.parameters = dict(parameters or {})
        self.given = False

    @classmethod
    def from_spec(cls, spec: EffectSpec) -> Effect:
        """The effect of a scenario or an `effects.yaml`.

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
        result.check()
        return result

    @classmethod
    def optional(cls, key: str) -> bool:
        """Whether a parameter without a default may be left out."""
        del key
        return False

    def check(self) -> None:
        """Raises ModelError where the parameters do not fit together."""

    def spec(self) -> EffectSpec:
        """As a scenario or an `effects.yaml` holds it."""
        values = {key: [float(x) for x in parameter.value] for key, parameter in self.parameters.items()}
        return EffectSpec(name=self.name, joints=list(self.joints), links=list(self.links), parameters=values)

    def value(self, key: str) -> Array:
        """A parameter's value."""
        return self.parameters[key].value

    def with_values(self, values: Mapping[str, Sequence[float] | Array], *, check: bool = True) -> Effect:
        """The same effect with other values of some parameters; bounds are checked unless told otherwise."""
        parameters = dict(self.parameters)
        for key, value in values.items():
            where = f"effects.{self.name}.{key}"
            value = Parameter.of(self.kinds[key], value, where).value if check else np.array(value, dtype=float)
            parameters[key] = replace(parameters[key], value=value)
        result = type(self)(self.joints, self.links, parameters)
        result.given = self.given
        if check:
            result.check()
        return result

    def vector(self) -> Array:
        """All parameters that are not frozen, one after the other."""
        free = [parameter.value for parameter in self.parameters.values() if not parameter.frozen]
        return np.concatenate(free) if free else np.zeros(0)

    def with_vector(self, vector: Array, *, check: bool = True) -> Effect:
        """The inverse of `vector`."""
        values, start = {}, 0
        for key, parameter in self.parameters.items():
            if not parameter.frozen:
                values[key] = vector[start : start + len(parameter.value)]
                start += len(parameter.value)
        return self.with_values(values, check=check)

    # The smooth laws.

    def torque(self, model: Model, q: Array, v: Array, a: Array, tau: Array) -> Array:
        """What the motors must give in addition, joint side.

        Args:
            model: that it is added to.
            q: (N, n) positions [rad].
            v: (N, n) velocities [rad/s].
            a: (N, n) accelerations [rad/s²].
            tau: (N, n) torque that the joints transmit [N·m].

        Returns:
            (N, n) [N·m]
        """
        del model, v, a, tau
        return np.zeros_like(q)

    def applied(self, joints: Sequence[str], tau: Array) -> Array:
        """The torque (…, n) that reaches the joints of an arm when `tau` is logged."""
        del joints
        return tau

    def logged(self, joints: Sequence[str], tau: Array) -> Array:
        """The inverse of `applied`."""
        del joints
        return tau

    def true_position(self, joints: Sequence[str], q: Array) -> Array:
        """The positions (…, n) of an arm's joints when `q` is measured."""
        del joints
        return q

    def measured_position(self, joints: Sequence[str], q: Array) -> Array:
        """The inverse of `true_position`."""
        del joints
        return q

    def change(self, model: Model) -> RigidChange:
        """Its part in the rigid model."""
        del model
        return RigidChange()

    def friction_level(self, model: Model, q: Array, v: Array, tau: Array) -> tuple[Array, Array]:
        """Largest friction torque at each sample against positive and against negative motion, each (N, n), ≥ 0."""
        del model, v, tau
        return np.zeros_like(q), np.zeros_like(q)

    def sensitivity(self, model: Model, q: Array, v: Array, a: Array, tau: Array) -> Array:
        """Derivative (N, n, p) of the logged torque with respect to `vector`, by central differences."""
        theta = self.vector()
        result = np.empty((*q.shape, len(theta)))
        for k, value in enumerate(theta):
            step = 1e-6 * max(1.0, abs(value))
            sides = []
            for sign in (1.0, -1.0):
                moved = theta.copy()
                moved[k] += sign * step
                effect = self.with_vector(moved, check=False)
                sides.append(effect.logged(model.joints, tau + effect.torque(model, q, v, a, tau)))
            result[..., k] = (sides[0] - sides[1]) / (2.0 * step)
        return result

    # The realisation in a simulator.

    def fittings(self) -> list[Fitting]:
        """The actuators that realise it in a discrete plant."""
        return []

    def before_finalize(self, plant: MultibodyPlant, arm: Arm) -> None:
        """Changes a discrete plant that is not finalized; the default adds the actuators of `fittings`."""
        for fitting in self.fittings():
            joint = plant.get_joint(arm.joint_indices[arm.joints.index(fitting.joint)])
            actuator = plant.AddJointActuator(fitting.name, joint, fitting.limit)
            if fitting.stiffness > 0.0 or fitting.damping > 0.0:
                actuator.set_controller_gains(PdControllerGains(p=fitting.stiffness, d=fitting.damping))

    def after_finalize(self, plant: MultibodyPlant, arm: Arm) -> None:
        """Sets what can only be set on a finalized plant."""

    def sentence(self) -> str:
        """Says itself."""
        return f"{self.name.replace('_', ' ')} on {', '.join(self.joints or self.links)}"

    def columns(self, joints: Sequence[str]) -> npt.NDArray[np.int64]:
        """Its joints' columns in the arrays of an arm."""
        return np.array([joints.index(joint) for joint in self.joints], dtype=np.int64)

    def spread(self, joints: Sequence[str], values: Array) -> Array:
        """A value per joint of this effect as (n,), zero on the arm's other joints."""
        result = np.zeros(len(joints))
        result[self.columns(joints)] = values
        return result

    def __repr__(self) -> str:
        values = ", ".join(f"{key}={parameter.value.tolist()}" for key, parameter in self.parameters.items())
        return f"{type(self).__name__}({', '.join(self.joints or self.links)}: {values})"


REGISTRY: dict[str, type[Effect]] = {}
"""Effect classes by their names in the catalogue."""


def register(cls: E_) -> E_:
    """Class decorator: makes an effect known by its name."""
    REGISTRY[cls.name] = cls
    return cls


def make(spec: EffectSpec) -> Effect:
    """The effect that a specification names.

    Raises:
        ModelError: unknown name, or parameters that do not fit it.
    """
    if spec.name not in REGISTRY:
        raise ModelError(f"effects: no effect is called {spec.name!r}; there are {', '.join(sorted(REGISTRY))}")
    return REGISTRY[spec.name].from_spec(spec)
