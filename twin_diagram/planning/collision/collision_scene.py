"""What the planner keeps clear of: fixtures, and the library's objects where they are and will be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.planning.collision.ball_cover import TUNING as COVER
from twin_diagram.planning.collision.ball_cover import arm_balls, arm_plant
from twin_diagram.planning.collision.chain import Chain, depths, drawn_range
from twin_diagram.planning.collision.clearance import Clearance, Surroundings
from twin_diagram.planning.collision.convex_solids import solid_of
from twin_diagram.planning.collision.forecast_growth import TUNING as FORECAST_GROWTH
from twin_diagram.planning.collision.geometry_to_solids import fixture_solids, world_solids
from twin_diagram.planning.collision.solid_batch import Body
from twin_diagram.planning.collision.unsure_pose import Unsure
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import TRACK_SIZE, ObjectStatus
from twin_diagram.signals.things import FURTHER_TRACK_SIZE, OWNER_SIZE, Thing, things_of


@dataclass(frozen=True)
class Tuning:
    """How objects go on and how large they are taken to be; chosen by hand.

    `tests/planning_bench.py` shows their effect on an arm among things that move (touched, arrived), and
    `sims/closed_loop.py --seeds 20` in the loop with perception.
    """

    steady: float = 1.0
    """A moving object is taken to keep its velocity for this long [s] …"""

    fade: float = 0.5
    """… and to lose it with this time constant thereafter [s]."""

    rest_speed: float = 0.015
    """Slower than this an object is taken to stand still [m/s]: so slow is the noise of tracking."""

    rest_spin: float = 0.15
    """The same for turning [rad/s]."""

    samples: int = 256
    """Configurations that tell which links never leave a fixture and which parts always touch: a share of one half is
    met to 3 %."""

    thing_growth: float = 0.005
    """An unknown thing is taken to be so much larger than its pieces [m]: what is left of the camera's calibration."""

    kept: int = 64
    """Shapes of unknown things that are kept at hand, four times as many as there are slots."""

    own_contact: float = 0.01
    """Parts of the arm nearer to each other than this count as touching [m]: `guide.Tuning.own_clearance`."""


TUNING = Tuning()


Packed = tuple[bool, tuple[bytes, ...]]
"""Whether a body is round about its z axis, and corners (V, 3) of each of its convex pieces, as bytes: they can be
compared and sent."""

_ABSENT = (ObjectStatus.UNSEEN, ObjectStatus.HELD, ObjectStatus.GONE)  # nothing stands there to keep clear of


@dataclass(frozen=True)
class Scene:
    """The arm's clearance to fixtures and library objects.

    Attributes:
        chain: the arm's kinematics.
        clearance: bodies are the fixtures, then the objects in the library's order.
        fixture_count: F; the objects are bodies F, F + 1, …
        lower, upper: (n,) the joints' limits [rad].
        added: shapes of assets that came later, see `packed`; their numbers follow the library's.
    """

    chain: Chain
    clearance: Clearance
    fixture_count: int
    lower: Array
    upper: Array
    added: list[Packed] = field(default_factory=list)

    @property
    def object_count(self) -> int:
        """K, the size of the library."""
        return len(self.clearance.bodies) - self.fixture_count

    def around(self, forecast: Forecast, times: Array, *, fixtures: bool = True) -> Surroundings:
        """Return where the bodies are at `times` (N,) from the forecast's own time on [s]; fixtures too, or absent."""
        count = len(times)
        bodies = self.fixture_count + len(forecast.present)
        X_WO = np.zeros((bodies, count, 4, 4))
        X_WO[: self.fixture_count] = np.eye(4)
        grown = np.zeros((bodies, count))
        present = np.full(bodies, fixtures)
        still = np.ones(bodies, dtype=bool)
        X_WO[self.fixture_count :], grown[self.fixture_count :] = forecast.at(times)
        present[self.fixture_count :] = forecast.present
        still[self.fixture_count :] = ~forecast.moving
        return Surroundings(X_WO, grown, present, still, forecast.beside)

    def forecast(
        self,
        tracks: Array,
        further: Array | None = None,
        things: Array | None = None,
        added: Sequence[Packed] | None = None,
    ) -> Forecast:
        """Return where all that moves or may be moved is going.

        Args:
            tracks: (K · TRACK_SIZE) of the library's objects.
            further: (F · FURTHER_TRACK_SIZE) of further instances of them; None: there are none.
            things: (T · THING_SIZE) of unknown things; None: there are none.
            added: in the place of the scene's own, where that is a copy from before they came.
        """
        forecast = Forecast.of_tracks(tracks, shapes=self.clearance.bodies[self.fixture_count :])
        parts: list[tuple[tuple[Body, ...], Forecast]] = []
        rows = _further_rows(further)
        if rows is not None and len(rows):
            shapes = tuple(self._kind(int(k), self.added if added is None else added) for k in rows[:, 1])
            parts.append((shapes, Forecast.of_tracks(rows[:, OWNER_SIZE:], shapes=shapes)))
        standing = _standing(things)
        if standing:
            shapes = tuple(
                body_of_pieces(False, tuple(corners.tobytes() for corners in thing.pieces)) for thing in standing
            )
            parts.append((shapes, Forecast.of_things(standing)))
        return forecast.joined(parts)

    def _kind(self, number: int, added: Sequence[Packed]) -> Body:
        """Return the shape of an object by its number."""
        kinds = self.clearance.bodies[self.fixture_count :]
        return kinds[number] if number < len(kinds) else body_of_pieces(*added[number - len(kinds)])


def _further_rows(further: Array | None) -> Array | None:
    """Return the rows of `further` that somebody holds; None where there is no such port."""
    if further is None or not len(further):
        return None
    rows = np.asarray(further, dtype=float).reshape(-1, FURTHER_TRACK_SIZE)
    return rows[np.isfinite(rows[:, :OWNER_SIZE]).all(axis=1) & (rows[:, 0] > 0)]


def _standing(things: Array | None) -> list[Thing]:
    """Return the unknown things that are to be kept clear of."""
    if things is None or not np.isfinite(things).all():
        return []
    return [thing for thing in things_of(things) if thing.stands and thing.pieces]


def holders(objects: int, further: Array | None, things: Array | None) -> list[tuple[int, int, int]]:
    """Return whose the bodies of `Scene.forecast` are, in its order: row, identity, kind, as `Names.of` takes them.

    Args:
        objects: K, the size of the library.
        further: as `Scene.forecast` takes it.
        things: the same.
    """
    rows = _further_rows(further)
    more = [] if rows is None else [(objects, int(row[0]), int(row[1])) for row in rows]
    unknown = [(objects, thing.identity, -1) for thing in _standing(things)]
    return [*((k, 0, k) for k in range(objects)), *more, *unknown]


def packed(asset: Asset) -> Packed:
    """Return the shape of an asset as `Scene.added` has it."""
    return asset.symmetric_axis == "z", tuple(np.array(piece, dtype=float).tobytes() for piece in asset.convex_pieces)


@lru_cache(maxsize=TUNING.kept)
def body_of_pieces(round_about_z: bool, pieces: tuple[bytes, ...]) -> Body:
    """Return the body that convex pieces make, as `Packed` tells of them."""
    return Body.of("thing", [solid_of(np.frombuffer(piece).reshape(-1, 3)) for piece in pieces], round_about_z)


def load_scene(
    spec: scenario.ArmModel,
    fixtures: Sequence[scenario.Fixture],
    library: Mapping[str, Asset],
    packages: Mapping[str, str | Path] | None = None,
    fingers: float = COVER.overhang,
) -> Scene:
    """Read everything that the planner must know about shapes.

    Args:
        spec: the arm.
        fixtures: what stands still.
        library: the known objects by name; the order is that of the tracks.
        packages: local folders for `package://` names.
        fingers: how far the arm's balls may reach beyond what moves with the gripper's joints [m].

    Raises:
        ModelError: see `ball_cover`, `geometry_to_solids` and `chain`.
    """
    plant, scene_graph, arm, keep_alive = arm_plant(spec, packages)
    depth = depths(plant, arm.joint_indices)
    chain = Chain.from_plant(plant, arm.joint_indices, arm.tool_frame)
    balls = arm_balls(plant, scene_graph, arm, depth, fingers)
    still = [*fixture_solids(fixtures, packages), (Path(arm.spec.model).stem, world_solids(plant, scene_graph))]
    del keep_alive
    bodies = [Body.of(name, solids) for name, solids in still if solids]
    fixture_count = len(bodies)
    bodies += [
        Body.of(name, [solid_of(piece) for piece in asset.convex_pieces], asset.symmetric_axis == "z")
        for name, asset in library.items()
    ]
    joints = [plant.get_joint(index) for index in arm.joint_indices]
    lower = np.array([float(joint.position_lower_limits()[0]) for joint in joints])
    upper = np.array([float(joint.position_upper_limits()[0]) for joint in joints])
    ignored = np.zeros((chain.size + 1, len(bodies)), dtype=bool)
    clearance = Clearance(chain, balls, bodies, ignored)
    q = _samples(lower, upper)
    ignored[:, :fixture_count] = _never_leaving(clearance, q, fixture_count)
    clearance = Clearance(chain, balls, bodies, ignored)
    clearance.drop_group_pairs(_always_touching(clearance, q))
    return Scene(chain, clearance, fixture_count, lower, upper)


@dataclass(frozen=True)
class Forecast:
    """Where K objects are going, as their tracks tell.

    Attributes:
        present: (K,) bool.
        moving: (K,) bool.
        R_WO: (K, 3, 3), p_WO: (K, 3): poses now [m].
        spin, velocity: (K, 3): rad/s and m/s in W, zero where an object stands still.
        grown: (K,) how much larger each is taken to be now [m].
        unsure: of those whose poses are estimates, by number, how that grows; see `Unsure`.
        beside: shapes of those that come after the library's objects: they are among the K.
        later: times count from so long after now [s].
    """

    present: npt.NDArray[np.bool_]
    moving: npt.NDArray[np.bool_]
    R_WO: Array
    p_WO: Array
    spin: Array
    velocity: Array
    grown: Array
    beside: tuple[Body, ...] = ()
    unsure: Mapping[int, Unsure] = field(default_factory=dict)
    later: float = 0.0

    @staticmethod
    def of_things(things: Sequence[Thing]) -> Forecast:
        """Return the forecast of unknown things: their frames are W where they were last seen, and go as they do."""
        count = len(things)
        present = np.array([thing.stands and bool(thing.pieces) for thing in things], dtype=bool)
        velocity = np.array([thing.velocity for thing in things]).reshape(count, 3)
        moving = present & (np.linalg.norm(velocity, axis=1) >= TUNING.rest_speed)
        velocity[~moving] = 0.0
        shift = np.array([thing.shift for thing in things]).reshape(count, 3)
        rows = np.array([[(TUNING.thing_growth / FORECAST_GROWTH.sigmas) ** 2, 0.0]])
        unsure = {k: Unsure(rows, 0.0, 0.0, True, things[k].velocity_variance) for k in np.flatnonzero(moving).tolist()}
        grown, none = np.full(count, TUNING.thing_growth), np.zeros((count, 3))
        R_WO = np.tile(np.eye(3), (count, 1, 1))
        return Forecast(present, moving, R_WO, shift, none, velocity, grown, unsure=unsure)

    def joined(self, parts: Sequence[tuple[tuple[Body, ...], Forecast]]) -> Forecast:
        """Return this forecast and others, each with the shapes of its bodies."""
        all_ = [self, *(forecast for _, forecast in parts)]
        before = np.cumsum([0, *(len(one.present) for one in all_)])
        each = zip(before[:-1].tolist(), all_, strict=True)
        unsure = {first + k: how for first, one in each for k, how in one.unsure.items()}
        return Forecast(
            present=np.concatenate([one.present for one in all_]),
            moving=np.concatenate([one.moving for one in all_]),
            R_WO=np.concatenate([one.R_WO for one in all_]),
            p_WO=np.concatenate([one.p_WO for one in all_]),
            spin=np.concatenate([one.spin for one in all_]),
            velocity=np.concatenate([one.velocity for one in all_]),
            grown=np.concatenate([one.grown for one in all_]),
            beside=tuple(body for bodies, _ in parts for body in bodies),
            unsure=unsure,
        )

    @staticmethod
    def of_tracks(tracks: Array, shapes: Sequence[Body] | None = None) -> Forecast:
        """Read packed tracks (K · TRACK_SIZE) of objects of these shapes.

        Without shapes the uncertainty of places alone counts. Objects never seen, held or gone are absent; so is one
        whose track is not finite.
        """
        rows: Array = np.asarray(tracks, dtype=float).reshape(-1, TRACK_SIZE)
        present = np.asarray(np.isfinite(rows).all(axis=1))
        for status in _ABSENT:
            present &= rows[:, 0] != status
        rows = np.where(present[:, None], rows, 0.0)
        quaternion = rows[:, 2:6].copy()
        norm = np.linalg.norm(quaternion, axis=1)
        present &= norm > 0.5
        quaternion[norm <= 0.5] = [1.0, 0.0, 0.0, 0.0]
        R_WO = Rotation.from_quat(quaternion[:, [1, 2, 3, 0]]).as_matrix() if len(rows) else np.zeros((0, 3, 3))
        spin, velocity = rows[:, 9:12].copy(), rows[:, 12:15].copy()
        spin[np.linalg.norm(spin, axis=1) < TUNING.rest_spin] = 0.0
        goes = np.linalg.norm(velocity, axis=1) >= TUNING.rest_speed
        # What turns in place moves, too: at 1 rad/s the corner of a 20 cm box goes 14 cm/s.
        turns = (rows[:, 0] == float(ObjectStatus.MOVING)) & spin.any(axis=1)
        moving = present & (goes | turns)
        velocity[~goes] = 0.0
        spin[~moving] = 0.0
        covariance = rows[:, 15:].reshape(-1, 6, 6)
        unsure = {
            k: Unsure.of(covariance[k], R_WO[k], None if shapes is None else shapes[k], moving=bool(moving[k]))
            for k in np.flatnonzero(present).tolist()
        }
        grown = np.array([unsure[k].now if k in unsure else 0.0 for k in range(len(rows))])
        return Forecast(present, moving, R_WO, rows[:, 6:9].copy(), spin, velocity, grown, unsure=unsure)

    def at(self, times: Array) -> tuple[Array, Array]:
        """Return the poses (K, N, 4, 4) and growths (K, N) at `times` (N,) from now, or from `later` [s]."""
        from twin_diagram.planning.collision import forecast_kernels  # compiled; not with every import

        times = times + self.later
        X_WO = forecast_kernels.moved(self.R_WO, self.p_WO, self.spin, self.velocity, travel(times))
        grown = np.repeat(self.grown[:, None], len(times), axis=1)
        for number, how in self.unsure.items():
            if how.moving:
                grown[number] = how.growth(times)
        return X_WO, grown


def travel(times: Array) -> Array:
    """Return how many seconds' worth of its present velocity an object moves until each time [s], ever less."""
    return np.minimum(times, TUNING.steady) + TUNING.fade * (
        1.0 - np.exp(-np.maximum(times - TUNING.steady, 0.0) / TUNING.fade)
    )


def _samples(lower: Array, upper: Array) -> Array:
    return np.random.default_rng(0).uniform(*drawn_range(lower, upper), (TUNING.samples, len(lower)))


def _here(clearance: Clearance, count: int, present: npt.NDArray[np.bool_]) -> Surroundings:
    bodies = len(clearance.bodies)
    X_WO = np.broadcast_to(np.eye(4), (bodies, count, 4, 4))
    return Surroundings(X_WO, np.zeros((bodies, count)), present, np.ones(bodies, dtype=bool))


def _never_leaving(clearance: Clearance, q: Array, fixture_count: int) -> npt.NDArray[np.bool_]:
    """Return (n + 1, F): links whose distance to a fixture no joint changes: a shoulder that turns above its table."""
    n = clearance.chain.size
    result = np.zeros((n + 1, fixture_count), dtype=bool)
    result[0] = True
    nearest = clearance.link_distances(q, _here(clearance, len(q), np.arange(len(clearance.bodies)) < fixture_count))
    spread = np.ptp(nearest[:, :, :fixture_count], axis=0)
    result[1:] = spread < 1e-6
    return result


def _always_touching(clearance: Clearance, q: Array) -> npt.NDArray[np.bool_]:
    """Return which pairs of the arm's own parts touch in most configurations.

    Neighbours by construction, not collisions.
    """
    touching = clearance.own_distances(q, TUNING.own_contact) < TUNING.own_contact
    return np.asarray(touching.mean(axis=0) > 0.5)
