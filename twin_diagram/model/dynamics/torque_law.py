"""What reaches an arm's joints: the rigid bodies' torque and every effect's law, for many samples at once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.model.dynamics.elastic_gears import Twist, Untwisted, YieldingJoints, in_series, twist
from twin_diagram.model.dynamics.onsets import shifted
from twin_diagram.model.effects.effect import Effect
from twin_diagram.model.effects.elasticity import YieldingGear
from twin_diagram.model.effects.friction import smooth_sign
from twin_diagram.model.effects.friction_stribeck_load import CoupledFriction
from twin_diagram.model.rigid_body.arm_bodies import ArmBodies
from twin_diagram.model.rigid_body.plant_calls import PlantCalls
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, from the time that calls take; results do not depend on them."""

    few: int = 24
    """Up to this many samples a call per sample into the plant is quicker than the vectorised tree."""


TUNING = Tuning()


class TorqueLaw:
    """The torque of an arm's bodies and of effects without onset or end; positions are true ones here.

    Attributes:
        bodies: of the arm, with what effects change in them.
        laws: the effects that are no part of the rigid bodies, those beside the motor last.
        dry, coupled: of them, by kind of friction.
        delay: how much later the logged torque acts [s].
        yielding: the joints whose gears yield.
    """

    def __init__(self, bodies: ArmBodies, calls: PlantCalls, effects: Iterable[Effect], *, vectorises: bool) -> None:
        """Sort the effects by what they act on.

        Args:
            bodies: of the arm.
            calls: into its plant, with the same parameters.
            effects: without onsets and ends.
            vectorises: whether the bodies' tree holds all that the plant does.
        """
        effects = tuple(effects)
        self.bodies = bodies
        self.laws = tuple(sorted((e for e in effects if not e.folds), key=lambda effect: effect.last))
        self.dry = tuple(effect for effect in self.laws if effect.dry)
        self.coupled = tuple(effect for effect in self.laws if isinstance(effect, CoupledFriction))
        self.delay = float(sum(effect.delay for effect in effects))
        self.yielding: YieldingJoints = in_series(
            [
                (bodies.joints.index(joint), gear)
                for effect in effects
                if isinstance(effect, YieldingGear)
                for joint, gear in effect.gears().items()
            ]
        )
        self._calls, self._vectorises = calls, vectorises
        tree = bodies.tree
        self._links = replace(tree, rotor=np.zeros_like(tree.rotor), damping=np.zeros_like(tree.damping))

    def rigid(self, q: Array, v: Array, a: Array) -> Array:
        """Return the torque (…, n) of the bodies alone."""
        if q.ndim == 1:
            return self._calls.inverse_dynamics(q, v, a)
        flat = (-1, q.shape[-1])
        q, v, a, shape = q.reshape(flat), v.reshape(flat), a.reshape(flat), q.shape
        if self._vectorises and len(q) > TUNING.few:
            return self.bodies.tree.inverse_dynamics(q, v, a).reshape(shape)
        return np.array([self._calls.inverse_dynamics(*sample) for sample in zip(q, v, a, strict=True)]).reshape(shape)

    def joint_load(self, q: Array, v: Array, a: Array, tau: Array | None = None) -> Array:
        """Return the torque (…, n) that must reach the joints, before the motor.

        Args:
            q: (…, n) true positions [rad].
            v: (…, n) velocities [rad/s].
            a: (…, n) accelerations [rad/s²].
            tau: (…, n) that the joints transmit, for friction that depends on load; None: that of the rigid arm.
        """
        bodies = self.rigid(q, v, a)
        if not self.laws:
            return bodies
        flat = (-1, q.shape[-1])
        total: Array = bodies.reshape(flat)
        motion = (q.reshape(flat), v.reshape(flat), a.reshape(flat))
        for effect in self.laws:
            if not effect.dry:
                total = total + effect.torque(self.bodies, *motion, total)
        transmitted = total if tau is None else np.reshape(tau, flat)
        for effect in self.dry:
            total = total + effect.torque(self.bodies, *motion, transmitted)
        return total.reshape(q.shape)

    def link_load(self, q: Array, v: Array, a: Array) -> Array:
        """Return the part (N, n) of `joint_load` behind an elastic gear: without rotors, dampers and friction."""
        total = self._links.inverse_dynamics(q, v, a)
        for effect in self.laws:
            if not effect.motor_side:
                total = total + effect.torque(self.bodies, q, v, a, total)
        return total

    def twist(
        self,
        motion: tuple[Array, Array, Array],
        period: float,
        beyond: Array | None = None,
        bare: Untwisted | None = None,
    ) -> Twist:
        """Work out how the yielding gears twist; arguments as of `elastic_gears.twist`, at true positions."""
        return twist(self.bodies.tree, self.link_load, self.yielding, motion, period, beyond, bare)

    def mass_and_load(self, q: Array, v: Array, tau: Array, *, dry: bool = True) -> tuple[Array, Array]:
        """Return mass matrices (N, n, n) and loads without acceleration (N, n), for integrators.

        Args:
            q: (N, n) true positions [rad].
            v: (N, n) velocities [rad/s].
            tau: (N, n) torques that the joints transmit [N·m].
            dry: with the smooth law of dry friction; an integrator that solves for it leaves it out.
        """
        if self._vectorises:
            mass, load = self.bodies.tree.mass_and_bias(q, v)
        else:
            mass = np.array([self._calls.mass(x) for x in q])
            load = self.rigid(q, v, np.zeros_like(q))
        a = np.zeros_like(q)
        for effect in self.laws:
            if not effect.dry:
                load = load + effect.torque(self.bodies, q, v, a, tau)
        if dry and self.dry:
            forward, backward = self.friction_level(q, v, tau)
            load = load + np.where(v >= 0.0, forward, backward) * smooth_sign(v)
        return mass, load

    def motor_load(self, q: Array, v: Array, tau: Array) -> Array:
        """Return the part (N, n) of `mass_and_load`'s loads before an elastic gear, without dry friction."""
        load = self.bodies.tree.damping * v
        a = np.zeros_like(q)
        for effect in self.laws:
            if effect.motor_side and not effect.dry:
                load = load + effect.torque(self.bodies, q, v, a, tau)
        return load

    def friction_level(self, q: Array, v: Array, tau: Array) -> tuple[Array, Array]:
        """Return bounds (N, n) of all dry friction against positive and against negative motion [N·m]."""
        forward, backward = np.zeros_like(q), np.zeros_like(q)
        for effect in self.dry:
            up, down = effect.friction_level(self.bodies, q, v, tau)
            forward, backward = forward + up, backward + down
        return forward, backward

    def held(self, total: Array, q: Array, v: Array, arrived: Array) -> Array:
        """Return joint loads (N, n) in which dry friction at rest holds what it can of the torque that arrived."""
        for effect in self.coupled:
            along, level = effect.direction(self.bodies), float(effect.value("torque")[0])
            sliding = smooth_sign(v @ along)
            friction = level * sliding
            held = np.clip((arrived - total) @ along / np.sum(along) + friction, -level, level)
            total = total + np.outer((1.0 - sliding**2) * (held - friction), along)
        if not self.dry:
            return total
        forward, backward = self.friction_level(q, v, arrived)
        sliding = smooth_sign(v)
        friction = np.where(v >= 0.0, forward, backward) * sliding
        held = np.clip(arrived - (total - friction), -backward, forward)
        return np.asarray(total + (1.0 - sliding**2) * (held - friction))

    def applied(self, tau: Array) -> Array:
        """Return the torque (…, n) that reaches the joints when `tau` is logged and nothing waits."""
        for effect in self.laws:
            tau = effect.applied(self.bodies.joints, tau)
        return tau

    def logged(self, total: Array, seen: Array | None, time: Array | None) -> Array:
        """Return what motors log (N, n), when it acts, where `total` reaches the joints.

        Args:
            total: (N, n) [N·m].
            seen: (N, n) logged torque, for what never reaches a joint; None: nothing is lost.
            time: (N,) of the samples, where `seen` is a run [s].
        """
        shown: list[Array] = []
        if seen is not None and any(effect.loses for effect in self.laws):
            arrived = seen if time is None else shifted(seen, time, -self.delay)
            for effect in self.laws:
                shown.append(arrived)
                arrived = effect.applied(self.bodies.joints, arrived)
        for k, effect in reversed(list(enumerate(self.laws))):
            if shown and effect.loses:
                total = total + shown[k] - effect.applied(self.bodies.joints, shown[k])
            else:
                total = effect.logged(self.bodies.joints, total)
        return total

    def true_position(self, q: Array) -> Array:
        """Return the joint positions (…, n) when `q` is measured."""
        for effect in self.laws:
            q = effect.true_position(self.bodies.joints, q)
        return q

    def measured_position(self, q: Array) -> Array:
        """Return what encoders read (…, n) at joint positions `q`."""
        for effect in reversed(self.laws):
            q = effect.measured_position(self.bodies.joints, q)
        return q
