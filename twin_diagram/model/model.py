"""The twin's physics: an arm's plant and the effects that its description lacks.

Simulator, filter, rollouts and gap workflow share it. The torque law reads

    logged torque = actuation⁻¹( M(q) a + C(q, v) v − g(q) + dampers + Σ effects.torque )

with q the true positions behind the measured ones, and M with rotors and payloads. Effects that start or end, that wait
(`TimeDelay`) or that remember (`YieldingGear`) need to know of time: where samples are given with their times they
count in full; where they are not, what is there to stay counts, nothing waits, and gears are rigid.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context

from twin_diagram import scenario
from twin_diagram.errors import ArgumentError, ModelError, expect
from twin_diagram.logs.joint_limits import JointLimits
from twin_diagram.model.description import corrected_folder
from twin_diagram.model.description.add_arm import Arm, add_arm
from twin_diagram.model.dynamics import has_mass, rigid_changes
from twin_diagram.model.dynamics.onsets import epochs, shifted
from twin_diagram.model.dynamics.torque_law import TorqueLaw
from twin_diagram.model.effects import Effect, make, spec_of
from twin_diagram.model.effects.named_places import check_places
from twin_diagram.model.effects.stated import stated_effects
from twin_diagram.model.effects.timing import always, in_run
from twin_diagram.model.rigid_body import from_plant
from twin_diagram.model.rigid_body.arm_bodies import ArmBodies, DescribedLinks
from twin_diagram.model.rigid_body.plant_calls import PlantCalls
from twin_diagram.scenario import EffectSpec
from twin_diagram.signals.arrays import Array


class Model:
    """An arm's plant and its effects. One thread at a time: calls share a scratch context.

    All arrays are in the order of `joints`; torques are joint-side [N·m] (N for prismatic joints), frames as in Drake.

    Attributes:
        spec: where it came from, with everything resolved.
        plant: arm and gripper alone, continuous, finalized, without geometry, base at X_WB. It holds the description
            alone; effects live in this class.
        arm: the arm's indices in `plant`.
        joints: the arm's joints; n is their number.
        prismatic: which of them are; `units.on_joint` tells the units of what is theirs.
        effects: in order; first those that the description itself states (`Effect.given`).
        present: those that count where no time is given: all but those that end.
        timed: whether an effect starts or ends.
        position_index, velocity_index: (n,) of the joints in the plant's q and v.
        lower, upper, velocity_limit, effort_limit: (n,) from the description, infinite where it says nothing.
        limits: the same for logs, which know nothing of models.
        last_link: name of the child link of the last arm joint that is no finger; payloads hang on it.
        bodies: with what effects change in them; what effects may ask of the arm.
        tree: the same rigid dynamics for many samples at once.
        calls: into the plant, for single samples.
        law: the torque of bodies and effects at true positions, without onsets, delay and motors' logs.
    """

    def __new__(cls, plant: object = ..., *given: object, **named: object) -> Model:
        """Refuse a path in the place of a plant, before Python asks for what else is missing."""
        if plant is not ...:  # nothing is given where a model is copied
            expect(plant, MultibodyPlant, "Model", "a plant that was parsed (a file is read by Model.load(PATH))")
        return super().__new__(cls)

    def __init__(self, plant: MultibodyPlant, arm: Arm, effects: Iterable[Effect]) -> None:
        """Use `load`."""
        self.plant = plant
        self.arm = arm
        self.joints = arm.joints
        added = tuple(effect for effect in effects if not effect.given)
        self.prismatic = arm.prismatic(plant)
        self.effects = tuple(effect.on_arm(self.prismatic) for effect in (*stated_effects(arm), *added))
        self.spec = replace(arm.spec, joints=list(arm.joints), effects=[spec_of(effect) for effect in added])
        joints = [plant.get_joint(index) for index in arm.joint_indices]
        actuators = [plant.get_joint_actuator(index) for index in arm.actuator_indices]
        self.lower = np.array([float(joint.position_lower_limits()[0]) for joint in joints])
        self.upper = np.array([float(joint.position_upper_limits()[0]) for joint in joints])
        limits = np.array([float(joint.velocity_upper_limits()[0]) for joint in joints])
        self.velocity_limit = np.where(limits > 0.0, limits, np.inf)  # exporters write 0 for what they do not know
        self.effort_limit = np.array([actuator.effort_limit() for actuator in actuators])
        revolute = np.array([joint not in self.prismatic for joint in self.joints])
        self.limits = JointLimits(self.joints, revolute, self.lower, self.upper, self.effort_limit)
        links = DescribedLinks(plant, arm)
        self.last_link = links.last_link

        self.timed = any(effect.when.timed for effect in self.effects)
        self.present = tuple(
            always(effect) if effect.when.timed else effect for effect in self.effects if effect.when.end is None
        )
        self._epochs: dict[tuple[bool, ...], Model] = {}
        self._runs: dict[str, Model] = {}

        self._context = plant.CreateDefaultContext()
        self.calls = PlantCalls(plant, self._context, arm)
        self.position_index, self.velocity_index = self.calls.position_index, self.calls.velocity_index
        check_places(plant, arm, self.effects)
        rigid_changes.fold(plant, self._context, arm, (effect.change(links) for effect in self.present))
        rigid_changes.check_friction(self.joints, self.present, self.prismatic)
        self.bodies = ArmBodies(arm, links, self._context)
        self.tree = self.bodies.tree
        self.law = TorqueLaw(self.bodies, self.calls, self.present, vectorises=from_plant.is_whole(plant))

    @staticmethod
    def load(
        spec_or_path: scenario.ArmModel | str | Path,
        packages: Mapping[str, str | Path] | None = None,
        base_dir: str | Path | None = None,
        torque_side: str | None = None,
    ) -> Model:
        """Read a description, or the folder of a corrected model.

        Args:
            spec_or_path: an arm of a scenario, or the path of a URDF, SDF, MJCF or .dmd.yaml file or of a folder.
            packages: local folders for `package://` names.
            base_dir: folder that relative paths are looked up in first.
            torque_side: of the gears that torques are measured on: `motor`, or `link`, where no rotor of its own shows;
                None: as the folder of a corrected model says, else `motor`.

        Raises:
            ModelError: see `add_arm.add_arm` and `effects.make`; or no such side.
        """
        plant = MultibodyPlant(0.0)
        if torque_side is not None and torque_side not in corrected_folder.TORQUE_SIDES:
            raise ModelError(f"torque side {torque_side!r}: it is one of {', '.join(corrected_folder.TORQUE_SIDES)}")
        arm = add_arm(plant, spec_or_path, packages, base_dir)
        recorded = corrected_folder.standing_of(Path(arm.spec.model).parent).torque_side
        if (torque_side or recorded) == "link":
            arm = arm.behind_gears(plant)
        effects = [make(spec) for spec in arm.spec.effects]
        try:
            plant.Finalize()
        except RuntimeError as error:
            raise ModelError(f"{arm.spec.model}: {str(error).splitlines()[0]}") from error
        model = Model(plant, arm, effects)
        has_mass.check(arm.spec.model, model.joints, model.calls.mass)
        return model

    def for_run(self, mark: str) -> Model:
        """Return the model as it holds for one run: each effect as `timing.in_run` says.

        Args:
            mark: `logs.fingerprint` of the run.
        """
        if all(effect.when.log in ("", mark) for effect in self.effects):
            return self
        if mark not in self._runs:
            here = (in_run(effect, mark) for effect in self.effects)
            self._runs[mark] = self.with_effects([effect for effect in here if effect is not None])
        return self._runs[mark]

    def with_effects(self, effects: Effect | EffectSpec | Iterable[Effect | EffectSpec]) -> Model:
        """Return the same description with other effects; shares the plant, not the scratch.

        What the description itself states stays, whether it is among `effects` or not.

        Args:
            effects: one or several, or what specifies them.

        Raises:
            ArgumentError: something else.
            ModelError: see `effects.make`.
        """
        several = effects if isinstance(effects, Iterable) else [effects]
        made = [make(one) if isinstance(one, EffectSpec) else one for one in several]
        for one in made:
            expect(one, Effect, "effects", "one or several of Effect or EffectSpec")
        return Model(self.plant, self.arm, made)

    def make_context(self) -> Context:
        """Return a context of `plant` whose parameters hold what effects change in the rigid model.

        Payload, rotors, dampers.

        For those who call the plant themselves; it is theirs.
        """
        return self._context.Clone()

    def save(self, folder: str | Path, standing: corrected_folder.CorrectedStanding | None = None) -> None:
        """Write the description and `effects.yaml`; an existing folder is replaced once all is written.

        Files that the description names by relative paths are named by absolute ones in the copy.

        Args:
            folder: to be written.
            standing: what is known of it as a corrected model; its torque's side is always said.
        """
        side = "link" if self.arm.link_side else "motor"
        known = replace(standing or corrected_folder.CorrectedStanding(), torque_side=side)
        corrected_folder.write(self.spec, folder, known)

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
        """Return the torque that the motors must give, as their log would show it.

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
        q, v, a = _samples(len(self.joints), q=q, v=v, a=a)
        if time is not None and self.timed:
            result = np.empty_like(q)
            for mask, static in self.epochs(time):
                if static.law.delay or len(static.law.yielding):  # what comes before counts
                    result[mask] = static.inverse_dynamics(q, v, a, tau, time, seen)[mask]
                else:
                    through, logged = (None if x is None else x[mask] for x in (tau, seen))
                    result[mask] = static.inverse_dynamics(q[mask], v[mask], a[mask], through, seen=logged)
            return result
        q = self.true_position(q)
        law = self.law
        total = law.joint_load(q, v, a, tau)
        if time is not None and len(law.yielding) and len(time) > 1:
            beyond = None if seen is None else self.applied(seen, time) - total
            period = (time[-1] - time[0]) / (len(time) - 1)
            total = total + law.twist((q, v, a), period, beyond).torque
        if seen is not None and (law.dry or law.coupled) and q.ndim == 2:
            total = law.held(total, q, v, self.applied(seen, time))
        total = law.logged(total, seen, time)
        return total if time is None else shifted(total, time, law.delay)

    def epochs(self, time: Array) -> list[tuple[npt.NDArray[np.bool_], Model]]:
        """Return which samples (N,) each model without onsets holds for."""
        result = []
        for active, mask in epochs(self.effects, time):
            if active not in self._epochs:
                kept = [always(effect) for effect, on in zip(self.effects, active, strict=True) if on]
                self._epochs[active] = self.with_effects(kept)
            result.append((mask, self._epochs[active]))
        return result

    def mass_matrix(self, q: Array) -> Array:
        """Return (n, n) mass matrix [kg·m²] at measured positions (n,): arm, rotors, payload; fingers held rigid."""
        return self.calls.mass(self.true_position(*_samples(len(self.joints), q=q)))

    def bias(self, q: Array, v: Array) -> Array:
        """Return (n,) torque without acceleration [N·m]: C(q, v) v − g(q), and that of effects.

        Args:
            q: (n,) measured positions [rad].
            v: (n,) velocities [rad/s].
        """
        return self.inverse_dynamics(q, v, np.zeros_like(q))

    def forward_dynamics(self, q: Array, v: Array, tau: Array) -> Array:
        """Return (…, n) accelerations under logged torques, each sample by itself [rad/s²].

        Args:
            q: (…, n) measured positions [rad].
            v: (…, n) velocities [rad/s].
            tau: (…, n) torques as the log shows them [N·m].

        Raises:
            ArgumentError: not as many numbers as joints, or, of a single sample, one that is not finite.
        """
        q, v, tau = _samples(len(self.joints), q=q, v=v, tau=tau)
        q, tau = self.true_position(q), self.applied(tau)
        if q.ndim == 1 and not self.law.dry:
            load = self.law.joint_load(q, v, np.zeros_like(q), tau)
            once: Any = np.linalg.solve(self.calls.mass(q), tau - load)
            return np.asarray(once)
        flat = (-1, q.shape[-1])
        mass, load = self.law.mass_and_load(q.reshape(flat), v.reshape(flat), tau.reshape(flat))
        acceleration: Any = np.linalg.solve(mass, (tau.reshape(flat) - load)[..., None])
        return np.asarray(acceleration.reshape(q.shape))

    def applied(self, tau: Array, time: Array | None = None) -> Array:
        """Return the torque (…, n) that reaches the joints [N·m].

        Args:
            tau: (…, n) as logged [N·m].
            time: (N,) as in `inverse_dynamics` [s].
        """
        if time is not None and self.timed:
            result = np.empty(np.shape(tau))
            for mask, static in self.epochs(time):
                result[mask] = static.applied(tau, time)[mask]
            return result
        if time is not None:
            tau = shifted(tau, time, -self.law.delay)
        return self.law.applied(tau)

    def true_position(self, q: Array) -> Array:
        """Return the joint positions (…, n) when `q` is measured."""
        return self.law.true_position(q)

    def measured_position(self, q: Array) -> Array:
        """Return what encoders read (…, n) at joint positions `q`."""
        return self.law.measured_position(q)

    # Kinematics.

    def tool_pose(self, q: Array) -> RigidTransform:
        """Return X_WT of the tool frame at measured positions (n,)."""
        return self.calls.tool_pose(self.true_position(*_samples(len(self.joints), q=q)))

    def tool_jacobian(self, q: Array) -> Array:
        """Return (6, n): angular [rad/s] over linear [m/s] velocity of the tool frame in W, per joint velocity."""
        return self.calls.tool_jacobian(self.true_position(*_samples(len(self.joints), q=q)))


def _samples(n: int, **given: Array) -> tuple[Array, ...]:
    """Return what a model is asked with as arrays (…, n); one sample must be finite, or Drake ends the program.

    Raises:
        ArgumentError: there are not as many numbers as joints, or one of a single sample is not finite.
    """
    arrays = {name: np.asarray(values, dtype=float) for name, values in given.items()}
    for name, array in arrays.items():
        if array.shape[-1:] != (n,):
            raise ArgumentError(f"{name} has shape {array.shape}; its last axis must hold the arm's {n} joints")
        if array.ndim == 1 and not math.isfinite(array.dot(array)):  # a fifth of the time of NumPy's isfinite
            raise ArgumentError(f"{name} is {array.tolist()}; finite numbers are wanted")
    return tuple(arrays.values())
