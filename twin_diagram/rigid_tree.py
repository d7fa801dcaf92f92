"""Rigid-body dynamics of many samples at once, in numpy.

A call into the plant costs some 10 µs a sample; logs and rollouts have 10⁴ to 10⁶. Here the loop runs over joints, and
the samples are a vector. All spatial vectors are taken about the world's origin and expressed in W, so that sums along
the tree are products with its ancestor matrix (Featherstone, *Rigid Body Dynamics Algorithms*, 2008, ch. 5 and 6).
Joints outside the arm (fingers) are rigid at their default positions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BodyIndex,
    ForceElementIndex,
    Joint,
    PrismaticJoint,
    PrismaticSpring,
    RevoluteJoint,
    RevoluteSpring,
    RigidBody,
    SpatialInertia,
    UniformGravityFieldElement,
)
from pydrake.systems.framework import Context

from twin_diagram.description import Arm

Array = npt.NDArray[np.float64]

CHUNK = 4096
"""Samples worked on at a time, so that intermediate arrays stay in the cache."""


@dataclass(frozen=True)
class RigidTree:
    """The arm as n bodies, body i moved by joint i, with the constants of each.

    Attributes:
        parent: (n,) index of the body that joint i hangs on, -1 for the world.
        revolute: (n,) whether joint i turns (else it slides).
        axis: (n, 3) its axis in frame M_i.
        R_PF: (n, 3, 3), p_PF: (n, 3): joint i's fixed frame in its parent body's frame M.
        inertia: (n, 10) mass, mass × centre (3), inertia about Mo (xx, yy, zz, xy, xz, yz), in M_i [kg, kg·m, kg·m²].
        rotor: (n,) reflected rotor inertia [kg·m²] (kg where the joint slides).
        damping: (n,) [N·m·s/rad].
        stiffness: (n,), rest: (n,): of springs that the description holds [N·m/rad], [rad].
        gravity: (3,) in W [m/s²].
        link: name of each body's own link, the child link of joint i.
    """

    parent: npt.NDArray[np.int64]
    revolute: npt.NDArray[np.bool_]
    axis: Array
    R_PF: Array
    p_PF: Array
    inertia: Array
    rotor: Array
    damping: Array
    stiffness: Array
    rest: Array
    gravity: Array
    link: tuple[str, ...]

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.parent)

    @cached_property
    def ancestors(self) -> Array:
        """(n, n): 1 where joint j moves body i."""
        result = np.eye(self.n)
        for i in self.outward:
            if self.parent[i] >= 0:
                result[i] += result[self.parent[i]]
        return result

    @cached_property
    def outward(self) -> list[int]:
        """The joints with each after its parent, however the user orders them."""

        def depth(i: int) -> int:
            return 0 if self.parent[i] < 0 else 1 + depth(int(self.parent[i]))

        return sorted(range(self.n), key=depth)

    @cached_property
    def turns(self) -> Array:
        """(n, 9, 3): R_PF [1, K, K²], transposed, with K the cross product with the axis; for Rodrigues' formula."""
        result = []
        for R, axis in zip(self.R_PF, self.axis, strict=True):
            K = _skew(axis)
            result.append((R @ np.hstack([np.eye(3), K, K @ K])).T)
        return np.array(result)

    def bare(self, inertia: Array) -> RigidTree:
        """The same joints with other inertias and nothing else: no rotors, dampers or springs."""
        zero = np.zeros(self.n)
        return replace(self, inertia=inertia, rotor=zero, damping=zero, stiffness=zero, rest=zero)

    def inverse_dynamics(self, q: Array, v: Array, a: Array) -> Array:
        """Joint torques (N, n) for motions q, v, a, each (N, n): M a + C v − g + rotors, dampers and springs."""
        result = np.empty_like(q)
        for part in _chunks(len(q)):
            motion = _Kinematics.of(self, q[part].T)
            result[part] = motion.inverse_dynamics(v[part].T, a[part].T, self.gravity).T
        result += self.rotor * a + self.damping * v + self.stiffness * (q - self.rest)
        return result

    def mass_matrix(self, q: Array) -> Array:
        """Mass matrices (N, n, n) with rotors at positions (N, n)."""
        result = np.empty((len(q), self.n, self.n))
        for part in _chunks(len(q)):
            result[part] = _Kinematics.of(self, q[part].T).mass_matrix().transpose(2, 0, 1)
        result[:, np.arange(self.n), np.arange(self.n)] += self.rotor
        return result

    def mass_and_bias(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Mass matrices (N, n, n) and torques at zero acceleration (N, n), sharing the kinematics."""
        mass = np.empty((len(q), self.n, self.n))
        bias = np.empty_like(q)
        for part in _chunks(len(q)):
            motion = _Kinematics.of(self, q[part].T)
            mass[part] = motion.mass_matrix().transpose(2, 0, 1)
            bias[part] = motion.inverse_dynamics(v[part].T, None, self.gravity).T
        mass[:, np.arange(self.n), np.arange(self.n)] += self.rotor
        bias += self.damping * v + self.stiffness * (q - self.rest)
        return mass, bias

    def pushed(self, q: Array, body: int, p: Array, force: Array, moment: Array) -> Array:
        """Joint torques (N, n) that a wrench gives.

        Args:
            q: (N, n) positions [rad].
            body: that is pushed; -1 (what stands still) gives none.
            p: (3,) where, in the body's frame M [m].
            force: (3,) in W [N].
            moment: (3,) in W [N·m].
        """
        result = np.zeros_like(q)
        if body < 0:
            return result
        for part in _chunks(len(q)):
            motion = _Kinematics.of(self, q[part].T)
            point = np.einsum("abn,b->an", motion.R[:, :, body], p) + motion.p[:, body]
            about_origin = moment[:, None] + _cross(point, np.broadcast_to(force[:, None], point.shape))
            torque = np.einsum("ajn,an->jn", motion.angular, about_origin) + np.einsum(
                "ajn,a->jn", motion.linear, force
            )
            result[part] = (torque * self.ancestors[body][:, None]).T
        return result

    def regressor(self, q: Array, v: Array, a: Array, body: int) -> Array:
        """Joint torques (N, n, 10) per unit of each inertial parameter of one body, in the order of `inertia`.

        Joint torques are linear in them (Atkeson, An and Hollerbach 1986).
        """
        result = np.empty((*q.shape, 10))
        for part in _chunks(len(q)):
            motion = _Kinematics.of(self, q[part].T)
            result[part] = motion.regressor(v[part].T, a[part].T, self.gravity, body).transpose(2, 0, 1)
        return result


@dataclass(frozen=True)
class _Kinematics:
    """Positions of all bodies; arrays are (3, n, N), so that each component is contiguous over the samples."""

    tree: RigidTree
    ancestors: Array
    R: Array  # (3, 3, n, N) R_WM
    p: Array  # (3, n, N) p_WMo
    angular: Array  # (3, n, N) joint axes as spatial vectors about Wo
    linear: Array

    @staticmethod
    def of(tree: RigidTree, q: Array) -> _Kinematics:
        n, samples = q.shape
        R = np.empty((n, 3, 3, samples))
        p: Array = np.empty((n, 3, samples))
        z: Array = np.empty((n, 3, samples))
        world_R = np.broadcast_to(np.eye(3)[:, :, None], (3, 3, samples))
        for i in tree.outward:
            parent = tree.parent[i]
            R_WP = R[parent] if parent >= 0 else world_R
            p_WP = p[parent] if parent >= 0 else np.zeros((3, 1))
            if tree.revolute[i]:  # three constant products instead of one with a matrix per sample
                parts = np.matmul(tree.turns[i], R_WP)
                R[i] = parts[:, 0:3] + np.sin(q[i]) * parts[:, 3:6] + (1.0 - np.cos(q[i])) * parts[:, 6:9]
                p[i] = p_WP + np.matmul(tree.p_PF[i], R_WP)
            else:
                R[i] = np.matmul(tree.R_PF[i].T, R_WP)
                p[i] = p_WP + np.matmul(tree.p_PF[i], R_WP) + np.matmul(tree.axis[i], R[i]) * q[i]
            z[i] = np.matmul(tree.axis[i], R[i])
        p = np.ascontiguousarray(p.transpose(1, 0, 2))
        z = np.ascontiguousarray(z.transpose(1, 0, 2))
        turns = tree.revolute[:, None]
        return _Kinematics(
            tree,
            tree.ancestors,
            np.ascontiguousarray(R.transpose(1, 2, 0, 3)),
            p,
            np.where(turns, z, 0.0),
            np.where(turns, _cross(p, z), z),
        )

    def moments(self) -> tuple[Array, Array]:
        """First moments (3, n, N) and inertia tensors (3, 3, n, N) about Mo, in W."""
        h = np.einsum("abin,ib->ain", self.R, self.tree.inertia[:, 1:4])
        xx, yy, zz, xy, xz, yz = self.tree.inertia[:, 4:].T
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        RI = np.einsum("abin,bci->acin", self.R, tensor)
        return h, np.einsum("acin,bcin->abin", RI, self.R)

    def accelerations(self, v: Array, a: Array | None, gravity: Array) -> tuple[Array, Array, Array]:
        """Angular velocity, angular acceleration, and acceleration of Mo less gravity, each (3, n, N)."""
        angular_rate, linear_rate = self.angular * v, self.linear * v
        w = self.ancestors @ angular_rate
        v_O = self.ancestors @ linear_rate
        angular_change, linear_change = _cross(w, angular_rate), _cross(v_O, angular_rate) + _cross(w, linear_rate)
        if a is not None:
            angular_change += self.angular * a
            linear_change += self.linear * a
        alpha = self.ancestors @ angular_change
        a_O = self.ancestors @ linear_change - gravity[:, None, None]
        a_M = a_O + _cross(alpha, self.p) + _cross(w, v_O + _cross(w, self.p))
        return w, alpha, a_M

    def inverse_dynamics(self, v: Array, a: Array | None, gravity: Array) -> Array:
        w, alpha, a_M = self.accelerations(v, a, gravity)
        h, tensor = self.moments()
        force = self.tree.inertia[:, 0, None] * a_M + _cross(alpha, h) + _cross(w, _cross(w, h))
        moment = _apply(tensor, alpha) + _cross(w, _apply(tensor, w)) + _cross(h, a_M) + _cross(self.p, force)
        return self.project(self.ancestors.T @ moment, self.ancestors.T @ force)

    def project(self, moment: Array, force: Array) -> Array:
        """Joint torques (n, N) of spatial forces about Wo, one per body with all that it carries."""
        return np.einsum("ain,ain->in", self.angular, moment) + np.einsum("ain,ain->in", self.linear, force)

    def mass_matrix(self) -> Array:
        """(n, n, N), by composite bodies."""
        m = self.tree.inertia[:, 0, None]
        h, tensor = self.moments()
        h_O = h + m * self.p
        outer = np.einsum("ain,bin->abin", self.p, 2.0 * h + m * self.p)
        tensor_O = tensor - 0.5 * (outer + outer.transpose(1, 0, 2, 3))
        tensor_O[range(3), range(3)] += np.einsum("ain,ain->in", self.p, 2.0 * h + m * self.p)
        below = self.ancestors.T
        m, h_O, tensor_O = below @ m, below @ h_O, below @ tensor_O
        momentum = m * self.linear + _cross(self.angular, h_O)
        angular_momentum = _apply(tensor_O, self.angular) + _cross(h_O, self.linear)
        full = np.einsum("ain,ajn->ijn", angular_momentum, self.angular)
        full += np.einsum("ain,ajn->ijn", momentum, self.linear)
        lower = full * self.ancestors[:, :, None]
        diagonal = lower[range(self.tree.n), range(self.tree.n)].copy()
        result = lower + lower.transpose(1, 0, 2)
        result[range(self.tree.n), range(self.tree.n)] = diagonal
        return result

    def regressor(self, v: Array, a: Array, gravity: Array, body: int) -> Array:
        """(n, 10, N) of one body."""
        w, alpha, a_M = (x[:, body] for x in self.accelerations(v, a, gravity))
        R = self.R[:, :, body]
        samples = w.shape[-1]
        force = np.zeros((3, 10, samples))
        moment = np.zeros((3, 10, samples))
        force[:, 0] = a_M
        for k in range(3):  # a first moment along axis k
            axis = R[:, k]
            force[:, 1 + k] = _cross(alpha, axis) + _cross(w, _cross(w, axis))
            moment[:, 1 + k] = _cross(axis, a_M)
        local_alpha, local_w = np.einsum("ban,bn->an", R, alpha), np.einsum("ban,bn->an", R, w)
        for k, (i, j) in enumerate([(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]):
            unit = np.zeros((3, 3))
            unit[i, j] = unit[j, i] = 1.0
            local = unit @ local_alpha + _cross(local_w, unit @ local_w)
            moment[:, 4 + k] = np.einsum("abn,bn->an", R, local)
        moment += _cross(np.broadcast_to(self.p[:, body, None], force.shape), force)
        moved = self.ancestors[body][:, None, None]
        return moved * (np.einsum("ain,akn->ikn", self.angular, moment) + np.einsum("ain,akn->ikn", self.linear, force))


def _chunks(count: int) -> list[slice]:
    return [slice(start, start + CHUNK) for start in range(0, count, CHUNK)]


def _cross(a: Array, b: Array) -> Array:
    result = np.empty(np.broadcast_shapes(a.shape, b.shape))
    np.subtract(a[1] * b[2], a[2] * b[1], out=result[0])
    np.subtract(a[2] * b[0], a[0] * b[2], out=result[1])
    np.subtract(a[0] * b[1], a[1] * b[0], out=result[2])
    return result


def _apply(tensor: Array, vector: Array) -> Array:
    return np.einsum("abin,bin->ain", tensor, vector)


def _skew(axis: Array) -> Array:
    x, y, z = axis
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def inertia_vector(M_BBo: SpatialInertia, X_MB: RigidTransform) -> Array:
    """A body's ten inertial parameters in frame M (order of `RigidTree.inertia`), from its inertia about Bo in B."""
    mass = M_BBo.get_mass()
    R: Any = X_MB.rotation().matrix()
    centre: Any = X_MB.translation() + R @ M_BBo.get_com() if mass > 0.0 else X_MB.translation()
    if mass == 0.0:
        return np.zeros(10)
    about_centre = M_BBo.Shift(M_BBo.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
    tensor = R @ about_centre @ R.T + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return np.concatenate([[mass], mass * centre, np.diag(tensor), [tensor[0, 1], tensor[0, 2], tensor[1, 2]]])


def transform_inertia(X_ML: RigidTransform) -> Array:
    """(10, 10): turns inertial parameters in frame L into those in frame M, linearly."""
    R: Any = X_ML.rotation().matrix()
    p: Any = X_ML.translation()
    result = np.zeros((10, 10))
    for k in range(10):
        unit = np.eye(10)[k]
        mass, h = unit[0], R @ unit[1:4]
        xx, yy, zz, xy, xz, yz = unit[4:]
        tensor = R @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ R.T
        s = 2.0 * h + mass * p
        tensor = tensor + p @ s * np.eye(3) - 0.5 * (np.outer(p, s) + np.outer(s, p))
        diagonal, others = np.diag(tensor), [tensor[0, 1], tensor[0, 2], tensor[1, 2]]
        result[:, k] = np.concatenate([[mass], h + mass * p, diagonal, others])
    return result


def is_whole(plant: MultibodyPlant) -> bool:
    """Whether gravity, dampers and joint springs are all the forces that a plant holds, as in `RigidTree`."""
    known = (UniformGravityFieldElement, RevoluteSpring, PrismaticSpring)
    elements = (plant.get_force_element(ForceElementIndex(k)) for k in range(plant.num_force_elements()))
    return all(isinstance(element, known) for element in elements)


def carrier(plant: MultibodyPlant, context: Context, arm: Arm, body: RigidBody) -> tuple[int, RigidTransform]:
    """The arm joint that moves a body (-1: none), and the body's pose in that joint's moving frame M.

    The positions in `context` of joints outside the arm count; the arm's own do not.
    """
    to_child = {int(joint.child_body().index()): joint for joint in map(plant.get_joint, plant.GetJointIndices())}
    order = {int(index): i for i, index in enumerate(arm.joint_indices)}
    start = body
    while int(body.index()) in to_child:
        joint = to_child[int(body.index())]
        if int(joint.index()) in order:
            X_WM = joint.frame_on_child().CalcPoseInWorld(context)
            return order[int(joint.index())], X_WM.inverse() @ plant.EvalBodyPoseInWorld(context, start)
        body = joint.parent_body()
    return -1, plant.EvalBodyPoseInWorld(context, start)


def from_plant(plant: MultibodyPlant, context: Context, arm: Arm) -> RigidTree:
    """Reads the tree of an arm off a finalized plant.

    Args:
        plant: holds the arm.
        context: of the plant; joints outside the arm are taken as they are in it, the arm's own are set to zero.
        arm: which joints are the arm's.
    """
    joints = [plant.get_joint(index) for index in arm.joint_indices]
    for joint in joints:
        _at_zero(joint, context)
    order = {int(joint.index()): i for i, joint in enumerate(joints)}
    X_WM = [joint.frame_on_child().CalcPoseInWorld(context) for joint in joints]
    parent = np.array([carrier(plant, context, arm, joint.parent_body())[0] for joint in joints])
    X_PF = [
        (X_WM[p].inverse() if p >= 0 else RigidTransform()) @ joint.frame_on_parent().CalcPoseInWorld(context)
        for p, joint in zip(parent, joints, strict=True)
    ]
    inertia = np.zeros((len(joints), 10))
    for k in range(plant.num_bodies()):
        body = plant.get_body(BodyIndex(k))
        owner, X_MB = carrier(plant, context, arm, body)
        if owner >= 0:
            inertia[owner] += inertia_vector(body.CalcSpatialInertiaInBodyFrame(context), X_MB)
    stiffness, rest = _springs(plant, order)
    rotor = np.zeros(len(joints))
    for actuator in map(plant.get_joint_actuator, plant.GetJointActuatorIndices()):
        if int(actuator.joint().index()) in order:
            rotor[order[int(actuator.joint().index())]] += actuator.calc_reflected_inertia(context)
    return RigidTree(
        parent=parent,
        revolute=np.array([isinstance(joint, RevoluteJoint) for joint in joints]),
        axis=np.array([_axis(joint) for joint in joints]),
        R_PF=np.array([X.rotation().matrix() for X in X_PF]),
        p_PF=np.array([X.translation() for X in X_PF]),
        inertia=inertia,
        rotor=rotor,
        damping=np.array([float(joint.GetDampingVector(context)[0]) for joint in joints]),
        stiffness=stiffness,
        rest=rest,
        gravity=np.array(plant.gravity_field().gravity_vector()),
        link=tuple(joint.child_body().name() for joint in joints),
    )


def _at_zero(joint: Joint, context: Context) -> None:
    if isinstance(joint, RevoluteJoint):
        joint.set_angle(context, 0.0)
    elif isinstance(joint, PrismaticJoint):
        joint.set_translation(context, 0.0)


def _axis(joint: Joint) -> Array:
    if isinstance(joint, RevoluteJoint):
        return np.array(joint.revolute_axis())
    assert isinstance(joint, PrismaticJoint)
    return np.array(joint.translation_axis())


def _springs(plant: MultibodyPlant, order: dict[int, int]) -> tuple[Array, Array]:
    """Stiffness and rest position per joint, of all the springs that the description puts on it."""
    stiffness, moment = np.zeros(len(order)), np.zeros(len(order))
    for k in range(plant.num_force_elements()):
        spring = plant.get_force_element(ForceElementIndex(k))
        if isinstance(spring, RevoluteSpring):
            value, rest = spring.default_stiffness(), spring.default_nominal_angle()
        elif isinstance(spring, PrismaticSpring):
            value, rest = spring.stiffness(), spring.nominal_position()
        else:
            continue
        joint = int(spring.joint().index())
        if joint in order:
            stiffness[order[joint]] += value
            moment[order[joint]] += value * rest
    return stiffness, np.divide(moment, stiffness, out=np.zeros_like(moment), where=stiffness > 0.0)
