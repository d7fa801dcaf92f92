"""What is true of one arm and nobody is told, and what goes wrong with it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from filter_truth import COULOMB, ROTOR, URDF, VISCOUS

from hrt_truth.streams import Array
from twin_diagram.station.mujoco import TUNING as MUJOCO

N = 6
LAST = "wrist_3_link"
PAYLOAD = "payload"
LIMIT = np.array([150.0, 150.0, 150.0, 28.0, 28.0, 28.0])
FAULTS = (
    "none",
    "payload_added",
    "friction_third",
    "motor_lost",
    "motor_weak",
    "contact",
    "encoder_jump",
    "gyro_bias",
    "grasp_slip",
    "camera_spoofed",
    "encoder_spoofed",
)


@dataclass(frozen=True)
class Fault:
    """What happens during a run.

    Attributes:
        kind: of `FAULTS`.
        at: not before this time [s]; a motor fails at the first moment after it that loads its joint by `loaded`.
        size: kg added; share of the torque left; N of contact; rad of a jump; rad/s of bias; m of a slip; m/s or rad/s
            of a slow pull.
        joint: which, by index, of a motor or an encoder.
        loaded: [N·m].
        moving: the joint turns at least this fast as well when its motor fails [rad/s].
        lasts: of a contact, or how long a slip takes [s].
        down: whether a grasp slips along gravity, not in a direction of its own.
    """

    kind: str = "none"
    at: float = np.inf
    size: float = 0.0
    joint: int = 1
    loaded: float = 10.0
    moving: float = 0.0
    lasts: float = np.inf
    down: bool = False


@dataclass(frozen=True)
class Hidden:
    """One arm.

    Attributes:
        seed: that drew it.
        mass: of the payload [kg].
        com: of the payload, in the last link's frame (3,) [m].
        friction, damping, rotor: (n,) [N·m], [N·m·s/rad], [kg·m²].
        link_scale: (n,) true over described mass of each link.
        torque_bias: (n,) of the torque from currents [N·m].
        torque_noise: share of the effort limit.
    """

    seed: int
    mass: float = 0.0
    com: Array = field(default_factory=lambda: np.array([0.0, 0.0, 0.08]))
    friction: Array = field(default_factory=lambda: COULOMB.copy())
    damping: Array = field(default_factory=lambda: VISCOUS.copy())
    rotor: Array = field(default_factory=lambda: ROTOR.copy())
    link_scale: Array = field(default_factory=lambda: np.ones(N))
    torque_bias: Array = field(default_factory=lambda: np.zeros(N))
    torque_noise: float = 0.003

    @staticmethod
    def draw(seed: int, *, biased: bool = False, spread: float = 1.0, **given: Any) -> Hidden:
        """Friction and damping within a tenth of nominal, rotors 5 %, link masses 1 %, the payload's centre 2 cm.

        Args:
            seed: says everything that is not given.
            biased: whether the torque from currents has a constant error, of up to 0.5 % of the limit per joint.
            spread: times these, for domain randomisation.
            given: fields as they shall be.
        """
        rng = np.random.default_rng([seed, 41])
        drawn: dict[str, Any] = {
            "com": np.array([0.0, 0.0, 0.08]) + rng.uniform(-0.02, 0.02, 3),
            "friction": COULOMB * (1.0 + spread * rng.uniform(-0.1, 0.1, N)),
            "damping": VISCOUS * (1.0 + spread * rng.uniform(-0.1, 0.1, N)),
            "rotor": ROTOR * (1.0 + spread * rng.uniform(-0.05, 0.05, N)),
            "link_scale": 1.0 + spread * rng.uniform(-0.01, 0.01, N),
            "torque_bias": LIMIT * rng.uniform(-0.005, 0.005, N) * biased,
        }
        return Hidden(seed, **{**drawn, **given})

    def compile(self) -> mujoco.MjModel:
        """The MuJoCo model; its last body is the payload, which stays apart so that its wrench can be told."""
        spec = mujoco.MjSpec.from_file(str(URDF))
        spec.compiler.fusestatic = False
        spec.option.timestep = MUJOCO.period / MUJOCO.steps
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        body = spec.body(LAST).add_body(name=PAYLOAD, ipos=self.com, explicitinertial=True)
        body.mass, body.inertia = max(self.mass, 1e-6), [1e-4] * 3
        model = spec.compile()
        model.dof_frictionloss[:] = self.friction
        model.dof_damping[:] = self.damping
        model.dof_armature[:] = self.rotor
        # MuJoCo's dry friction is soft unless told otherwise: it would look viscous up to 0.2 rad/s.
        model.dof_solref[:] = [MUJOCO.period, 1.0]
        model.dof_solimp[:, :3] = [0.99, 0.999, 0.001]
        for k in range(N):
            link = model.jnt_bodyid[k]
            model.body_mass[link] *= self.link_scale[k]
            model.body_inertia[link] *= self.link_scale[k]
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model
