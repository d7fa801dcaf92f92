"""The robot's side of learning: an arm that goes where it is told, fingers, and cameras that look when asked.

What stages get of the simulated world is what a real cell would give them: messages of the arm and pictures.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from twin_diagram.errors import ScenarioError
from twin_diagram.logs.frames.view_camera import ViewCamera
from twin_diagram.model.description.followers import Followers
from twin_diagram.perception.alignment import Alignment
from twin_diagram.planning.grasps import gripper_of
from twin_diagram.planning.tasks.task_system import Fingers
from twin_diagram.runs.learning.bearing import Borne
from twin_diagram.runtime import stopping
from twin_diagram.scenario import Camera, Scenario
from twin_diagram.scenario.lenses import colour_lens
from twin_diagram.scenario.poses import pose
from twin_diagram.signals.arrays import Array
from twin_diagram.station import ports
from twin_diagram.station.sim.cameras_on_demand import CamerasOnDemand
from twin_diagram.station.sim.carried_bodies import CarriedBodies
from twin_diagram.station.sim.resting_bodies import RestingBodies
from twin_diagram.station.sim.station import SimStation


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    tick: float = 0.01
    """Between two commands while the arm moves [s]: the driver's filter smooths over as long."""

    weighed_tick: float = 0.0025
    """The same while torques are recorded [s]: two a message. Each command makes the torques jump; with one a message
    all messages show the same side of the jumps, which told 1.3 N·m·s/rad of friction that is none."""

    beyond: float = 1e-7
    """By which each tick ends later than it is due [s]: more than clocks are rounded by in an hour."""

    forgetting: float = 0.997
    """Share of what was known of the cell's pace that each tick leaves: it is that of some three seconds."""

    braking: float = 0.3
    """In which a motion that is broken off comes to rest [s]: from 1 rad/s at 3 rad/s², as motions begin."""


TUNING = Tuning()


class Observer(Protocol):
    """Somebody who knows the true world, for scores: no stage gets anything of it back."""

    def moment(self, name: str, positions: Array) -> None:
        """Take the positions (nq,) of the world's plant as an object, by its name, is in the hand."""

    def ticked(self, station: SimStation, context: Context, doing: Doing) -> None:
        """Look at the world after a tick of the arm, which was doing something; `context` is the station's."""


@dataclass(frozen=True)
class Doing:
    """What the arm is about: a phase, and places in W of what is to be touched [m]; none: nothing is."""

    phase: str = "move"
    places: tuple[tuple[float, float, float], ...] = ()


GRASP: Final = "grasp"
"""Phase in which the gripper is to touch one object, which may touch what is beside it."""
RELEASE: Final = "release"
"""Phase in which what is held is to touch what it is set down on, and to leave the hand."""
FREE: Final = Doing()
"""Going about, with or without something in the hand: nothing is to be touched."""


@dataclass(frozen=True)
class Picture:
    """One picture, and where the arm was when it was taken.

    Attributes:
        rgb: (H, W, 3).
        depth: (H, W) on the colours' grid [m], 0 where none is.
        camera: as calibrated, with its pose in W.
        time: [s].
        q: (n,) joint angles as measured [rad].
        fingers: (g,) as measured [m].
    """

    rgb: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.float32]
    camera: ViewCamera
    time: float
    q: Array
    fingers: Array

    def points(self) -> Array:
        """Return (H, W, 3) in W [m]; of pixels without depth where the camera is."""
        p_C = self.camera.rays() * self.depth[..., None]
        return np.asarray(p_C @ self.camera.R_WC.T + self.camera.p_WC)


@dataclass
class Recording:
    """Messages of the arm, as they came: (N,) times [s] and (N, n) each of positions, speeds and torques."""

    time: list[float] = field(default_factory=list)
    position: list[Array] = field(default_factory=list)
    velocity: list[Array] = field(default_factory=list)
    torque: list[Array] = field(default_factory=list)


class Cell:
    """A simulated cell, advanced by those who ask something of it.

    Attributes:
        borne: of what is held, by the driver; nothing any more once the fingers are told to open.
        observer: is told by `moment` where everything truly is, and of each tick, for scorers alone; None: nobody is.
        doing: what the arm is about, for the observer.
        shut_at: (n,) joint angles at which the fingers were last told to shut [rad]; None: they never were.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Build the station and settle what lies about.

        Raises:
            ScenarioError, ModelError, AssetError: what it is to be built from is missing or malformed.
            NativeLibraryError: EGL is missing.
        """
        self._cameras, self._eyes = scenario.twin.cameras, CamerasOnDemand(scenario)
        self._station = SimStation(scenario)
        arm = self._station.world.arm
        if not arm.fingers:
            raise ScenarioError("world.arm.model", f"{scenario.world.arm.model} has no gripper to take objects with")
        self._plant = self._station.world.plant
        described = np.array([finger.default_positions()[0] for finger in arm.fingers])
        widening = Followers.of(self._plant, arm.arm).widening
        self._fingers = Fingers.of(self._plant, arm.arm, described, widening)
        self._gripper = gripper_of(scenario.twin.learning.gripper) if scenario.twin.learning else None
        world, hand = self._station.world, arm.fingers[0].frame_on_parent()
        self._carried = CarriedBodies(self._plant, hand, arm.joints, world.objects)
        self._resting = RestingBodies.of(world)
        self._simulator = Simulator(self._station)
        self._context = self._simulator.get_mutable_context()
        self._command = arm.q0[: len(arm.joints)].copy()
        self._opened, self._force = 1.0, scenario.twin.learning.force if scenario.twin.learning else 60.0
        self._recording: Recording | None = None
        self._frame = 0
        self._corrected: dict[str, tuple[ViewCamera, float]] = {}
        self.observer: Observer | None = None
        self.doing = FREE
        self._torque = np.zeros_like(self._command)
        self._ahead = np.zeros(1), self._command[None], self._torque[None], 0.0
        self._spent, self.borne = np.zeros(2), Borne()
        self.shut_at: Array | None = None
        self._send()
        self._simulator.Initialize()

    @property
    def time(self) -> float:
        """How long the cell has been running [s]."""
        return float(self._context.get_time())

    @property
    def q(self) -> Array:
        """(n,) joint angles as measured, as commanded before the first message [rad]."""
        if float(self._read(ports.MEASUREMENT_TIME)[0]) < 0.0:
            return self._command.copy()
        return self._read(ports.POSITION_MEASURED)

    @property
    def torque(self) -> Array:
        """(n,) torques as measured [N·m]; zeros before the first message."""
        return self._read(ports.TORQUE_MEASURED)

    @property
    def widest(self) -> float:
        """Greatest travel of the fingers from each other [m]."""
        return self._fingers.widest

    @property
    def opening(self) -> float:
        """How far the fingers have come together from their closed end, where pads need not touch [m]."""
        return self._fingers.opening(self._read(ports.GRIPPER_MEASURED)[: len(self._fingers.closed)])

    @property
    def apart(self) -> float:
        """Distance between the pads [m]."""
        return self.opening if self._gripper is None else self._gripper.apart(self.opening)

    @property
    def shut(self) -> bool:
        """Whether the fingers were told to shut."""
        return self._opened == 0.0

    @property
    def pace(self) -> float:
        """Wall time that a second of the cell takes, by the last seconds [s]."""
        return float(self._spent[0] / self._spent[1]) if self._spent[1] > 0.0 else 1.0

    @property
    def force(self) -> float:
        """With which each finger presses [N]."""
        return self._force

    @property
    def fingers(self) -> dict[str, float]:
        """Where the fingers are, by the names of their joints [m]."""
        read = self._read(ports.GRIPPER_MEASURED)
        return {finger.name(): float(read[k]) for k, finger in enumerate(self._station.world.arm.fingers)}

    @property
    def commanded(self) -> Array:
        """(n,) joint angles that the arm was last told [rad]."""
        return self._command.copy()

    def _read(self, name: str) -> Array:
        return np.array(self._station.GetOutputPort(name).Eval(self._context))

    def _send(self) -> None:
        station, context = self._station, self._context
        station.GetInputPort(ports.POSITION_COMMANDED).FixValue(context, self._command)
        torque = self._torque + self.borne.torque(self._command, self.time)
        station.GetInputPort(ports.TORQUE_COMMANDED).FixValue(context, torque)
        station.GetInputPort(ports.GRIPPER_COMMANDED).FixValue(context, self._fingers.at(self._opened))
        station.GetInputPort(ports.GRIPPER_FORCE_LIMIT).FixValue(context, [self._force])

    def _advance(self, until: float) -> None:
        self._send()
        now, begun = self.time, time.perf_counter()
        end = until + TUNING.beyond  # whether a message that is due then has come would be left to rounding
        inner = self._plant.GetMyMutableContextFromRoot(self._context)
        self._resting.looked_at(inner)
        if self.shut:  # never more than one step of the plant at once
            for stop in np.linspace(now, end, 1 + int(np.ceil((end - now) / self._plant.time_step() - 0.01)))[1:]:
                self._carried.stepped(inner, partial(self._simulator.AdvanceTo, float(stop)))
        else:
            self._simulator.AdvanceTo(end)
        self._spent = TUNING.forgetting * self._spent + [time.perf_counter() - begun, until - now]
        if self._recording is not None:
            self._recording.time.append(float(self._read(ports.MEASUREMENT_TIME)[0]))
            self._recording.position.append(self._read(ports.POSITION_MEASURED))
            self._recording.velocity.append(self._read(ports.VELOCITY_ESTIMATED))
            self._recording.torque.append(self._read(ports.TORQUE_MEASURED))
        if self.observer is not None:
            self.observer.ticked(self._station, self._context, self.doing)
        stopping.check()

    def follow(
        self, times: Array, q: Array, at: Callable[[float], None] | None = None, torque: Array | None = None
    ) -> None:
        """Go along joint angles.

        Args:
            times: (M,) from now, ascending [s].
            q: (M, n) [rad].
            at: called after each tick with the time since the begin [s].
            torque: (M, n) that the driver adds to its own and to what is borne [N·m], for this once; None: nothing.
        """
        begin, tick = self.time, TUNING.weighed_tick if self._recording is not None else TUNING.tick
        added = np.zeros_like(q) if torque is None else torque
        for k in range(1, int(np.ceil(times[-1] / tick)) + 1):
            now = min(k * tick, float(times[-1]))
            self._ahead = times, q, added, now
            self._command, self._torque = at_time(now, times, q), at_time(now, times, added)
            self._advance(begin + k * tick)
            if at is not None:
                at(now)
        self._torque = np.zeros_like(self._command)

    def wait(self, seconds: float) -> None:
        """Stay where it is."""
        self.follow(np.array([0.0, seconds]), np.stack([self._command, self._command]))

    def brake(self) -> None:
        """Come to rest from a motion that was broken off, along it, as it is clear: what is held stays in the hand."""
        way, q, added, now = self._ahead
        times = np.arange(0.0, TUNING.braking + 1e-9, TUNING.tick)
        later, pace = now + times - 0.5 * times**2 / TUNING.braking, 1.0 - times / TUNING.braking
        torque = pace[:, None] ** 2 * np.array([at_time(t, way, added) for t in later])  # accelerations go so
        self.follow(times, np.array([at_time(t, way, q) for t in later]), torque=torque)

    @contextmanager
    def about(self, phase: str, places: Array) -> Iterator[None]:
        """Have the observer know what is done in the block, and to what: a place in W (3,) of it, or several (K, 3)."""
        before = self.doing
        self.doing = Doing(phase, tuple((float(x), float(y), float(z)) for x, y, z in np.atleast_2d(places)))
        try:
            yield
        finally:
            self.doing = before

    def grip(self, opened: float, seconds: float = 0.7, force: float | None = None) -> float:
        """Move the fingers, 0 shut to 1 open, and return how far the pads are apart then [m].

        Args:
            opened: where to.
            seconds: that are waited.
            force: of each finger from here on [N]; None: as before.
        """
        if opened == 0.0:
            self.shut_at = self._command.copy()
        else:
            self.borne.tell(None, self.time)
        self._opened = opened
        self._force = self._force if force is None else force
        self.wait(seconds)
        return self.opening

    @contextmanager
    def recording(self) -> Iterator[Recording]:
        """Record the arm's messages, each at one tick at least."""
        self._recording = Recording()
        try:
            yield self._recording
        finally:
            self._recording = None

    def look(self, name: str) -> Picture:
        """Take a picture; what the camera delivers is brought onto the colours' grid as it is calibrated."""
        told = self._cameras[name]
        self._frame += 1
        positions = np.array(self._plant.GetPositions(self._plant.GetMyContextFromRoot(self._context)))
        rgb, depth = self._eyes.look(name, positions, self._frame, self.time)
        way = Alignment.of(told)
        colours = np.ascontiguousarray(way.colours(rgb)[..., :3])
        fingers = self._read(ports.GRIPPER_MEASURED)[: len(self._fingers.closed)]
        late = self.time - max(0.0, float(self._read(ports.MEASUREMENT_TIME)[0]))  # joints have moved on since
        q = self.q + late * self._read(ports.VELOCITY_ESTIMATED)
        camera, scale = self._corrected.get(name, (told_camera(told), 1.0))
        seen = way.depth(depth) if scale == 1.0 else (scale * way.depth(depth)).astype(np.float32)
        return Picture(colours, seen, camera, self.time, q, fingers)

    def correct(self, name: str, camera: ViewCamera, scale: float) -> None:
        """Take a camera to stand elsewhere than it was told, from here on, and its depth times a scale for true."""
        self._corrected[name] = camera, scale

    def moment(self, name: str) -> None:
        """Tell the observer, if there is one, where everything truly is now; no stage gets anything of it back."""
        if self.observer is not None:
            self.observer.moment(name, self.snapshot()["positions"])

    def snapshot(self) -> dict[str, Array]:
        """Return where everything is, for a run that goes on later; nothing but `restore` reads it."""
        context = self._plant.GetMyContextFromRoot(self._context)
        return {
            "positions": np.array(self._plant.GetPositions(context)),
            "command": self._command.copy(),
            "fingers": np.array([self._opened, self._force]),
            "frame": np.array([self._frame, self.time]),
        }

    def restore(self, kept: dict[str, Array]) -> None:
        """Put everything back to where it lay, at rest.

        Raises:
            ScenarioError: it is of another world, or lacks something.
        """
        context = self._plant.GetMyMutableContextFromRoot(self._context)
        if lacking := sorted(self.snapshot().keys() - kept.keys()):
            raise ScenarioError("world", f"cannot go on: what is kept of it lacks {', '.join(lacking)}; begin anew")
        if len(kept["positions"]) != self._plant.num_positions():
            raise ScenarioError("world", "has other objects than the run that is to go on")
        self._context.SetTime(float(kept["frame"][1]))
        self._resting.wake(context)
        self._plant.SetPositions(context, kept["positions"])
        self._plant.SetVelocities(context, np.zeros(self._plant.num_velocities()))
        self._command, self._frame, self.borne = kept["command"].copy(), int(kept["frame"][0]), Borne()
        self._ahead = np.zeros(1), self._command[None], np.zeros_like(self._command)[None], 0.0
        self._opened, self._force = float(kept["fingers"][0]), float(kept["fingers"][1])
        driver = self._station.GetSubsystemByName("arm_driver")
        desired = np.concatenate([self._command, self._fingers.at(self._opened)])
        inner = driver.GetMyMutableContextFromRoot(self._context)
        inner.SetDiscreteState(np.concatenate([desired, np.zeros_like(desired)]))
        self._send()
        self._simulator.Initialize()


def at_time(now: float, times: Array, rows: Array) -> Array:
    """Return what rows (M, n) at times (M,) are at a time [s], in between as on a straight line."""
    return np.array([np.interp(now, times, rows[:, j]) for j in range(rows.shape[1])])


def told_camera(camera: Camera) -> ViewCamera:
    """Return a camera as its calibration has it, without distortion."""
    lens, X_WC = colour_lens(camera).straight, pose(camera.X_WC)
    R_WC, p_WC = X_WC.rotation().matrix(), X_WC.translation()
    return ViewCamera(camera.width, camera.height, lens.fx, lens.fy, lens.cx, lens.cy, R_WC, p_WC)
