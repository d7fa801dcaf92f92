"""Runs a simulated closed loop and samples estimates and truth, for the scorer.

Sampling happens between `AdvanceTo` calls, from outside the Diagram: nothing is added to the loop that is measured.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import numpy.typing as npt
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from twin_diagram.assets.asset import Asset
from twin_diagram.runs.score import RunRecord
from twin_diagram.runs.true_clearance import TrueClearance
from twin_diagram.runtime import stopping, timing
from twin_diagram.runtime.threads import one_thread
from twin_diagram.scenario.poses import pose
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import ALARM_LOG_FIELDS, NEVER, TRACK_SIZE
from twin_diagram.signals.lens import Lens
from twin_diagram.station import ports
from twin_diagram.station.sim.camera_truth import TrueCamera, true_camera, with_camera
from twin_diagram.twin.closed_loop import ClosedLoop


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    sample_period: float = 0.02
    """Between two samples of clearance, contacts and arm, rounded to whole steps of the plant [s]: a third of
    an image's period, and a multiple of the usual steps."""

    seen_points: int = 300
    """Surface points per object by which its visible share is counted."""

    depth_tolerance: float = 0.01
    """A surface point counts as seen where the image's depth agrees this well [m]."""


TUNING = Tuning()


_COLUMNS = (
    "time", "seen", "poses_true", "poses_estimated", "status", "arm_true", "arm_estimated", "mass", "mass_std",
    "clearance", "contacts", "goal_error", "goal_angle",
)  # fmt: skip
"""What `_Sampler.sample` keeps, in its order, by the names in `RunRecord`."""


@dataclass
class Trial:
    """A finished run: what the scorer needs, what it took, and what ended it before its time."""

    record: RunRecord
    real_time_factor: float
    shares: dict[str, float]
    stop: KeyboardInterrupt | None = None

    def timing(self) -> dict[str, Any]:
        """Return the figures of `timing` in ``summary.json``."""
        return {
            "real_time_factor": round(self.real_time_factor, 3),
            "systems": {name: round(share, 4) for name, share in self.shares.items()},
        }


Progress = Callable[[float], None]


@one_thread()
def run_trial(
    loop: ClosedLoop,
    simulator: Simulator,
    duration: float,
    progress: Progress = lambda time: None,
    between: Callable[[Context], None] = lambda context: None,
) -> Trial:
    """Advance a simulated closed loop to `duration` and sample it on the way.

    Args:
        loop: with a `sim` station.
        simulator: of ``loop.diagram``, at time 0.
        duration: [s]; the last sample is that of the plant's last step.
        progress: called with the time reached [s].
        between: called with the root context after each sample, which it may change.

    Raises:
        KeyboardInterrupt: the user ended it before the first sample; later, the trial is what there is until then.
    """
    sampler = _Sampler(loop, simulator.get_mutable_context())
    before, started = timing.snapshot(), clock.perf_counter()
    sampling, stop = 0.0, None
    try:
        with stopping.steps():
            for time in sample_times(duration, loop.scenario.world.time_step):
                simulator.AdvanceTo(time)
                paused = clock.perf_counter()
                sampler.sample()
                between(simulator.get_mutable_context())
                progress(simulator.get_context().get_time())
                sampling += clock.perf_counter() - paused
                stopping.check()
            simulator.AdvanceTo(max(duration, simulator.get_context().get_time()))
    except KeyboardInterrupt as ended:
        if sampler.reached is None:
            raise
        stop, duration = ended, sampler.reached
    elapsed = clock.perf_counter() - started - sampling
    shares = {name: seconds / elapsed for name, seconds in sorted(timing.since(before).items())}
    shares["Station"] = max(0.0, 1.0 - sum(shares.values()))
    return Trial(sampler.record(), duration / elapsed, shares, stop)


def sample_times(duration: float, step: float) -> list[float]:
    """Return when a run is sampled: at steps of its plant, about `Tuning.sample_period` apart, the last one included.

    Between two steps the plant's state is already that of the later one, while an estimate is of the present: the two
    would differ by as much as the arm moves in between.

    Args:
        duration: of the run [s].
        step: of the plant [s].
    """
    stride = max(1, round(TUNING.sample_period / step))
    last = int(np.floor(duration / step * (1.0 + 1e-12) + 1e-9))
    # The products are Drake's own, so that a sample is taken before the step at that very time.
    return [k * step for k in [*range(stride, last, stride), last]]


class _Sampler:
    """Reads truth and estimates off a context and keeps them."""

    def __init__(self, loop: ClosedLoop, context: Context) -> None:
        scenario = loop.scenario
        self._loop, self._context = loop, context
        self._station_context = loop.station.GetMyContextFromRoot(context)
        self._twin_context = loop.twin.diagram.GetMyContextFromRoot(context)
        self._truth_names = list(scenario.world.objects)
        self._objects = [name for name in scenario.twin.library if name in scenario.world.objects]
        self._track_index = [list(scenario.twin.library).index(name) for name in self._objects]
        self._truth_index = [self._truth_names.index(name) for name in self._objects]
        assets = [Asset.load(loop.twin.library[name].folder) for name in self._objects]
        self._symmetric = {name: asset.symmetric_axis for name, asset in zip(self._objects, assets, strict=True)}
        self._symmetries = {name: asset.symmetries for name, asset in zip(self._objects, assets, strict=True)}
        self._surfaces = [
            (a.points_O[: TUNING.seen_points].copy(), a.normals_O[: TUNING.seen_points].copy()) for a in assets
        ]
        self._eyes = {name: true_camera(with_camera(scenario, name)) for name in scenario.twin.perceiving}
        self._looked = dict.fromkeys(self._eyes, NEVER)
        self._shown = {name: np.zeros(len(self._objects)) for name in self._eyes}
        self._clearance = TrueClearance(loop.station)
        self._seen = np.zeros(len(self._objects))
        self._past: list[tuple[float, Array]] = []
        self._goal = pose(scenario.twin.task.X_WG) if scenario.twin.task.X_WG else None
        self._rows: list[tuple[Any, ...]] = []

    @property
    def reached(self) -> float | None:
        """Time of the newest sample [s]."""
        return float(self._rows[-1][0]) if self._rows else None

    def sample(self) -> None:
        time = self._context.get_time()
        truth = self._station(ports.OBJECT_POSES).reshape(-1, 7)[self._truth_index]
        self._past = [*self._past[-12:], (time, truth)]
        self._look()
        tracks = self._twin("tracks").reshape(-1, TRACK_SIZE)[self._track_index]
        arm_true = self._station(ports.ARM_STATE)
        n = len(self._loop.model.joints)
        parameters, covariance = self._twin("parameters"), self._twin("covariance")
        size = round(np.sqrt(covariance.size))
        mass_index = self._loop.twin.mass_index
        mass = parameters[mass_index] if mass_index is not None else np.nan
        mass_std = (
            np.sqrt(covariance.reshape(size, size)[2 * n + mass_index, 2 * n + mass_index])
            if (mass_index is not None)
            else np.nan
        )
        distance, contacts = self._clearance.evaluate(self._station_context)
        goal_error, goal_angle = self._goal_error(arm_true[:n])
        self._rows.append(
            (time, self._seen.copy(), truth, tracks[:, 2:9].copy(), tracks[:, 0].astype(np.int64), arm_true,
             self._twin("arm_state"), mass, mass_std, distance, contacts, goal_error, goal_angle)
        )  # fmt: skip

    def record(self) -> RunRecord:
        columns = [np.array(column) for column in zip(*self._rows, strict=True)]
        ring = self._twin("alarm_log").reshape(-1, ALARM_LOG_FIELDS)
        sampled: dict[str, Any] = dict(zip(_COLUMNS, columns, strict=True))
        model = self._loop.model
        return RunRecord(
            **sampled,
            alarm_log=ring,
            objects=self._objects,
            symmetric_axis=self._symmetric,
            symmetries=self._symmetries,
            joints=model.joints,
            prismatic=model.prismatic,
        )

    def _station(self, port: str) -> Array:
        return np.array(self._loop.station.GetOutputPort(port).Eval(self._station_context))

    def _twin(self, port: str) -> Array:
        return np.array(self._loop.twin.diagram.GetOutputPort(port).Eval(self._twin_context))

    def _goal_error(self, q: Array) -> tuple[float, float]:
        if self._goal is None:
            return np.nan, np.nan
        X_WT = self._loop.model.tool_pose(q)
        X_GT = self._goal.InvertAndCompose(X_WT)
        return float(np.linalg.norm(X_GT.translation())), float(X_GT.rotation().ToAngleAxis().angle())

    def _look(self) -> None:
        """Count, where a new image has come, which share of each object's camera-facing surface it shows.

        Of several cameras, that which shows most of it counts.
        """
        for name, eye in self._eyes.items():
            self._look_through(name, eye)
        if self._eyes:
            self._seen[:] = np.max(list(self._shown.values()), axis=0)

    def _look_through(self, name: str, eye: TrueCamera) -> None:
        image_time = float(self._station(ports.image_time(name))[0])
        if image_time == self._looked[name] or image_time < 0:
            return
        self._looked[name] = image_time
        image = cast(Any, self._loop.station.GetOutputPort(ports.depth_image(name))).Eval(self._station_context)
        depth = np.asarray(image.data[..., 0] / np.float32(eye.depth_scale), dtype=np.float32)
        X_DW = eye.X_WD.inverse()
        times = np.array([time for time, _ in self._past])
        poses = self._past[int(np.argmin(np.abs(times - image_time)))][1]
        for index, (points, normals) in enumerate(self._surfaces):
            X_DO = X_DW.multiply(_transform(poses[index]))
            self._shown[name][index] = _seen_share(points, normals, X_DO, depth, eye.depth)


def _transform(vector: Array) -> RigidTransform:
    from pydrake.common.eigen_geometry import Quaternion

    return RigidTransform(Quaternion(vector[:4] / np.linalg.norm(vector[:4])), vector[4:])


def _seen_share(
    points_O: Array, normals_O: Array, X_DO: RigidTransform, depth: npt.NDArray[np.float32], lens: Lens
) -> float:
    points = X_DO.multiply(points_O.T).T
    normals = X_DO.rotation().multiply(normals_O.T).T
    facing = np.einsum("ij,ij->i", points, normals) < -0.2 * np.linalg.norm(points, axis=1)
    points = points[facing & (points[:, 2] > 0.05)]
    if len(points) == 0:
        return 0.0
    height, width = depth.shape
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    u, v = (np.rint(place).astype(int) for place in lens.pixel(x, y))
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    seen = np.zeros(len(points), dtype=bool)
    seen[inside] = np.abs(depth[v[inside], u[inside]] - points[inside, 2]) < TUNING.depth_tolerance
    return float(seen.mean())
