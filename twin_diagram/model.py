"""The twin's physics: an arm's plant and the effects that its description lacks.

Simulator, filter, rollouts and gap workflow share it. The torque law reads

    logged torque = actuation⁻¹( M(q) a + C(q, v) v − g(q) + dampers + Σ effects.torque )

with q the true positions behind the measured ones, and M with rotors and payloads. Effects that start or end, that wait
(`time_delay`) or that remember (`joint_elasticity`, `backlash`) need to know of time: where samples are given with
their times they count in full; where they are not, what is there to stay counts, nothing waits, and gears are rigid.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pydrake.common.yaml import yaml_dump_typed
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable, MultibodyForces
from pydrake.systems.framework import Context

from twin_diagram import plant_tree, rigid_tree, scenario, series
from twin_diagram.description import EFFECTS_FILE, Arm, add_arm
from twin_diagram.effects import Effect, make
from twin_diagram.effects.elasticity import YieldingGear
from twin_diagram.effects.friction import CoulombFriction, smooth_sign
from twin_diagram.effects.friction_levels import CoupledFriction
from twin_diagram.effects.link_inertia import spatial_inertia
from twin_diagram.errors import ModelError
from twin_diagram.timeline import epochs, shifted

Array = npt.NDArray[np.float64]

FEW = 24
"""Up to this many samples a call per sample into the plant is quicker than the vectorised tree."""


class Model:
    """An arm's plant and its effects. One thread at a time: calls share a scratch context.

    All arrays are in the order of `joints`; torques are joint-side [N·m] (N for prismatic joints), frames as in Drake.

    Attributes:
        spec: where it came from, with everything resolved.
        plant: arm and gripper alone, continuous, finalized, without geometry, base at X_WB. It holds the description
            alone; effects live in this class.
        arm: the arm's indices in `plant`.
        joints: the arm's joints; n is their number.
        effects: in order; first those that the description itself states (`Effect.given`).
        present: those that count where no time is given: all but those that end.
        timed: whether an effect starts or ends.
        delay: how much later the logged torque acts [s].
        yielding: joints (s,) whose gears yield, their stiffness [N·m/rad] and half of their play [rad].
        loss: (s,) their damping over stiffness [s].
        position_index, velocity_index: (n,) of the joints in the plant's q and v.
        lower, upper, velocity_limit, effort_limit: (n,) from the description, infinite where it says nothing.
        last_link: name of the child link of the last arm joint; payloads hang on it.
        tree: the same rigid dynamics for many samples at once.
    """

    def __init__(self, plant: MultibodyPlant, arm: Arm, effects: Iterable[Effect]) -> None:
        """Use `load`."""
        self.plant = plant
        self.arm = arm
        self.joints = arm.joints
        added = tuple(effect for effect in effects if not effect.given)
        self.effects = (*_given(arm), *added)
        self.spec = replace(arm.spec, joints=list(arm.joints), effects=[effect.spec() for effect in added])
        joints = [plant.get_joint(index) for index in arm.joint_indices]
        actuators = [plant.get_joint_actuator(index) for index in arm.actuator_indices]
        self.position_index = np.array([joint.position_start() for joint in joints])
        self.velocity_index = np.array([joint.velocity_start() for joint in joints])
        self.lower = np.array([float(joint.position_lower_limits()[0]) for joint in joints])
        self.upper = np.array([float(joint.position_upper_limits()[0]) for joint in joints])
        self.velocity_limit = np.array([float(joint.velocity_upper_limits()[0]) for joint in joints])
        self.effort_limit = np.array([actuator.effort_limit() for actuator in actuators])
        self.last_link: str = plant.get_body(arm.last_link).name()

        self.timed = any(effect.timed for effect in self.effects)
        self.present = tuple(
            effect.always() if effect.timed else effect for effect in self.effects if effect.end is None
        )
        self.delay = float(sum(effect.delay for effect in self.present))
        self._epochs: dict[tuple[bool, ...], Model] = {}
        self._runs: dict[str, Model] = {}

        self._context = plant.CreateDefaultContext()
        self._check_names()
        self._fold()
        self.tree = plant_tree.from_plant(plant, self._context, arm)
        self._vectorises = plant_tree.is_whole(plant)
        self._laws = tuple(effect for effect in self.present if not effect.folds)
        self._dry = tuple(effect for effect in self._laws if effect.dry)
        self._coupled = tuple(effect for effect in self._laws if isinstance(effect, CoupledFriction))
        self.yielding, self.loss = series.merged(
            [
                (self.joints.index(joint), gear)
                for effect in self.present
                if isinstance(effect, YieldingGear)
                for joint, gear in effect.gears().items()
            ]
        )
        self._forces = MultibodyForces(plant)
        self._world = plant.world_frame()
        self._tool = plant.get_frame(arm.tool_frame)
        # Typed loosely: Drake's stubs and NumPy's do not agree on what an array is.
        self._q: Any = plant.GetPositions(self._context).copy()
        self._v: Any = np.zeros(plant.num_velocities())
        self._a: Any = np.zeros(plant.num_velocities())
        self._origin: Any = np.zeros(3)
        self._block = np.ix_(self.velocity_index, self.velocity_index)

    @staticmethod
    def load(
        spec_or_path: scenario.ArmModel | str | Path,
        packages: Mapping[str, str | Path] | None = None,
        base_dir: str | Path | None = None,
    ) -> Model:
        """Reads a description, or the folder of a corrected model.

        Args:
            spec_or_path: an arm of a scenario, or the path of a URDF, SDF, MJCF or .dmd.yaml file or of a folder.
            packages: local folders for `package://` names.
            base_dir: folder that relative paths are looked up in first.

        Raises:
            ModelError: see `description.add_arm` and `effects.make`.
        """
        plant = MultibodyPlant(0.0)
        arm = add_arm(plant, spec_or_path, packages, base_dir)
        effects = [make(spec) for spec in arm.spec.effects]
        try:
            plant.Finalize()
        except RuntimeError as error:
            raise ModelError(f"{arm.spec.model}: {str(error).splitlines()[0]}") from error
        return Model(plant, arm, effects)

    def for_run(self, mark: str) -> Model:
        """The model as it holds for one run: onsets and ends that are about another, earlier one are over.

        Args:
            mark: `logs.fingerprint` of the run.
        """
        if all(effect.log in ("", mark) for effect in self.effects):
            return self
        if mark not in self._runs:
            kept = [effect for effect in self.effects if effect.log in ("", mark) or effect.end is None]
            self._runs[mark] = self.with_effects(
                [effect if effect.log in ("", mark) else effect.always() for effect in kept]
            )
        return self._runs[mark]

    def with_effects(self, effects: Iterable[Effect]) -> Model:
        """The same description with other effects; shares the plant, not the scratch.

        What the description itself states stays, whether it is among `effects` or not.
        """
        return Model(self.plant, self.arm, effects)

    def make_context(self) -> Context:
        """A context of `plant` whose parameters hold what effects change in the rigid model (payload, rotors, dampers).

        For those who call the plant themselves; it is theirs.
        """
        return self._context.Clone()

    def save(self, folder: str | Path) -> None:
        """Writes the description and `effects.yaml`; an existing folder is replaced once all is written.

        Files that the description names by relative paths are named by absolute ones in the copy.
        """
        folder = Path(folder).absolute()
        folder.parent.mkdir(parents=True, exist_ok=True)
        description = Path(self.spec.model)
        saved = replace(self.spec, model=description.name)
        staging = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
        try:
            (staging / description.name).write_bytes(_anchor_files(description))
            yaml_dump_typed(saved, filename=str(staging / EFFECTS_FILE))
            staging.chmod(0o755)
            if folder.exists():
                aside = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
                os.replace(folder, aside / folder.name)
                os.replace(staging, folder)
                shutil.rmtree(aside)
            else:
                os.replace(staging, folder)
        except BaseException:
            shutil.rmtree(staging, ignore_errors=True)
            raise

    # Dynamics.

    def inverse_dynamics(
        self,
        q: Array,
        v: Array,
        a: Array,
        tau: Array | None = None,
        time: Array | None = None,
        seen: Array | None = None,
    ) -> Array:
        """The torque that the motors must give, as their log would show it.

        Args:
            q: (…, n) measured positions [rad].
            v: (…, n) velocities [rad/s].
            a: (…, n) accelerations [rad/s²].
            tau: (…, n) torque that the joints transmit, for friction that depends on load; None: that of the rigid arm.
            time: (N,) of samples (N, n) of one run at a constant rate [s]; None: samples have nothing to do with each
                other.
            seen: (…, n) logged torque, for what the motion alone does not tell: what is logged but never reaches a
                joint (saturation), and what dry friction holds at rest; None: the latter is then none.

        Returns:
            (…, n) [N·m]
        """
        if time is not None and self.timed:
            result = np.empty_like(q)
            for mask, static in self.epochs(time):
                result[mask] = static.inverse_dynamics(q, v, a, tau, time, seen)[mask]
            return result
        q = self.true_position(q)
        total = self.joint_load(q, v, a, tau)
        if time is not None and len(self.yielding[0]) and len(time) > 1:
            beyond = None if seen is None else self.applied(seen, time) - total
            period = (time[-1] - time[0]) / (len(time) - 1)
            total = total + series.twist(self, q, v, a, period, beyond).torque
        if seen is not None and (self._dry or self._coupled) and q.ndim == 2:
            total = self._held(total, q, v, seen if time is None else self.applied(seen, time))
        shown: list[Array] = []
        if seen is not None and any(effect.loses for effect in self._laws):
            arrived = seen if time is None else shifted(seen, time, -self.delay)
            for effect in self._laws:
                shown.append(arrived)
                arrived = effect.applied(self.joints, arrived)
        for k, effect in reversed(list(enumerate(self._laws))):
            if shown and effect.loses:
                total = total + shown[k] - effect.applied(self.joints, shown[k])
            else:
                total = effect.logged(self.joints, total)
        return total if time is None else shifted(total, time, self.delay)

    def _held(self, total: Array, q: Array, v: Array, arrived: Array) -> Array:
        """Joint loads (N, n) in which dry friction at rest holds what it can of the torque that arrived."""
        for effect in self._coupled:
            along, level = effect.direction(self), float(effect.value("torque")[0])
            sliding = smooth_sign(v @ along)
            friction = level * sliding
            held = np.clip((arrived - total) @ along / np.sum(along) + friction, -level, level)
            total = total + np.outer((1.0 - sliding**2) * (held - friction), along)
        if not self._dry:
            return total
        forward, backward = self.friction_level(q, v, arrived)
        sliding = smooth_sign(v)
        friction = np.where(v >= 0.0, forward, backward) * sliding
        held = np.clip(arrived - (total - friction), -backward, forward)
        return np.asarray(total + (1.0 - sliding**2) * (held - friction))

    def epochs(self, time: Array) -> list[tuple[npt.NDArray[np.bool_], Model]]:
        """Which samples (N,) each model without onsets holds for."""
        result = []
        for active, mask in epochs(self.effects, time):
            if active not in self._epochs:
                kept = [effect.always() for effect, on in zip(self.effects, active, strict=True) if on]
                self._epochs[active] = self.with_effects(kept)
            result.append((mask, self._epochs[active]))
        return result

    def mass_matrix(self, q: Array) -> Array:
        """(n, n) mass matrix [kg·m²] at measured positions (n,): arm, rotors, payload; fingers held rigid."""
        return self._mass(self.true_position(q))

    def bias(self, q: Array, v: Array) -> Array:
        """(n,) torque [N·m] at velocity (n,) and position (n,) without acceleration: C v − g and effects."""
        return self.inverse_dynamics(q, v, np.zeros_like(q))

    def forward_dynamics(self, q: Array, v: Array, tau: Array) -> Array:
        """(…, n) accelerations [rad/s²] under logged torques `tau` (…, n)."""
        q, tau = self.true_position(q), self.applied(tau)
        if q.ndim == 1 and not self._dry:
            load = self.joint_load(q, v, np.zeros_like(q), tau)
            once: Any = np.linalg.solve(self._mass(q), tau - load)
            return np.asarray(once)
        flat = (-1, q.shape[-1])
        mass, load = self.mass_and_load(q.reshape(flat), v.reshape(flat), tau.reshape(flat))
        acceleration: Any = np.linalg.solve(mass, (tau.reshape(flat) - load)[..., None])
        return np.asarray(acceleration.reshape(q.shape))

    def joint_load(self, q: Array, v: Array, a: Array, tau: Array | None = None) -> Array:
        """The torque (…, n) that must reach the joints: `inverse_dynamics` at true positions, before the motor."""
        rigid = self._rigid(q, v, a)
        if not self._laws:
            return rigid
        flat = (-1, q.shape[-1])
        total: Array = rigid.reshape(flat)
        motion = (q.reshape(flat), v.reshape(flat), a.reshape(flat))
        for effect in self._laws:
            if not effect.dry:
                total = total + effect.torque(self, *motion, total)
        transmitted = total if tau is None else np.reshape(tau, flat)
        for effect in self._dry:
            total = total + effect.torque(self, *motion, transmitted)
        return total.reshape(q.shape)

    def link_load(self, q: Array, v: Array, a: Array) -> Array:
        """The part (N, n) of `joint_load` that lies behind an elastic gear: without rotors, dampers and friction."""
        tree = replace(self.tree, rotor=np.zeros_like(self.tree.rotor), damping=np.zeros_like(self.tree.damping))
        total = tree.inverse_dynamics(q, v, a)
        for effect in self._laws:
            if not effect.motor_side:
                total = total + effect.torque(self, q, v, a, total)
        return total

    def mass_and_load(self, q: Array, v: Array, tau: Array, *, dry: bool = True) -> tuple[Array, Array]:
        """Mass matrices (N, n, n) and loads without acceleration (N, n), at true positions (N, n), for integrators.

        Args:
            q: (N, n) true positions [rad].
            v: (N, n) velocities [rad/s].
            tau: (N, n) torques that the joints transmit [N·m].
            dry: with the smooth law of dry friction; an integrator that solves for it leaves it out.
        """
        if self._vectorises:
            mass, load = self.tree.mass_and_bias(q, v)
        else:
            mass = np.array([self._mass(x) for x in q])
            load = self._rigid(q, v, np.zeros_like(q))
        a = np.zeros_like(q)
        for effect in self._laws:
            if not effect.dry:
                load = load + effect.torque(self, q, v, a, tau)
        if dry and self._dry:
            forward, backward = self.friction_level(q, v, tau)
            load = load + np.where(v >= 0.0, forward, backward) * smooth_sign(v)
        return mass, load

    def motor_load(self, q: Array, v: Array, tau: Array) -> Array:
        """The part (N, n) of the loads of `mass_and_load` without dry friction that lies before an elastic gear."""
        load = self.tree.damping * v
        a = np.zeros_like(q)
        for effect in self._laws:
            if effect.motor_side and not effect.dry:
                load = load + effect.torque(self, q, v, a, tau)
        return load

    def friction_level(self, q: Array, v: Array, tau: Array) -> tuple[Array, Array]:
        """Bounds (N, n) of all dry friction against positive and against negative motion [N·m]."""
        forward, backward = np.zeros_like(q), np.zeros_like(q)
        for effect in self._dry:
            up, down = effect.friction_level(self, q, v, tau)
            forward, backward = forward + up, backward + down
        return forward, backward

    def applied(self, tau: Array, time: Array | None = None) -> Array:
        """The torque (…, n) that reaches the joints when `tau` is logged; `time` (N,) as in `inverse_dynamics`."""
        if time is not None and self.timed:
            result = np.empty_like(tau)
            for mask, static in self.epochs(time):
                result[mask] = static.applied(tau, time)[mask]
            return result
        if time is not None:
            tau = shifted(tau, time, -self.delay)
        for effect in self._laws:
            tau = effect.applied(self.joints, tau)
        return tau

    def true_position(self, q: Array) -> Array:
        """The joint positions (…, n) when `q` is measured."""
        for effect in self._laws:
            q = effect.true_position(self.joints, q)
        return q

    def measured_position(self, q: Array) -> Array:
        """What encoders read (…, n) at joint positions `q`."""
        for effect in reversed(self._laws):
            q = effect.measured_position(self.joints, q)
        return q

    def _mass(self, q: Array) -> Array:
        """(n, n) at true positions (n,)."""
        self._q[self.position_index] = q
        self.plant.SetPositions(self._context, self._q)
        mass: Array = self.plant.CalcMassMatrix(self._context)[self._block]
        return mass

    def _rigid(self, q: Array, v: Array, a: Array) -> Array:
        """(…, n) without the effects that are laws of their own."""
        if q.ndim == 1:
            return self._rigid_once(q, v, a)
        flat = (-1, q.shape[-1])
        q, v, a, shape = q.reshape(flat), v.reshape(flat), a.reshape(flat), q.shape
        if self._vectorises and len(q) > FEW:
            return self.tree.inverse_dynamics(q, v, a).reshape(shape)
        return np.array([self._rigid_once(*sample) for sample in zip(q, v, a, strict=True)]).reshape(shape)

    def _rigid_once(self, q: Array, v: Array, a: Array) -> Array:
        plant, context = self.plant, self._context
        self._q[self.position_index] = q
        self._v[self.velocity_index] = v
        self._a[self.velocity_index] = a
        plant.SetPositions(context, self._q)
        plant.SetVelocities(context, self._v)
        plant.CalcForceElementsContribution(context, self._forces)
        result: Array = plant.CalcInverseDynamics(context, self._a, self._forces)[self.velocity_index]
        return result

    # Kinematics.

    def tool_pose(self, q: Array) -> RigidTransform:
        """X_WT of the tool frame at measured positions (n,)."""
        self._q[self.position_index] = self.true_position(q)
        self.plant.SetPositions(self._context, self._q)
        return self._tool.CalcPoseInWorld(self._context)

    def tool_jacobian(self, q: Array) -> Array:
        """(6, n): angular [rad/s] over linear [m/s] velocity of the tool frame in W, per joint velocity."""
        self._q[self.position_index] = self.true_position(q)
        self.plant.SetPositions(self._context, self._q)
        jacobian: Array = self.plant.CalcJacobianSpatialVelocity(
            self._context, JacobianWrtVariable.kV, self._tool, self._origin, self._world, self._world
        )[:, self.velocity_index]
        return jacobian

    def arm_positions(self, q_plant: Array) -> Array:
        """The arm's part (…, n) of plant positions (…, nq)."""
        return np.asarray(q_plant)[..., self.position_index]

    def body_of(self, link: str) -> tuple[int, RigidTransform]:
        """Which body of `tree` carries a link (-1: it stands still), and X_ML of the link in that body's frame."""
        body = self.plant.GetBodyByName(link)
        return plant_tree.carrier(self.plant, self._context, self.arm, body)

    # What the constructor does.

    def _check_names(self) -> None:
        for effect in self.effects:
            for joint in effect.joints:
                if joint not in self.joints:
                    raise ModelError(
                        f"effects.{effect.name}.joints: the arm has no joint {joint!r}; its joints are "
                        f"{', '.join(self.joints)}"
                    )
            for link in effect.links:
                if not self.plant.HasBodyNamed(link):
                    raise ModelError(f"effects.{effect.name}.links: the model has no link {link!r}")

    def _fold(self) -> None:
        """Puts what effects change in the rigid model into the scratch context's parameters."""
        rotors: dict[str, float] = {}
        dampers: dict[str, float] = {}
        for effect in self.present:
            change = effect.change(self)
            for link, added in change.inertia.items():
                body = self.plant.GetBodyByName(link)
                present = body.CalcSpatialInertiaInBodyFrame(self._context)
                whole = rigid_tree.inertia_vector(present, RigidTransform()) + added
                body.SetSpatialInertiaInBodyFrame(self._context, spatial_inertia(whole))
            for name, reflected in change.rotor.items():
                rotors[name] = rotors.get(name, 0.0) + reflected
            for name, damping in change.damping.items():
                dampers[name] = dampers.get(name, 0.0) + damping
        for name, reflected in rotors.items():
            actuator = self.arm.actuator(self.plant, name)
            rotor = actuator.rotor_inertia(self._context) + reflected / actuator.gear_ratio(self._context) ** 2
            _check_whole("reflected_inertia.inertia", name, rotor, "kg·m²")
            actuator.SetRotorInertia(self._context, max(rotor, 0.0))
        for name, damping in dampers.items():
            joint = self.plant.get_joint(self.arm.joint_indices[self.joints.index(name)])
            total: Any = joint.GetDampingVector(self._context) + damping
            _check_whole("viscous_friction.damping", name, float(total[0]), "N·m·s/rad")
            joint.SetDampingVector(self._context, np.maximum(total, 0.0))
        levels = np.zeros((2, len(self.joints)))
        for effect in self.present:
            if isinstance(effect, CoulombFriction):
                levels += [effect.spread(self.joints, level) for level in effect.levels()]
        for name, level in zip(self.joints, np.min(levels, axis=0), strict=True):
            _check_whole("coulomb_friction.torque", name, float(level), "N·m")


def _check_whole(key: str, joint: str, value: float, unit: str) -> None:
    """Effects may take away no more than the description and other effects state."""
    if value < -1e-9:
        raise ModelError(
            f"effects.{key}: {value:g} {unit} in all on {joint} is not within [0, inf]; take away no more than there is"
        )


def _given(arm: Arm) -> list[Effect]:
    effects = [make(spec) for spec in arm.given]
    for effect in effects:
        effect.given = True
    return effects


_RELATIVE_FILE = re.compile(rb"""(<uri>|filename\s*=\s*["']|\bfile\s*=\s*["'])\s*([^"'<>]+?)\s*(?=["'<])""")


def _anchor_files(description: Path) -> bytes:
    """The description's text, with the files beside it that it names named by absolute paths."""

    def anchored(match: re.Match[bytes]) -> bytes:
        path = description.parent / os.fsdecode(match[2])
        return match[1] + os.fsencode(path.resolve()) if b"://" not in match[2] and path.is_file() else match[0]

    return _RELATIVE_FILE.sub(anchored, description.read_bytes())
