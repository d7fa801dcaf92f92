"""Table II of SyncTwin: what an obstacle went through while the arm went to and fro, by the paper's words."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import numpy.typing as npt
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from synctwin_truth.avoidance import DURATION, TARGETS, Draw
from twin_diagram.assets import Asset
from twin_diagram.planning.collision.collision_scene import Forecast, load_scene
from twin_diagram.planning.paths import inverse_kinematics
from twin_diagram.scenario import Scenario
from twin_diagram.signals import rotations
from twin_diagram.signals.layouts import ObjectStatus, Track
from twin_diagram.station import ports
from twin_diagram.station.sim.movers import Path
from twin_diagram.twin.closed_loop import ClosedLoop, make_closed_loop

Array = npt.NDArray[np.float64]

LOOK = 0.005
"""Between two looks at contacts [s]."""
EDGE = (0.005, float(np.radians(2.0)))
"""Contact that moves an obstacle by no more is edge avoidance [m, rad]."""
LEAST_VISITS = 0.6
"""Of those that are made with the obstacle absent."""
WEIGHTS = {"FA": 1.0, "EA": 0.8, "CO": 0.0}
"""The paper's."""


def outcome(touched: bool, moved: float, turned: float) -> str:
    """Return FA, EA or CO: contact or not, and by how much it moved the obstacle [m, rad]."""
    if not touched:
        return "FA"
    return "EA" if moved <= EDGE[0] and turned <= EDGE[1] else "CO"


def score(row: dict[str, Any], visits_alone: int) -> float:
    """Return what a run counts for: the paper's weight, nothing where it made too few visits."""
    return WEIGHTS[row["outcome"]] if row["visits"] >= LEAST_VISITS * visits_alone else 0.0


def run(scenario: Scenario, draw: Draw) -> dict[str, Any]:
    """Run a loop; return contact, how far the obstacle was moved aside, visits, brakes and what it took."""
    begin = time.process_time()
    loop = make_closed_loop(scenario)
    simulator = Simulator(loop.diagram)
    simulator.Initialize()
    context = simulator.get_mutable_context()
    station, twin = (each.GetMyContextFromRoot(context) for each in (loop.station, loop.twin.diagram))
    touch = Touch(loop)
    path = Path(draw.path, "path") if scenario.world.objects else None
    moved, turned, base = 0.0, 0.0, (0.0, 0.0)
    for k in range(1, round(scenario.duration / LOOK) + 1):
        simulator.AdvanceTo(k * LOOK)
        touch.look(station, k * LOOK)
        if path is not None:
            off = aside(loop, station, path, k * LOOK)
            # How far its carriage lags is no one's fault; what comes on top since the first contact is.
            if touch.first is None:
                base = off
            moved, turned = max(moved, off[0] - base[0]), max(turned, off[1] - base[1])
    hit = touch.first is not None
    brakes = [event for event in loop.twin.brakes(twin) if event["event"] == "brake"]
    return {
        "outcome": outcome(hit, moved, turned) if not touch.elsewhere else "CO",
        "touched": touch.first, "by": touch.by, "elsewhere": touch.elsewhere, "speed": touch.speed,
        "moved_mm": 1e3 * moved, "turned_deg": float(np.degrees(turned)), "visits": visits(loop, twin),
        "brakes": [(event["time"], event["cause"], event.get("object", "")) for event in brakes],
        "cpu_s": time.process_time() - begin,
    }  # fmt: skip


class Touch:
    """Looks whether the arm touches anything.

    Attributes:
        first: when it first touched the obstacle [s]; None: never.
        by: with which link.
        speed: of the arm's fastest joint then [rad/s].
        elsewhere: what else it touched.
    """

    def __init__(self, loop: ClosedLoop) -> None:
        world: Any = loop.station.world  # type: ignore[attr-defined]
        self._plant, self._loop = world.plant, loop
        arm = world.arm.arm
        self._arm = {int(b) for instance in arm.instances for b in self._plant.GetBodyIndices(instance)}
        self._obstacles = {int(body) for body in world.objects.values()}
        self.first: float | None = None
        self.by, self.speed, self.elsewhere = "", 0.0, ""

    def look(self, context: Context, now: float) -> None:
        """Note what touches now; `context` is the station's."""
        results: Any = self._loop.station.GetOutputPort(ports.CONTACT_RESULTS).Eval(context)
        pairs = []
        for i in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(i)
            pairs.append((int(info.bodyA_index()), int(info.bodyB_index())))
        inspector: Any = self._loop.station.GetOutputPort(ports.QUERY_OBJECT).Eval(context).inspector()
        for i in range(results.num_hydroelastic_contacts()):
            surface = results.hydroelastic_contact_info(i).contact_surface()
            frames = [inspector.GetFrameId(g) for g in (surface.id_M(), surface.id_N())]
            pairs.append(tuple(int(self._plant.GetBodyFromFrameId(f).index()) for f in frames))  # type: ignore[arg-type]
        for a, b in pairs:
            if (a in self._arm) == (b in self._arm):
                continue
            mine, other = (a, b) if a in self._arm else (b, a)
            name = self._plant.get_body(_index(mine)).name()
            if other not in self._obstacles:
                self.elsewhere = self.elsewhere or f"{name} on {self._plant.get_body(_index(other)).name()}"
            elif self.first is None:
                v = np.asarray(self._loop.station.GetOutputPort(ports.ARM_STATE).Eval(context))
                self.first, self.by, self.speed = now, name, float(np.abs(v[len(v) // 2 :]).max())


def aside(loop: ClosedLoop, context: Context, path: Path, now: float) -> tuple[float, float]:
    """Return how far the obstacle is from its path [m, rad]."""
    pose = np.asarray(loop.station.GetOutputPort(ports.OBJECT_POSES).Eval(context))[:7]
    (x, y, yaw), _ = path.state(now)
    turn = rotations.log(rotations.multiply(pose[:4], np.array([np.cos(yaw / 2), 0.0, 0.0, -np.sin(yaw / 2)])))
    return float(np.hypot(pose[4] - x, pose[5] - y)), float(np.linalg.norm(turn))


def visits(loop: ClosedLoop, context: Context) -> int:
    """Return how many targets were reached; `context` is the twin's."""
    runner = loop.twin.runner
    if runner is None:
        return 0
    return int(runner.standing(loop.twin.diagram.GetSubsystemContext(runner, context))["done"])


class Oracle:
    """Says of which draws it is certain that no motion survives them and makes the visits, the whole future known.

    It is generous: it asks only whether the arm starts clear, and whether for each target there are joint positions
    clear of the obstacle during enough of the time. What it lets pass may still be beyond any motion.
    """

    def __init__(self, scenario: Scenario, asset: Asset) -> None:
        """Read shapes of the arm, fixtures and one obstacle; limits are those of the runs."""
        self._scene = load_scene(scenario.twin.arm, scenario.twin.fixtures, {"obstacle": asset}, scenario.packages)
        self._home = np.array(scenario.twin.home)
        self._goals: dict[int, list[Array]] = {}

    def hopeless(self, draw: Draw) -> str:
        """Return why no motion survives a draw, nothing where one may."""
        path, times = Path(draw.path, "path"), np.arange(0.0, DURATION, 0.25)
        if self._clear(self._home[None], path, 0.0)[0] < 0.0:
            return "the arm starts in contact"
        if draw.targets not in self._goals:
            rng = np.random.default_rng(7)
            found = []
            for p in TARGETS[draw.targets]:
                X = np.eye(4)
                X[:3, :3], X[:3, 3] = np.diag([1.0, -1.0, -1.0]), p
                scene = self._scene
                found.append(inverse_kinematics.solve(scene.chain, X, self._home, scene.lower, scene.upper, rng))
            self._goals[draw.targets] = found
        for k, q in enumerate(self._goals[draw.targets]):
            free = np.mean([len(q) and self._clear(q, path, t).max() > 0.0 for t in times])
            if free < LEAST_VISITS / 2:
                return f"target {k} is blocked {100 * (1 - free):.0f} % of the time"
        return ""

    def _clear(self, q: Array, path: Path, time: float) -> Array:
        (x, y, yaw), _ = path.state(time)
        pose = np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2), x, y, path.z])
        track = Track(ObjectStatus.TRACKED, time, pose, np.zeros(6), np.zeros((6, 6))).pack()
        around = self._scene.around(Forecast.of_tracks(track), np.zeros(len(q)))
        return np.asarray(self._scene.clearance.distances(q, around, 0.1)[:, :-1].min(axis=1))


def _index(body: int) -> Any:
    from pydrake.multibody.tree import BodyIndex

    return BodyIndex(body)
