"""Ways for the arm: joint goals of tool poses, paths clear of what stands about, and their timing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from twin_diagram.errors import TwinError
from twin_diagram.planning.collision.ball_cover import Balls
from twin_diagram.planning.collision.clearance import Surroundings
from twin_diagram.planning.collision.collision_scene import Scene, load_scene
from twin_diagram.planning.collision.convex_solids import Box
from twin_diagram.planning.collision.solid_batch import Body
from twin_diagram.planning.paths import inverse_kinematics, rrt_connect
from twin_diagram.scenario import Twin
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    clearance: float = 0.015
    """Kept from what stands about on the way [m]: the arm sags by some millimetres under a load."""

    close: float = 0.002
    """Kept where a stage goes near on purpose [m]: the cover by balls stands out as much again."""

    fingers: float = 0.006
    """How far balls reach beyond fingers where a stage goes near on purpose [m]; elsewhere 13 mm, with a third of the
    balls. What is held by its lower half could not be set down with those: tips seemed to stand in the bottom."""

    own: float = 0.005
    """Kept by the arm from itself [m]."""

    speed_share: float = 0.55
    """Share of the joints' limits that is used."""

    acceleration: float = 3.0
    """Of the fastest joint [rad/s²]: what is held by 60 N does not slip."""

    checks: int = 6000
    """Of the path search."""

    resolution: float = 0.06
    """Between checked configurations [rad]."""

    ends: float = 0.2
    """As far from a way's ends less than `clearance` is kept where an end itself has no more [rad]: what was just set
    down or is about to be taken is left behind by then."""

    line_step: float = 0.008
    """Between points of a straight line of the tool [m]."""

    line_steps: int = 12
    """Of the search for joint angles at each such point: three do where no limit is near."""

    line_off: float = 2e-3
    """The tool may be off such a point [m], [rad]; where no limit is near it is off by less than a millionth."""

    line_jump: float = 0.25
    """A joint that moves farther from one such point to the next has changed its branch [rad]."""

    samples: float = 0.02
    """Between points of a timed path [s]."""

    cell: float = 0.025
    """Edge of the cells whose balls stand for what is held, and whose columns for what stands about [m]."""


TUNING = Tuning()


class NoWay(TwinError):
    """The arm cannot get there; the message says where."""


@dataclass(frozen=True)
class TimedPath:
    """A timed path: times (M,) from 0 [s], joint angles (M, n) [rad]."""

    times: Array
    q: Array


def timed(path: Array, speed: Array, acceleration: float) -> TimedPath:
    """Return a path (W, n) with smooth starts and stops at each way point.

    Each straight piece has the fifth-order blend of least jerk, whose peak speed is 15/8 of its mean and whose peak
    acceleration 5.77 times its length over its time squared.
    """
    times, rows, now = [np.zeros(1)], [path[:1]], 0.0
    for a, b in pairwise(path):
        by_speed = float((np.abs(b - a) / speed).max()) * 15.0 / 8.0
        by_acceleration = float(np.sqrt(5.7735 * np.abs(b - a).max() / acceleration))
        took = max(by_speed, by_acceleration)
        if took < 1e-6:
            continue
        count = max(2, int(np.ceil(took / TUNING.samples)))
        s = np.arange(1, count + 1) / count
        blend = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        times.append(now + took * s)
        rows.append(a + blend[:, None] * (b - a))
        now += took
    return TimedPath(np.concatenate(times), np.concatenate(rows))


def pose(R: Array, p: Array) -> Array:
    """Return a rotation (3, 3) and a place (3,) as a matrix (4, 4)."""
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R, p
    return X


def pointing(approach: Array, closing: Array) -> Array:
    """Return the axes (3, 3) of a tool: z along an approach (3,), y as near to a closing axis (3,) as that allows."""
    z = approach / np.linalg.norm(approach)
    y = closing - (closing @ z) * z
    y /= np.linalg.norm(y)
    return np.stack([np.cross(y, z), y, z], axis=1)


def fraction_along(points: Array, share: float) -> Array:
    """Return the place at a share of a path's (W, n) points, in between where it falls so."""
    at = share * (len(points) - 1)
    return np.asarray([np.interp(at, np.arange(len(points)), points[:, j]) for j in range(points.shape[1])])


class Mover:
    """Plans for one arm among its fixtures; what is held and what lies about is told by call.

    Attributes:
        scene: shapes and limits.
        speed: (n,) that is used [rad/s].
        lower, upper: (n,) between which joints are kept [rad].
    """

    def __init__(self, twin: Twin, packages: dict[str, str], speed_limits: Array, seed: int = 0) -> None:
        """Read the shapes of ``twin.arm`` and ``twin.fixtures``."""
        self.scene: Scene = load_scene(twin.arm, twin.fixtures, {}, packages)
        self._close: Scene = load_scene(twin.arm, twin.fixtures, {}, packages, TUNING.fingers)
        self.speed = TUNING.speed_share * speed_limits
        self._rng = np.random.default_rng(seed)
        bound = np.full(self.scene.chain.size, 3.05)
        self.lower, self.upper = np.maximum(self.scene.lower, -bound), np.minimum(self.scene.upper, bound)
        self._carrying = self.scene
        self._standing: dict[str, Body] = {}
        self._fence: tuple[Array, Array] | None = None

    def stand(self, where: str, clouds: Sequence[Array], support: float) -> None:
        """Keep ways clear of what stands somewhere, from here on; straight lines of the tool go there on purpose.

        Args:
            where: a name; what was told of it before is forgotten.
            clouds: points (N, 3) in W of each thing [m]: what is below them counts as full.
            support: height of what they stand on [m].
        """
        solids = [box for cloud in clouds for box in columns(cloud, support, TUNING.cell)]
        self._standing.pop(where, None)
        if solids:
            self._standing[where] = Body.of(where, solids)

    @contextmanager
    def as_if(self, cloud: Array, support: float) -> Iterator[None]:
        """Take points (N, 3) in W of something [m] as standing on a support [m] until the block ends; see `stand`."""
        self.stand("as if", [cloud], support)
        try:
            yield
        finally:
            self.stand("as if", [], support)

    @contextmanager
    def blocked(self, low: Array, high: Array) -> Iterator[None]:
        """Keep ways clear of a box between corners (3,) in W [m] until the block ends."""
        self._standing["blocked"] = Body.of("blocked", [Box(0.5 * (high - low), np.eye(3), 0.5 * (low + high))])
        try:
            yield
        finally:
            del self._standing["blocked"]

    @contextmanager
    def fenced(self, low: Array, high: Array) -> Iterator[None]:
        """Keep the tool, while something is swung, between corners (3,) in W [m] until the block ends."""
        self._fence = low, high
        try:
            yield
        finally:
            self._fence = None

    def tool(self, q: Array) -> Array:
        """Return X_WT (4, 4) at joint angles (n,)."""
        return np.asarray(self.scene.chain.tool(self.scene.chain.place(q[None]))[0])

    def hold(self, points_T: Array | None) -> None:
        """Take what is held into account from here on: points (N, 3) of it in the tool's frame; None: nothing is."""
        if points_T is None or not len(points_T):
            self._carrying = self.scene
            return
        n, X_LT = self.scene.chain.size, self.scene.chain.X_LT
        cells = np.unique(np.floor(points_T / TUNING.cell), axis=0)
        centres = (cells + 0.5) * TUNING.cell @ X_LT[:3, :3].T + X_LT[:3, 3]
        count = len(centres)
        radius = np.full(count, 0.75 * TUNING.cell)
        cover = Balls(centres, radius, np.full(count, n), np.zeros(count, int), np.zeros((0, 2), int))
        self._carrying = replace(self.scene, clearance=self.scene.clearance.carrying(cover, n - 2))

    def distances(self, q: Array, reach: float = 0.1, *, standing: bool = True) -> Array:
        """Return how far the arm and what it holds are from all that stands about and from themselves.

        Args:
            q: (M, n).
            reach: distances beyond are not told apart [m].
            standing: whether what was told by `stand` counts.

        Returns:
            (M, B + 1), the last to the arm itself [m].
        """
        beside = tuple(self._standing.values()) if standing else ()
        count = len(self._carrying.clearance.bodies) + len(beside)
        poses = np.broadcast_to(np.eye(4), (count, len(q), 4, 4))
        on = np.ones(count, dtype=bool)
        return self._carrying.clearance.distances(
            q, Surroundings(poses, np.zeros((count, len(q))), on, on, beside), reach
        )

    def free(
        self, q: Array, clearance: float, *, standing: bool = True, on_purpose: bool = True
    ) -> npt.NDArray[np.bool_]:
        """Return (M,) which joint angles (M, n) keep a distance [m]; see `distances`.

        `on_purpose`: whether a stage may go near what was told by `stand`, and `Tuning.close` from it suffices.
        """
        near = self.distances(q, max(clearance, TUNING.own) + 1e-6, standing=standing)
        wanted = np.full(near.shape[1] - 1, clearance)
        if on_purpose:  # before a grasp open fingers are beside what they take, or just above it
            wanted[len(self._carrying.clearance.bodies) :] = min(clearance, TUNING.close)
        return np.asarray((near[:, :-1] >= wanted).all(axis=1) & (near[:, -1] >= TUNING.own))

    def room(self, q: Array, clearance: float, beyond: float = 0.03) -> Array:
        """Return by how much more than a clearance joint angles (M, n) keep from each thing (M, B + 2) [m].

        As what is swung is asked for; the last are the arm itself and the fence. More than `beyond` is not told.
        """
        near = self.distances(q, max(clearance, TUNING.own) + beyond)
        inside = np.full((len(q), 1), beyond)
        if self._fence is not None:
            tip, (low, high) = self.scene.chain.tool(self.scene.chain.place(q))[:, :3, 3], self._fence
            inside = np.minimum(np.minimum(tip - low, high - tip).min(axis=1, keepdims=True), beyond)
        return np.hstack([near - np.append(np.full(near.shape[1] - 1, clearance), TUNING.own), inside])

    def bare_free(self, q: Array, clearance: float, *, standing: bool = False) -> bool:
        """Return whether the arm alone, without what it holds, keeps a distance [m] at joint angles (M, n).

        Its fingers are covered more closely than elsewhere, wherever they may be between open and shut.
        """
        kept, self._carrying = self._carrying, self._close
        try:
            return bool(self.free(q, clearance, standing=standing).all())
        finally:
            self._carrying = kept

    def goals(self, X_WT: Array, near: Array, clearance: float = TUNING.clearance) -> Array:
        """Return (G, n) joint angles of a tool pose (4, 4) that are clear, the nearest to some first."""
        found = inverse_kinematics.solve(self.scene.chain, X_WT, near, self.lower, self.upper, self._rng)
        return found[self.free(found, clearance)] if len(found) else found

    def path(self, q: Array, goals: Array, clearance: float = TUNING.clearance) -> Array:
        """Return (W, n) a path from `q` to one of several joint goals (G, n).

        Raises:
            NoWay: there is no goal, or none was reached.
        """
        if not len(goals):
            raise NoWay("out of reach")
        # What is not kept here and there cannot be asked beside it; of all between only where there is no other way.
        ends = np.vstack([q[None], goals])
        kept = self.distances(ends, clearance + 1e-6)
        wanted = np.append(np.full(kept.shape[1] - 1, clearance), TUNING.own)
        least = np.minimum(wanted, kept.min(axis=0) - 1e-3)
        for reach in (TUNING.ends, np.inf) if (least < wanted).any() else (np.inf,):

            def is_free(some: Array, reach: float = reach) -> npt.NDArray[np.bool_]:
                beside = np.abs(some[:, None] - ends).max(axis=2).min(axis=1) < reach
                asked = np.where(beside[:, None], least, wanted)
                return np.asarray((self.distances(some, clearance + 1e-6) >= asked).all(axis=1))

            for goal in goals[:3]:
                if is_free(rrt_connect.interpolate(q, goal, TUNING.resolution)).all():
                    return np.stack([q, goal])
            found = rrt_connect.plan(
                q, goals, is_free, self.lower, self.upper, self._rng, TUNING.checks, weights=1.0 / self.speed
            )
            if found is not None:
                return found
        raise NoWay("no way past what stands about")

    def line(self, q: Array, X_WT: Array, clearance: float | None = None) -> Array:
        """Return (W, n) joint angles along the straight line of the tool from `q` to a pose (4, 4).

        Raises:
            NoWay: a joint's limit, another branch, or a clearance that is not kept [m].
        """
        start = self.tool(q)
        distance = float(np.linalg.norm(X_WT[:3, 3] - start[:3, 3]))
        count = max(2, int(np.ceil(distance / TUNING.line_step)))
        line = self.through(q, between(start, X_WT, np.arange(1, count + 1) / count))
        if clearance is not None and not self.free(line[1:], clearance, standing=False).all():
            raise NoWay("something is in the way of a straight line of the tool")
        return line

    def through(self, q: Array, poses: Sequence[Array]) -> Array:
        """Return (W, n) joint angles from `q` through poses of the tool (4, 4) that lie close to each other.

        Raises:
            NoWay: a joint's limit, or another branch.
        """
        rows = [q]
        for X_WT in poses:
            rows.append(self._stepped(rows[-1], X_WT))
        line = np.array(rows)
        if np.abs(np.diff(line, axis=0)).max() > TUNING.line_jump:
            raise NoWay("no straight line of the tool: the arm would have to turn over")
        return line

    def _stepped(self, q: Array, X_WT: Array) -> Array:
        """Return the joint angles of a pose near to those that are given."""
        q, error = inverse_kinematics.nearby(self.scene.chain, X_WT, q, self.lower, self.upper, TUNING.line_steps)
        if float(np.abs(error).max()) > TUNING.line_off:
            raise NoWay("a joint's limit is in the way of a straight line of the tool")
        return q

    def timed(self, path: Array, speed_share: float = 1.0) -> TimedPath:
        """Return a path with times; slower by a share where that is asked for."""
        return timed(path, self.speed * speed_share, TUNING.acceleration * speed_share)

    def timed_line(self, line: Array, speed: float) -> TimedPath:
        """Return a straight line of the tool (W, n) gone along at a speed [m/s], starting and stopping smoothly."""
        length = TUNING.line_step * (len(line) - 1)
        took = max(length / speed * 15.0 / 8.0, 0.3)
        count = max(4, int(np.ceil(took / TUNING.samples)))
        s = np.arange(count + 1) / count
        blend = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        return TimedPath(took * s, np.array([fraction_along(line, float(share)) for share in blend]))


def between(X_A: Array, X_B: Array, shares: Array) -> list[Array]:
    """Return the poses (4, 4) at shares (N,) of the way between two poses (4, 4)."""
    from scipy.spatial.transform import Rotation, Slerp

    turns = Slerp([0.0, 1.0], Rotation.from_matrix([X_A[:3, :3], X_B[:3, :3]]))(shares).as_matrix()
    places = (1.0 - shares)[:, None] * X_A[:3, 3] + shares[:, None] * X_B[:3, 3]
    return [pose(R, p) for R, p in zip(turns, places, strict=True)]


def columns(points: Array, support: float, edge: float) -> list[Box]:
    """Return boxes from a support [m] up to the highest of some points (N, 3), one a square of an edge [m]."""
    if not len(points):
        return []
    cells, index = np.unique(np.floor(points[:, :2] / edge).astype(np.int64), axis=0, return_inverse=True)
    top = np.full(len(cells), -np.inf)
    np.maximum.at(top, np.asarray(index).ravel(), points[:, 2])
    boxes = []
    for (x, y), high in zip((cells + 0.5) * edge, top, strict=True):
        half = np.array([0.5 * edge, 0.5 * edge, max(0.5 * (high - support), 1e-3)])
        boxes.append(Box(half, np.eye(3), np.array([x, y, support + half[2]])))
    return boxes


def cloud_cells(points: Array, edge: float) -> Array:
    """Return one point of each cell of an edge [m] that points (N, 3) fill: their mean."""
    if not len(points):
        return points
    _, index = np.unique(np.floor(points / edge).astype(np.int64), axis=0, return_inverse=True)
    index = np.asarray(index).ravel()
    count = np.bincount(index)
    return np.stack([np.bincount(index, points[:, j]) / count for j in range(3)], axis=1)
