"""The stop monitor as a system: the planner's commands go through it, or the arm comes to rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, InputPort

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.model.model import Model
from twin_diagram.model.model_user import ModelUser
from twin_diagram.planning.braking import brake_state
from twin_diagram.planning.braking.brake_state import BrakeMode, BrakeState, Cause
from twin_diagram.planning.braking.drake_distances import DrakeDistances
from twin_diagram.planning.braking.scene_now import SceneNow, read_scene
from twin_diagram.planning.braking.stop_check import Breach, breach
from twin_diagram.planning.braking.stopping_motion import Rejoin, heading, stopping_time, travelled, untold_limit
from twin_diagram.planning.given import check_kinds
from twin_diagram.planning.mpc.arm_torque import PAYLOAD, ArmTorque, LearnedPayload, acceleration_limit, chain_of
from twin_diagram.runtime.timing import timed
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import HAND_SIZE, Hand
from twin_diagram.signals.layouts import NEVER, TRACK_SIZE
from twin_diagram.signals.things import FURTHER_TRACK_SIZE, THING_SIZE


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    ahead: float = 0.25
    """Before the arm goes on the way is looked at for so long ahead [s]: about the time from rest to a plan's speed."""

    spare: float = 0.005
    """What must be left beyond the clearance for the arm to go on [m], lest it brakes again at once."""

    apart: float = 0.1
    """Measured and commanded speeds that differ by more are two motions, and both are looked at [rad/s]."""

    creep: float = 5e-4
    """A stop over less than this is no motion [m]."""


TUNING = Tuning()


class StopMonitor(ModelUser[Model]):
    """Passes the planner's commands on while the arm could still stop in time, and else stops it.

    .. pydrake_system::

        name: StopMonitor
        input_ports:
        - position_commanded
        - torque_commanded (optional)
        - plan_time (optional)
        - arm_state
        - measurement_time
        - parameters (optional)
        - message_time (optional)
        - image_time (optional)
        - tracks (optional)
        - further_tracks (optional)
        - things (optional)
        - hand (optional)
        - gripper_state (optional)
        output_ports:
        - position_commanded
        - torque_commanded
        - brake

    Ports:
        position_commanded: (n) the planner's [rad]; out: what the arm is to follow, to the bit the planner's while
            nothing is wrong.
        torque_commanded: (n) feed-forward [N·m]; out: the last that was a number, within the motors' limits.
        plan_time: (1) when the newest plan was made or checked [s]; not connected: a planner that hangs is not noticed.
        arm_state: (2n) estimated joint angles [rad] and speeds [rad/s].
        measurement_time: (1) of the arm's newest message [s], `NEVER` before the first: until then commands pass.
        parameters: (p) what a filter learned; those of a payload count, see `arm_torque.PAYLOAD`: a heavy load takes
            longer to stop. Not connected: nothing is carried.
        message_time: (1) of the newest message that a filter could use [s], which tells NaN with fresh stamps; not
            connected: what stamps say is believed.
        image_time: (1) of the newest image [s]; not connected: the scene does not grow stale.
        tracks, further_tracks, things, hand: the twin's scene, as `Mpc` takes them. What is held is no obstacle but
            part of the arm, what may be touched is none; see `signals.hand`.
        gripper_state: (2g) of the fingers; not connected: they are as described.
        brake: (1 + n) whether it brakes, and its command [rad]: a planner goes on from there.

    Rate: looks at `stop_monitor.rate`, a periodic discrete update; in between, commands pass as they come, but no
    farther off where they were heading than `jump`. Latency of a stop: a period, and `delay` until the arm follows.

    State: one discrete vector, see `brake_state.BrakeState`. A corrected model's torques count, as `Mpc` has them.
    """

    def __init__(
        self,
        model: Model,
        twin: scenario.Twin,
        library: Mapping[str, Asset],
        packages: Mapping[str, str | Path] | None = None,
        parameter_names: Sequence[str] = PAYLOAD,
    ) -> None:
        """Read the shapes of the arm, fixtures and library.

        Args:
            model: the arm, whose limits and dynamics count.
            twin: what the twin is told; `stop_monitor` must be there.
            library: the known objects by name, in the order of the tracks.
            packages: local folders for `package://` names.
            parameter_names: of the `parameters` port, in order, as `Mpc` takes them.

        Raises:
            ArgumentError: an argument of another kind.
            ModelError: a shape that cannot be read.
        """
        check_kinds(model, twin, library)
        super().__init__()
        self.set_name("stop_monitor")
        assert twin.stop_monitor is not None
        self._params: Final = twin.stop_monitor
        self._begin_with(model)
        self._n: Final = len(model.joints)
        self._speed: Final = np.where(np.isfinite(model.velocity_limit), model.velocity_limit, np.pi)
        self._effort: Final = np.where(model.effort_limit > 0.0, model.effort_limit, np.inf)
        told, planner = self._params.acceleration, twin.planner
        plans = acceleration_limit(model, planner.velocity_share * self._speed, planner.torque_share)
        limit = untold_limit(plans, planner.acceleration) if told is None else np.full(self._n, told)
        self._acceleration: Final = limit
        further, things = twin.slots.further(len(library)), twin.slots.unknown
        self._near: Final = DrakeDistances(twin.arm, twin.fixtures, library, further, things, packages)
        self._sizes = np.array([asset.size for asset in library.values()]).reshape(-1, 3)
        self._patience: Final = {
            Cause.STALE_STATE: self._params.state_periods / twin.driver.rate,
            # Of several cameras one that goes on is enough; the slowest may be the one.
            Cause.STALE_SCENE: max(
                (one.latency + self._params.image_periods / one.rate for one in twin.perceiving.values()),
                default=np.inf,
            ),
            Cause.HANGING_PLANNER: self._params.plan_periods / twin.planner.rate,
        }
        self._period: Final = 1.0 / self._params.rate
        self._watched: Final = (
            ("measurement_time", Cause.STALE_STATE, 0.0),
            ("message_time", Cause.STALE_STATE, 1.0 / twin.filter.rate),
            ("image_time", Cause.STALE_SCENE, 0.0),
            ("plan_time", Cause.HANGING_PLANNER, 0.0),
        )
        home = np.array(twin.home, dtype=float) if twin.home else np.zeros(self._n)
        self._carried: Final = LearnedPayload.among(parameter_names)
        self._chain: Final = chain_of(model)
        self._declare(home, len(library), further, things, len(parameter_names))

    def _declare(self, home: Array, objects: int, further: int, things: int, parameters: int) -> None:
        """Declare state, inputs, events and outputs for so many slots of each kind and learned parameters."""
        n, g = self._n, self._near.finger_count
        sizes = {
            "position_commanded": n, "torque_commanded": n, "plan_time": 1, "arm_state": 2 * n, "measurement_time": 1,
            "parameters": parameters, "message_time": 1, "image_time": 1, "tracks": TRACK_SIZE * objects,
            "further_tracks": FURTHER_TRACK_SIZE * further,
            "things": THING_SIZE * things, "hand": HAND_SIZE, "gripper_state": 2 * g,
        }  # fmt: skip
        self._in: dict[str, InputPort] = {k: self.DeclareVectorInputPort(k, size) for k, size in sizes.items()}
        state = self.DeclareDiscreteState(cast(Any, BrakeState.initial(home).pack()))
        self.DeclarePeriodicDiscreteUpdateEvent(self._period, 0.0, self._look)
        stored = self.discrete_state_ticket(state)
        self.DeclareVectorOutputPort(
            "position_commanded",
            n,
            self._calc_position,
            prerequisites_of_calc={self.time_ticket(), stored, self._in["position_commanded"].ticket()},
        )
        asked = {stored, self._in["torque_commanded"].ticket()}
        self.DeclareVectorOutputPort("torque_commanded", n, self._calc_torque, prerequisites_of_calc=asked)
        stopped = {self.time_ticket(), stored}
        self.DeclareVectorOutputPort("brake", 1 + n, self._calc_brake, prerequisites_of_calc=stopped)

    def add_asset(self, asset: Asset) -> None:
        """Take in the shape of an asset that came later; `further_tracks` tell of it by its number."""
        self._near.add_asset(asset)
        self._sizes = np.vstack([self._sizes, asset.size])

    def recount(self, context: Context, change: Array) -> None:
        """Count angles anew: what was commanded is others by `change` (n,) [rad], in this system's Context."""
        state = self.remembered(context)
        moved = {name: getattr(state, name) + change for name in ("command", "asked", "stop_q0")}
        context.SetDiscreteState(0, cast(Any, replace(state, **moved).pack()))

    def remembered(self, context: Context) -> BrakeState:
        """Return a copy of what it remembers; `context` is this system's."""
        return BrakeState.unpack(np.asarray(context.get_discrete_state_vector().value()), self._n)

    def told(self, context: Context) -> list[dict[str, Any]]:
        """Return the newest brakes and ends of brakes, oldest first, see `brake_state.told`."""
        return brake_state.told(self.remembered(context).notes, self._near.parts, self._near.names)

    def standing(self, context: Context) -> dict[str, Any]:
        """Return how often and how long it has braked so far [s], and whether it does now."""
        state, now = self.remembered(context), context.get_time()
        braking = state.mode == BrakeMode.BRAKE
        seconds = state.braked + (now - state.stop_start if braking else 0.0)
        return {"count": int(state.brakes), "seconds": round(seconds, 4), "braking": braking}

    def _make(self, model: Model) -> Model:
        return model

    def _value(self, context: Context, name: str) -> Array | None:
        port = self._in[name]
        return np.array(port.Eval(context)) if port.HasValue(context) else None

    def _asked(self, context: Context) -> Array:
        asked = self._value(context, "position_commanded")
        return np.full(self._n, np.nan) if asked is None else asked

    def _command(self, state: BrakeState, now: float, asked: Array) -> tuple[Array, Array, bool]:
        """Return (n,) what to command, what of the planner's counts, and whether that had to be held back."""
        if state.mode == BrakeMode.WAIT:
            finite = bool(np.isfinite(asked).all())
            command = asked if finite else state.command
            return command, command, not finite
        counts, held = heading(asked, state.asked, state.asked_rate, now - state.looked, self._params.jump)
        if state.mode == BrakeMode.BRAKE:
            return state.stop.at(now), counts, held
        if state.mode == BrakeMode.REJOIN:
            return counts + state.rejoin.at(now), counts, held
        return counts, counts, held

    def _calc_position(self, context: Context, output: BasicVector) -> None:
        asked, now = self._asked(context), context.get_time()
        vector = np.asarray(context.get_discrete_state_vector().value())
        mode, looked, before, rate = BrakeState.passing(vector, self._n)
        if mode == BrakeMode.PASS:  # what is asked for most often, without reading all of the state
            command = heading(asked, before, rate, now - looked, self._params.jump)[0]
        else:
            command = self._command(self.remembered(context), now, asked)[0]
        output.SetFromVector(command)

    def _calc_torque(self, context: Context, output: BasicVector) -> None:
        asked = self._value(context, "torque_commanded")
        if asked is None or not np.isfinite(asked).all():
            asked = self.remembered(context).torque
        output.SetFromVector(np.minimum(np.maximum(asked, -self._effort), self._effort))

    def _calc_brake(self, context: Context, output: BasicVector) -> None:
        state = self.remembered(context)
        braking = state.mode == BrakeMode.BRAKE
        command = state.stop.at(context.get_time()) if braking else state.command
        output.SetFromVector(np.concatenate([[float(braking)], command]))

    @timed("StopMonitor")
    def _look(self, context: Context, discrete: DiscreteValues) -> None:
        state, now = self.remembered(context), context.get_time()
        arm = cast(Array, self._value(context, "arm_state"))
        heard = cast(Array, self._value(context, "measurement_time"))[0] >= 0.0
        asked, torque = self._asked(context), self._value(context, "torque_commanded")
        if state.mode == BrakeMode.WAIT:
            if not heard:
                return
            start = next((q for q in (asked, arm[: self._n], state.command) if np.isfinite(q).all()), state.command)
            state = replace(state, mode=float(BrakeMode.PASS), began=now, looked=now, command=start, asked=start)
        command, counts, held = self._command(state, now, asked)
        passed = now - state.looked
        rate, asked_rate = state.rate, state.asked_rate
        if passed > 0.0:
            if not held:  # what was let through of a jump is no speed to brake from: there was none of it before
                rate = np.clip((command - state.command) / passed, -self._speed, self._speed)
            asked_rate = np.clip((counts - state.asked) / passed, -self._speed, self._speed)
        if state.mode == BrakeMode.BRAKE:
            rate = state.stop.rate(now)
            # A planner that has jumped is believed where it is now, once it stays there.
            counts, asked_rate = (
                (asked, asked_rate * (not held)) if np.isfinite(asked).all() else (state.asked, 0 * rate)
            )
        turn = np.zeros(self._n)
        if passed > 0.0:
            turn = np.clip((asked_rate - state.asked_rate) / passed, -self._acceleration, self._acceleration)
        stamps = (self._value(context, name) for name, *_ in self._watched)
        state = state.hearing(now, np.array([np.inf if stamp is None else stamp[0] for stamp in stamps]))
        cause = self._cause(state, now, arm, asked, torque, held)
        state = replace(state, looked=now, command=command, rate=rate, asked=counts, asked_rate=asked_rate)
        if torque is not None and np.isfinite(torque).all():
            state = replace(state, torque=torque)
        if state.mode == BrakeMode.BRAKE:
            after = self._perhaps_resume(context, state, now, arm, cause, turn)
        else:
            after = self._decide(context, state, now, arm, cause)
        discrete.set_value(cast(Any, after.pack()))

    def _cause(
        self, state: BrakeState, now: float, arm: Array, asked: Array, torque: Array | None, held: bool
    ) -> Cause:
        """Return what stands against any motion, whatever is near."""
        if not all(np.isfinite(values).all() for values in (arm, asked, torque) if values is not None):
            return Cause.NOT_A_NUMBER
        for (_, cause, later), time in zip(self._watched, state.newest.tolist(), strict=True):
            if cause is Cause.HANGING_PLANNER and time < 0.0:
                continue
            # What has not come yet is waited for from the arm's first message on: a clock may begin at any time.
            if not now - max(time, state.began) <= self._patience[cause] + later + 1e-9:
                return cause
        return Cause.JUMP if held else Cause.NONE

    def _decide(self, context: Context, state: BrakeState, now: float, arm: Array, cause: Cause) -> BrakeState:
        """Return the state after a look at an arm that is not being braked: it is from now on, or goes on."""
        found = None
        if cause is Cause.NONE:
            found = self._breach(context, state, now, arm)
            cause = Cause.CLEARANCE if found else Cause.NONE
        if cause is not Cause.NONE:
            return self._brake(context, state, now, cause, found)
        if state.mode == BrakeMode.REJOIN and now >= state.rejoin_start + state.rejoin_time:
            return replace(state, mode=float(BrakeMode.PASS))
        return state

    def _brake(self, context: Context, state: BrakeState, now: float, cause: Cause, found: Breach | None) -> BrakeState:
        time = self._stopping_time(context, state.command, state.rate)
        where = (found.part, found.body, found.distance) if found else (0, 0, 0.0)
        note = (now, 1.0, float(cause), *where, float(np.abs(state.rate).max()))
        return replace(
            state, mode=float(BrakeMode.BRAKE), stop_start=now, stop_time=time, stop_q0=state.command,
            stop_v0=state.rate, clear=NEVER, brakes=state.brakes + 1.0, notes=state.noting(*note),
        )  # fmt: skip

    def _stopping_time(self, context: Context, q: Array, v: Array) -> float:
        arm = ArmTorque(self._in_use(context), self._chain, self._carried.of(self._value(context, "parameters")))
        (mass,), (bias,) = arm.mass_and_load(q[None], v[None])
        return stopping_time(v, self._acceleration, mass, bias, self._params.torque_share * self._effort)

    def _perhaps_resume(
        self, context: Context, state: BrakeState, now: float, arm: Array, cause: Cause, turn: Array
    ) -> BrakeState:
        """Return the state after a look while it brakes; `turn` (n,) is how the plan's rates change [rad/s²]."""
        if cause is not Cause.NONE or now < state.stop_start + state.stop_time:
            return replace(state, clear=NEVER)
        scene, ahead = self._scene(context, now, arm), TUNING.ahead
        offset = state.command - state.asked
        fade = Rejoin.within(now, offset, -state.asked_rate, self._speed, self._acceleration)
        plan = state.asked_rate * ahead
        # A slow fade sets off as the plan turns, not towards where the plan is: neither may lead too near.
        first = plan + 0.5 * turn * ahead**2 + fade.at(now + ahead) - offset
        if any(self._along(scene, arm, way / ahead, ahead, 0.0, TUNING.spare) for way in (plan - offset, first)):
            return replace(state, clear=NEVER)
        if state.clear == NEVER:
            return replace(state, clear=now)
        if now - state.clear < self._params.resume_after - 1e-9:
            return state
        stood = now - state.stop_start
        return replace(
            state, mode=float(BrakeMode.REJOIN), rejoin_start=now, rejoin_time=fade.time, rejoin_offset=fade.offset,
            rejoin_rate=fade.rate, braked=state.braked + stood, notes=state.noting(now, 0, 0, 0, 0, stood, 0),
        )  # fmt: skip

    def _breach(self, context: Context, state: BrakeState, now: float, arm: Array) -> Breach | None:
        """Return what the arm would come too near to if it began to brake at the next look."""
        delay, found, scene = self._period + self._params.delay, None, None
        told = self._value(context, "hand")
        hand = Hand() if told is None else Hand.unpack(told)
        self._near.hold(hand.held, hand.X_TO)  # what it last held may be another Context's
        speeds = [state.rate]
        if np.abs(arm[self._n :] - state.rate).max() > TUNING.apart:
            speeds.append(arm[self._n :])
        for v in speeds:
            time = self._stopping_time(context, arm[: self._n], v)
            reach = self._near.speed(arm[: self._n], v)
            if reach * travelled(delay + time, delay, time) < TUNING.creep:
                continue
            scene = scene or self._scene(context, now, arm)
            found = found or self._along(scene, arm, v, delay, time, 0.0, reach)
        return found

    def _along(
        self, scene: SceneNow, arm: Array, v: Array, delay: float, time: float, spare: float, reach: float | None = None
    ) -> Breach | None:
        """Return what would be too near along a stop from where the arm is, `spare` [m] beyond the clearance.

        `reach` is how fast any point of the arm goes at v [m/s], where that is known.
        """
        q = arm[: self._n]
        reach = self._near.speed(q, v) if reach is None else reach
        if reach * travelled(delay + time, delay, time) < TUNING.creep:
            return None

        def query(after: float, gone: float, within: float) -> Any:
            present, X_WO = scene.at(after)
            return self._near.near(q + v * gone, v, scene.fingers, present, X_WO, within)

        return breach(query, scene.others(self._params, spare), reach, delay, time)[0]

    def _scene(self, context: Context, now: float, arm: Array) -> SceneNow:
        values = {name: self._value(context, name) for name in ("tracks", "further_tracks", "things", "hand")}
        fingers, image = self._value(context, "gripper_state"), self._value(context, "image_time")
        age = max(0.0, now - float(image[0])) if image is not None and image[0] >= 0.0 else 0.0
        scene = read_scene(self._near, self._sizes, arm[: self._n], fingers, age, **values)
        self._near.surround(scene.shapes)
        return scene
