"""What the simulated arm's sensors make of its true motion and torques."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import ArmDefects
from twin_diagram.signals.layouts import NEVER
from twin_diagram.station.sim.noise import MessageStreams, Stream


class ArmSensors(LeafSystem):
    """Samples encoders, speeds and torques at the driver's rate, with their defects.

    .. pydrake_system::

        name: ArmSensors
        input_ports:
        - motor_state
        - torque
        output_ports:
        - position_measured
        - velocity_estimated
        - torque_measured
        - measurement_time
        - gripper_measured

    Message k is taken at k / rate, k = 1, 2, …, and stands on the ports from then on: an event at the same time still
    sees the one before. `position_measured` (n) [rad] is a whole number of encoder counts, `velocity_estimated` (n)
    [rad/s] has white noise, `torque_measured` (n) [N·m] is what `torque` says, with a gain, a constant error
    and white noise: what the motors gave in the plant's last step, before friction and rotor inertia, or what the
    gears passed on; `measurement_time` (1) [s]; `gripper_measured`
    (2g) positions then speeds. Noise is a function of seed and message alone.
    """

    def __init__(self, n: int, g: int, defects: ArmDefects, rate: float, seed: int) -> None:
        """Build the sensors of an arm.

        Args:
            n: number of arm joints.
            g: number of finger joints.
            defects: of the sensors.
            rate: messages per second [1/s].
            seed: of the scenario.

        Raises:
            ScenarioError: a defect that makes no sense.
        """
        super().__init__()
        if not rate > 0:
            raise ScenarioError("twin.driver.rate", f"{rate} is not positive")
        for name, values in (("torque_bias", defects.torque_bias), ("torque_gain", defects.torque_gain)):
            if values and len(values) != n:
                raise ScenarioError(f"world.arm_defects.{name}", f"{len(values)} numbers for {n} joints")
        if not 1 <= defects.encoder_bits <= 60:
            raise ScenarioError("world.arm_defects.encoder_bits", f"{defects.encoder_bits} is not in 1 to 60")
        for name, value in (("velocity_noise", defects.velocity_noise), ("torque_noise", defects.torque_noise)):
            if not value >= 0:
                raise ScenarioError(f"world.arm_defects.{name}", f"{value} is negative")
        self._n, self._g, self._m = n, g, n + g
        self._count = 2.0 * np.pi / 2.0**defects.encoder_bits
        self._velocity_noise, self._torque_noise = defects.velocity_noise, defects.torque_noise
        self._bias = np.array(defects.torque_bias, dtype=float) if defects.torque_bias else np.zeros(n)
        self._gain = np.array(defects.torque_gain, dtype=float) if defects.torque_gain else np.ones(n)
        self._rate, self._noise = rate, MessageStreams(seed, Stream.ARM)
        self._motor = self.DeclareVectorInputPort("motor_state", 2 * self._m)
        self._torque = self.DeclareVectorInputPort("torque", n)
        state = self.DeclareDiscreteState(np.concatenate([np.zeros(3 * n + 2 * g), [NEVER]]))
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / rate, 0.0, self._update)
        ticket = {self.discrete_state_ticket(state)}
        layout = {
            "position_measured": slice(0, n),
            "velocity_estimated": slice(n, 2 * n),
            "torque_measured": slice(2 * n, 3 * n),
            "measurement_time": slice(3 * n + 2 * g, 3 * n + 2 * g + 1),
        }
        if g:
            layout["gripper_measured"] = slice(3 * n, 3 * n + 2 * g)
        for name, part in layout.items():

            def calc(context: Context, output: BasicVector, part: slice = part) -> None:
                output.SetFromVector(context.get_discrete_state_vector().value()[part])

            self.DeclareVectorOutputPort(name, part.stop - part.start, calc, prerequisites_of_calc=ticket)

    def _update(self, context: Context, discrete: DiscreteValues) -> None:
        n, m = self._n, self._m
        time = context.get_time()
        tick = round(time * self._rate)
        if tick == 0:
            # No step of the plant has ended yet. An event offset by a period would do, but its times would differ from
            # the plant's by rounding, and so miss or repeat a step.
            return
        noise = self._noise.of(tick).standard_normal(2 * n)
        state = self._motor.Eval(context)
        position = np.rint(state[:n] / self._count) * self._count + 0.0  # no negative zero
        velocity = state[m : m + n] + self._velocity_noise * noise[:n]
        torque = self._gain * self._torque.Eval(context) + self._bias + self._torque_noise * noise[n:]
        gripper = np.concatenate([state[n:m], state[m + n :]])
        discrete.set_value(np.concatenate([position, velocity, torque, gripper, [time]]))
