"""Runs the planner against many drawn worlds without physics: `planning_bench.py --kind cross --seeds 0:50`.

The arm follows its command with a lag and a constant sag; objects are seen at 15 images a second with noise, late,
and go through the same tracking as in the twin. What is reported is held against the true poses. Seeds from 1000 on
are for final figures alone: nothing was tuned on them.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.planning.collision.collision_scene import Forecast, Scene, load_scene
from twin_diagram.planning.mpc.planner import MotionPlanner, Report
from twin_diagram.planning.mpc.planner_state import Memory
from twin_diagram.planning.paths import inverse_kinematics
from twin_diagram.scenario.resources import models_dir
from twin_diagram.scene import object_filter, object_update
from twin_diagram.signals.layouts import TRACK_SIZE, PoseMeasurement

HOME = np.array([0.55, 0.1, 0.0, -2.0, 0.0, 2.1, 1.33])
VELOCITY_LIMIT = np.array([2.175] * 4 + [2.61] * 3)
NAMES = ["cracker_box", "sugar_box", "gelatin_box", "can", "mug", "bottle", "mover"]
IMAGE_PERIOD, LATENCY = 1 / 15, 0.05
DOWN = np.diag([1.0, -1.0, -1.0])
KINDS = ("demo", "cross", "near", "attack")


def load() -> tuple[Scene, dict[str, Asset]]:
    library = {name: Asset.load(models_dir() / "objects" / name) for name in NAMES}
    return load_scene(scenario.ArmModel(), [scenario.Fixture()], library), library


@dataclass
class World:
    """A drawn world: objects stand still but for the last, which goes along way points."""

    present: np.ndarray
    p_WO: np.ndarray
    yaw: np.ndarray
    times: np.ndarray
    way: np.ndarray
    turn: np.ndarray
    q_start: np.ndarray
    goal: np.ndarray | None

    def poses(self, now: float) -> np.ndarray:
        """(K, 7)"""
        p, yaw = self.p_WO.copy(), self.yaw.copy()
        s = np.clip((now - self.times[0]) / (self.times[1] - self.times[0]), 0.0, 1.0)
        s = s * s * (3 - 2 * s)  # as the simulator's paths: rest to rest
        p[-1] = self.way[0] + s * (self.way[1] - self.way[0])
        yaw[-1] = self.turn[0] + s * (self.turn[1] - self.turn[0])
        quaternion = Rotation.from_euler("z", yaw[:, None]).as_quat()[:, [3, 0, 1, 2]]
        return np.hstack([quaternion, p])


def draw(kind: str, seed: int, scene: Scene, library: dict[str, Asset]) -> World:
    rng = np.random.default_rng([KINDS.index(kind), seed])
    sizes = np.array([library[name].size for name in NAMES])
    radii = np.hypot(sizes[:, 0], sizes[:, 1]) / 2
    for _ in range(1000):
        if kind == "demo":
            q_start, p_goal = HOME, np.array([0.5, -0.25, 0.16])
        else:
            side = rng.choice([-1.0, 1.0])
            q_start = None
            p_start = np.array([rng.uniform(0.35, 0.6), side * rng.uniform(0.15, 0.35), rng.uniform(0.12, 0.3)])
            p_goal = np.array([rng.uniform(0.35, 0.65), -side * rng.uniform(0.1, 0.35), rng.uniform(0.12, 0.25)])
            found = inverse_kinematics.solve(
                scene.chain, _pose(p_start, rng.uniform(-1, 1)), HOME, scene.lower, scene.upper, rng
            )
            if len(found):
                q_start = found[0]
        if q_start is None:
            continue
        start = scene.chain.tool(scene.chain.place(q_start[None]))[0, :2, 3]
        goal = p_goal[:2]
        speed = rng.uniform(0.05, 0.15)
        if kind == "demo":
            end = start + (goal - start) * rng.uniform(0.35, 0.65) + rng.uniform(-0.03, 0.06) * np.array([1.0, 0.0])
            away = np.array([rng.uniform(0.18, 0.28), rng.uniform(-0.2, 0.2)])
            way, begin = np.array([end + away, end]), rng.uniform(0.5, 1.5)
            duration = rng.uniform(2.0, 4.0)
        elif kind == "cross":
            middle = start + (goal - start) * rng.uniform(0.3, 0.7)
            across = np.array([-(goal - start)[1], (goal - start)[0]]) / np.linalg.norm(goal - start)
            angle = rng.uniform(-0.6, 0.6)
            across = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) @ across
            across *= rng.choice([-1.0, 1.0])
            reach = rng.uniform(0.15, 0.3, 2)
            way = np.array([middle - reach[0] * across, middle + rng.uniform(0, 1) * reach[1] * across])
            begin, duration = rng.uniform(0.0, 1.5), np.linalg.norm(way[1] - way[0]) / speed
        elif kind == "near":
            angle = rng.uniform(0, 2 * np.pi)
            end = goal + (radii[-1] + rng.uniform(0.15, 0.2)) * np.array([np.cos(angle), np.sin(angle)])
            away = rng.uniform(-1, 1, 2)
            way = np.array([end + away / np.linalg.norm(away) * rng.uniform(0.2, 0.35), end])
            begin, duration = rng.uniform(0.0, 2.0), np.linalg.norm(way[1] - way[0]) / speed
        else:
            angle = rng.uniform(-1.2, 1.2)
            away = np.array([np.cos(angle), np.sin(angle)]) * rng.uniform(0.25, 0.35)
            way = np.array([start + away, start - away * rng.uniform(0.0, 0.5)])
            begin, duration = 0.5, np.linalg.norm(way[1] - way[0]) / speed
        low, high = np.array([0.28, -0.5]), np.array([0.85, 0.5])
        if ((way < low) | (way > high)).any():
            continue
        line = way[0] + np.linspace(0, 1, 20)[:, None] * (way[1] - way[0])
        ends = [start] if kind == "attack" else [start, goal]
        apart = [np.linalg.norm(line - point, axis=1).min() for point in ends]
        if kind != "attack" and min(apart) < radii[-1] + 0.14:
            continue
        if kind == "attack" and np.linalg.norm(way[0] - start) < radii[-1] + 0.16:
            continue
        world = _fill(rng, kind, sizes, radii, line, start, goal)
        if world is None:
            continue
        present, p_WO, yaw = world
        turn = yaw[-1] + np.array([0.0, rng.uniform(-0.8, 0.8)])
        z = sizes[-1, 2] / 2
        drawn = World(
            present, p_WO, yaw, np.array([begin, begin + max(duration, 0.5)]),
            np.hstack([way, [[z], [z]]]), turn, q_start,
            None if kind == "attack" else _pose(p_goal, 0.0 if kind == "demo" else rng.uniform(-1, 1)),
        )  # fmt: skip
        if _sound(drawn, scene, rng):
            return drawn
    raise RuntimeError(f"no world for {kind} {seed}")


def _sound(world: World, scene: Scene, rng: np.random.Generator) -> bool:
    """Start clear of everything, and a goal that can be taken with everything where it ends."""
    if true_clearance(scene, world, world.q_start[None], np.zeros(1))[0] < 0.04:
        return False
    if world.goal is None:
        return True
    goals = inverse_kinematics.solve(scene.chain, world.goal, world.q_start, scene.lower, scene.upper, rng)
    return bool(len(goals)) and true_clearance(scene, world, goals, np.full(len(goals), 20.0)).max() > 0.03


def _fill(rng, kind, sizes, radii, line, start, goal):  # type: ignore[no-untyped-def]
    present = np.ones(len(NAMES), dtype=bool)
    present[rng.permutation(len(NAMES) - 1)[: rng.integers(0, 3)]] = False
    p_WO = np.zeros((len(NAMES), 3))
    p_WO[:, 2] = sizes[:, 2] / 2
    p_WO[-1, :2] = line[0]
    yaw = rng.uniform(-np.pi, np.pi, len(NAMES))
    taken = [(line, radii[-1])]
    for k in np.flatnonzero(present[:-1]):
        for _ in range(60):
            p = rng.uniform([0.30, -0.46], [0.80, 0.46])
            room = all(np.linalg.norm(c - p, axis=-1).min() > radii[k] + r + 0.03 for c, r in taken)
            if room and min(np.linalg.norm(p - start), np.linalg.norm(p - goal)) > radii[k] + 0.13:
                break
        else:
            return None
        taken.append((p[None], radii[k]))
        p_WO[k, :2] = p
    return present, p_WO, yaw


def _pose(p: np.ndarray, yaw: float) -> np.ndarray:
    X = np.eye(4)
    X[:3, :3] = Rotation.from_euler("z", yaw).as_matrix() @ DOWN
    X[:3, 3] = p
    return X


def true_clearance(scene: Scene, world: World, q: np.ndarray, times: np.ndarray) -> np.ndarray:
    """(N,) smallest distance to anything; what covers the arm makes it a lower bound of the true one."""
    distances = []
    for now, row in zip(times, q, strict=True):
        tracks = np.zeros((len(NAMES), TRACK_SIZE))
        tracks[:, 0] = np.where(world.present, 1.0, 0.0)
        tracks[:, 2:9] = world.poses(now)
        around = scene.around(Forecast.of_tracks(tracks.ravel()), np.zeros(1))
        distances.append(scene.clearance.distances(row[None], around, 0.3)[0, :-1].min())
    return np.array(distances)


@dataclass
class Run:
    """What a run gives."""

    reached_at: float | None = None
    error_mm: float = np.nan
    angle: float = np.nan
    clearance: float = np.inf
    ticks_ms: list[float] = field(default_factory=list)
    reports: list[Report] = field(default_factory=list)
    q: list[np.ndarray] = field(default_factory=list)
    q_command: list[np.ndarray] = field(default_factory=list)
    clearances: list[float] = field(default_factory=list)
    times: list[float] = field(default_factory=list)


def run(
    planner: MotionPlanner, scene: Scene, world: World, seed: int, duration: float = 10.0, lag: float = 0.06
) -> Run:
    rng = np.random.default_rng([77, seed])
    tuning = object_filter.FilterSettings.of(scenario.SceneUpdater())
    filters = object_filter.initial_filters(len(NAMES))
    sag = rng.uniform(-0.008, 0.008, len(HOME))
    dt, period = 1 / 120, 1 / planner.params.rate
    q, v = world.q_start + sag, np.zeros(len(HOME))
    memory: Memory = planner.initial(world.q_start)
    result = Run()
    pending: list[tuple[float, np.ndarray, float]] = []
    goal = np.zeros(7)
    next_image = 0.0
    next_tick = 0.0
    covariance = np.diag([0.02**2] * 3 + [0.002**2] * 3)
    for step in range(round(duration / dt)):
        now = step * dt
        if now >= next_image - 1e-9:
            noisy = world.poses(now)
            noisy[:, 4:] += 0.002 * rng.standard_normal((len(NAMES), 3))
            turn = Rotation.from_rotvec(0.02 * rng.standard_normal((len(NAMES), 3)))
            noisy[:, :4] = (turn * Rotation.from_quat(noisy[:, [1, 2, 3, 0]])).as_quat()[:, [3, 0, 1, 2]]
            pending.append((now + LATENCY, noisy, now))
            next_image += IMAGE_PERIOD
        while pending and pending[0][0] <= now:
            _, noisy, taken = pending.pop(0)
            for k in np.flatnonzero(world.present):
                filters[k] = object_update.update(
                    filters[k], PoseMeasurement(1.0, taken, noisy[k], covariance), now, tuning, NAMES[k] == "can"
                )
        if world.goal is not None and now >= 0.5:
            R = Rotation.from_matrix(world.goal[:3, :3]).as_quat()[[3, 0, 1, 2]]
            goal = np.concatenate([R, world.goal[:3, 3]])
        if now >= next_tick - 1e-9:
            tracks = pack_tracks(filters, now, tuning)
            begin = time.process_time()
            memory, report = planner.tick(memory, now, np.concatenate([q, v]), tracks, goal)
            result.ticks_ms.append(1e3 * (time.process_time() - begin))
            result.reports.append(report)
            next_tick += period
        command = memory.trajectory.position(now)
        q_next = q + (1 - np.exp(-dt / lag)) * (command + sag - q) if lag > 0 else command + sag
        q, v = q_next, (q_next - q) / dt
        if step % 3 == 0:
            result.times.append(now)
            result.q.append(q)
            result.q_command.append(command)
            result.clearances.append(float(true_clearance(scene, world, q[None], np.array([now]))[0]))
            if world.goal is not None:
                error = inverse_kinematics.pose_error(scene.chain.tool(scene.chain.place(q[None])), world.goal)[0]
                result.error_mm, result.angle = 1e3 * float(np.linalg.norm(error[3:])), float(np.linalg.norm(error[:3]))
                if result.error_mm < 10 and result.angle < 0.1:
                    result.reached_at = now if result.reached_at is None else result.reached_at
                else:
                    result.reached_at = None
    result.clearance = min(result.clearances)
    return result


def pack_tracks(filters: np.ndarray, now: float, tuning: object_filter.FilterSettings) -> np.ndarray:
    belief = object_filter.propagate(filters, now, tuning)
    tracks = np.empty((len(filters), TRACK_SIZE))
    tracks[:, 0] = object_filter.statuses(filters, now, tuning)
    tracks[:, 1] = filters[:, object_filter.FilterLayout.LAST_SEEN]
    tracks[:, 2:9], tracks[:, 9:15] = belief.poses, belief.velocities
    tracks[:, 15:] = belief.covariances[:, :6, :6].reshape(len(filters), 36)
    tracks[:, 15:] = _pose_covariance(belief.covariances).reshape(len(filters), 36)
    return tracks.ravel()


def _pose_covariance(covariances: np.ndarray) -> np.ndarray:
    index = np.array([*range(3), *range(3, 6)])
    return covariances[:, index[:, None], index[None, :]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kind", default="cross", choices=KINDS)
    parser.add_argument("--seeds", default="0:20")
    parser.add_argument("--lag", type=float, default=0.06)
    parser.add_argument("--rate", type=float, default=scenario.Planner().rate)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    first, last = map(int, arguments.seeds.split(":"))
    scene, library = load()
    planner = MotionPlanner(scene, VELOCITY_LIMIT, scenario.Planner(rate=arguments.rate))
    clearances, reached, ticks = [], [], []
    for seed in range(first, last):
        world = draw(arguments.kind, seed, scene, library)
        result = run(planner, scene, world, seed, lag=arguments.lag)
        clearances.append(result.clearance)
        ticks += result.ticks_ms
        reached.append(result.reached_at)
        unsolved = sum(not report.solved for report in result.reports)
        print(
            f"{arguments.kind} {seed:4d}  clearance {1e3 * result.clearance:6.1f} mm  reached {result.reached_at}"
            f"  error {result.error_mm:6.1f} mm {result.angle:.3f} rad  unsolved {unsolved}"
            f"  tick {np.median(result.ticks_ms):.0f}/{max(result.ticks_ms):.0f} ms",
            flush=True,
        )
    times = [t for t in reached if t is not None]
    print(
        f"{arguments.kind}: reached {len(times)}/{len(reached)} (median {np.median(times) if times else np.nan:.2f} s, "
        f"worst {max(times, default=np.nan):.2f} s); clearance min {1e3 * min(clearances):.1f} mm, "
        f"below 20 mm: {sum(c < 0.02 for c in clearances)}; tick median {np.median(ticks):.1f} ms, "
        f"p99 {np.percentile(ticks, 99):.1f} ms, mean {np.mean(ticks):.1f} ms"
    )


if __name__ == "__main__":
    main()
