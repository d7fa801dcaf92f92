"""What the hand holds: part of the arm, no obstacle; its support may be touched where that is asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests import planning_bench as bench
from tests.planning.tasks.small_world import DOWN, pose
from twin_diagram.assets import Asset
from twin_diagram.planning.collision.ball_cover import TUNING as BALL_COVER
from twin_diagram.planning.collision.collision_scene import Forecast, Scene
from twin_diagram.planning.collision.forecast_growth import TUNING as FORECAST_GROWTH
from twin_diagram.planning.collision.held_shape import TUNING, holding, obstacles_beside
from twin_diagram.planning.paths import inverse_kinematics
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import Hand
from twin_diagram.signals.layouts import TRACK_SIZE, ObjectStatus, Track
from twin_diagram.signals.pose_vectors import as_matrix, compose
from twin_diagram.signals.things import FURTHER_TRACK_SIZE, OWNER_SIZE, THING_SIZE, Thing, things_of

CAN = bench.NAMES.index("can")
HAND = Hand(held=CAN, X_TO=pose(0.0, 0.0, 0.02, DOWN))


@pytest.fixture(scope="module")
def loaded() -> tuple[Scene, dict[str, Asset]]:
    return bench.load()


@pytest.fixture(scope="module")
def q(loaded: tuple[Scene, dict[str, Asset]]) -> Array:
    """The tool points down, 0.15 m above the table."""
    scene, _ = loaded
    X_WG, rng = as_matrix(pose(0.5, 0.0, 0.15, DOWN)), np.random.default_rng(0)
    found = inverse_kinematics.solve(scene.chain, X_WG, bench.HOME, scene.lower, scene.upper, rng)
    return found[:1]


def tracks(**at: Array) -> Array:
    rows = np.zeros((len(bench.NAMES), TRACK_SIZE))
    for name, X in at.items():
        rows[bench.NAMES.index(name)] = Track(ObjectStatus.TRACKED, 0.0, X, np.zeros(6), np.zeros((6, 6))).pack()
    return rows.ravel()


def distances(scene: Scene, q: Array, rows: Array) -> Array:
    """To each body, and of the arm to itself."""
    return scene.clearance.distances(q, scene.around(Forecast.of_tracks(rows), np.zeros(1)), 1.0)[0]


def test_the_held_can_comes_nearer_to_the_table_than_the_hand(loaded, q: Array) -> None:  # type: ignore[no-untyped-def]
    """Its bottom is 0.15 − 0.02 − 0.051 m above it; the cover reaches beyond it by no more than it may."""
    scene, library = loaded
    held = holding(scene, library["can"].convex_pieces, HAND)
    bottom = 0.15 - 0.02 - 0.051
    near = distances(held, q, tracks())[0]
    assert bottom - BALL_COVER.overhang - 1e-3 < near < bottom
    assert distances(scene, q, tracks())[0] > bottom


def test_what_is_not_certain_is_larger(loaded, q: Array) -> None:  # type: ignore[no-untyped-def]
    scene, library = loaded
    plain = distances(holding(scene, library["can"].convex_pieces, HAND), q, tracks())[0]
    for std, grown in ((0.004, FORECAST_GROWTH.sigmas * 0.004), (0.1, FORECAST_GROWTH.cap)):
        # A can that turns about its own axis is where it was.
        covariance = np.diag([0.0, 0.0, 1.0, 1e-8, 1e-8, std**2])
        scene_of = holding(scene, library["can"].convex_pieces, replace(HAND, covariance=covariance))
        assert plain - distances(scene_of, q, tracks())[0] == pytest.approx(grown, abs=1e-4)


def test_what_may_have_turned_in_the_hand_stays_within_its_cover(loaded, q: Array) -> None:  # type: ignore[no-untyped-def]
    """A box that lies, 21 cm long: at 3° its ends sink by 5 mm, whatever is known of its middle."""
    scene, library = loaded
    pieces, std = library["cracker_box"].convex_pieces, np.array([0.05, 0.05, 0.05, 1e-3, 1e-3, 1e-3])
    box = bench.NAMES.index("cracker_box")
    hand = Hand(held=box, X_TO=pose(0.0, 0.0, 0.02, np.array([0.5, 0.5, 0.5, 0.5])), covariance=np.diag(std**2))
    near = distances(holding(scene, pieces, hand), q, tracks())[0]
    X_WT, X_TO = scene.chain.place(q).X_WL[0, -1] @ scene.chain.X_LT, as_matrix(hand.X_TO)
    corners_T, rng = np.vstack(pieces) @ X_TO[:3, :3].T, np.random.default_rng(0)
    for turn, shift in (std * rng.standard_normal((300, 6))).reshape(300, 2, 3):
        moved_T = Rotation.from_rotvec(turn).apply(corners_T) + X_TO[:3, 3] + shift
        assert near < (moved_T @ X_WT[:3, :3].T + X_WT[:3, 3])[:, 2].min()


def test_the_support_alone_may_be_touched_where_that_is_asked_for(loaded, q: Array) -> None:  # type: ignore[no-untyped-def]
    scene, library = loaded
    lifting = holding(scene, library["can"].convex_pieces, replace(HAND, on_support=True))
    carrying = holding(scene, library["can"].convex_pieces, HAND)
    empty = distances(scene, q, tracks())[0]
    assert distances(lifting, q, tracks())[0] == pytest.approx(empty), "the hand itself keeps clear of it"
    beside = tracks(mug=pose(0.5, 0.1, 0.05))
    mug = scene.fixture_count + bench.NAMES.index("mug")
    assert distances(lifting, q, beside)[mug] == pytest.approx(distances(carrying, q, beside)[mug])
    assert distances(lifting, q, beside)[mug] < distances(scene, q, beside)[mug]
    for on_support, nearest in ((True, scene), (False, carrying)):
        hand = replace(HAND, on_support=on_support, support=bench.NAMES.index("mug"))
        upon = holding(scene, library["can"].convex_pieces, hand)
        assert distances(upon, q, beside)[mug] == pytest.approx(distances(nearest, q, beside)[mug])


def test_what_is_held_moves_with_the_last_link(loaded, q: Array) -> None:  # type: ignore[no-untyped-def]
    """Gradients of its distance are those of a difference quotient."""
    scene, library = loaded
    tilted = compose(HAND.X_TO, pose(0, 0, 0, np.array([np.cos(0.1), np.sin(0.06), np.sin(0.08), 0])))
    held = holding(scene, library["can"].convex_pieces, replace(HAND, X_TO=tilted))
    around = held.around(Forecast.of_tracks(tracks()), np.zeros(1))
    contacts = held.clearance.contacts(q, around, 0.1, 0.0)
    nearest = int(np.argmin(np.where(contacts.body == 0, contacts.distance, 1.0)))
    for j in (1, 3, 5):
        step = 1e-5 * np.eye(7)[j]
        change = distances(held, q + step, tracks())[0] - distances(held, q - step, tracks())[0]
        assert contacts.gradient[nearest, j] == pytest.approx(change / 2e-5, abs=1e-3)


def test_it_is_kept_clear_of_the_arm_but_not_of_the_hand(loaded, q: Array) -> None:  # type: ignore[no-untyped-def]
    scene, library = loaded
    carrying = holding(scene, library["can"].convex_pieces, HAND)
    assert distances(carrying, q, tracks())[-1] == pytest.approx(distances(scene, q, tracks())[-1])
    X_WL = scene.chain.place(q).X_WL[0]
    forearm = np.linalg.inv(X_WL[7] @ scene.chain.X_LT) @ X_WL[4]
    inside = replace(HAND, X_TO=np.concatenate([[1.0, 0, 0, 0], forearm[:3, 3]]))
    assert distances(holding(scene, library["can"].convex_pieces, inside), q, tracks())[-1] < -0.01


def test_what_the_hand_is_about_is_no_obstacle(loaded, q: Array) -> None:  # type: ignore[no-untyped-def]
    """Nor is what is taken for something else at its very place; all else stays one."""
    scene, library = loaded
    sizes = np.array([asset.size for asset in library.values()])
    X_WT = scene.chain.tool(scene.chain.place(q))[0]
    X_WO = compose(pose(*X_WT[:3, 3], DOWN), HAND.X_TO)
    away = X_WO + np.array([0, 0, 0, 0, 0.5 * np.linalg.norm(sizes[CAN]) + TUNING.misnamed + 0.01, 0, 0])
    rows = tracks(can=pose(0.3, 0.3, 0.05), mug=pose(0.5, 0.2, 0.05))
    further = np.zeros((2, FURTHER_TRACK_SIZE))
    for row, X in zip(further, (X_WO, away), strict=True):
        row[:OWNER_SIZE] = [1, CAN]
        row[OWNER_SIZE:] = Track(ObjectStatus.TRACKED, 0.0, X, np.zeros(6), np.zeros((6, 6))).pack()
    piece = np.eye(4, 3)
    things = np.concatenate(
        [Thing(k + 1, ObjectStatus.TRACKED, 0.0, 0.0, X[4:], (piece,)).pack() for k, X in enumerate((X_WO, away))]
    )
    after, more, left = obstacles_beside(HAND, X_WT, sizes, rows, further.ravel(), things)
    present = Forecast.of_tracks(after).present
    assert not present[CAN] and present[bench.NAMES.index("mug")] and present.sum() == 1
    assert more is not None and more.reshape(2, -1)[:, 0].tolist() == [0.0, 1.0]
    assert left is not None and [thing.stands for thing in things_of(left)] == [False, True]
    assert left.shape == (2 * THING_SIZE,)

    touching = Hand(touched=CAN)
    after, more, _ = obstacles_beside(touching, X_WT, sizes, rows, further.ravel(), None)
    assert not Forecast.of_tracks(after).present[CAN]
    assert more is not None and more.reshape(2, -1)[:, 0].tolist() == [1.0, 1.0], "the can touched lies elsewhere"
    same = obstacles_beside(Hand(), X_WT, sizes, rows, further.ravel(), things)
    assert same[0] is rows and same[2] is things


def test_what_stood_beside_before_the_fingers_came_stays_an_obstacle(loaded) -> None:  # type: ignore[no-untyped-def]
    """What comes up at the object's place once the hand is there is it, and so is a part of it that was seen before."""
    _, library = loaded
    sizes = np.array([asset.size for asset in library.values()])
    rows, X_WO = tracks(can=pose(0.5, -0.2, 0.05)), np.array([0.5, -0.2, 0.05])
    beside = X_WO + np.array([0.5 * sizes[CAN][0] + 0.02, 0, 0])
    hand, piece = Hand(touched=CAN, since=2.0), np.eye(4, 3)

    def left(first_seen: float, middle: Array) -> bool:
        thing = Thing(1, ObjectStatus.TRACKED, first_seen, 3.0, middle, (piece,)).pack()
        more = obstacles_beside(hand, np.eye(4), sizes, rows, None, thing)[2]
        assert more is not None
        return things_of(more)[0].stands

    assert left(1.0, beside) and not left(2.5, beside)
    assert not left(1.0, X_WO + np.array([0, 0, 0.02]))
    further = np.zeros((2, FURTHER_TRACK_SIZE))
    for row, off in zip(further, (0.01, 1.1 * sizes[CAN][0]), strict=True):  # the can itself, and one that touches it
        row[:OWNER_SIZE] = [1, CAN]
        X = pose(*(X_WO + [off, 0, 0]))
        row[OWNER_SIZE:] = Track(ObjectStatus.TRACKED, 0.0, X, np.zeros(6), np.zeros((6, 6))).pack()
    more = obstacles_beside(hand, np.eye(4), sizes, rows, further.ravel(), None)[1]
    assert more is not None and more.reshape(2, -1)[:, 0].tolist() == [0.0, 1.0]


def test_what_was_let_go_and_is_called_gone_does_not_hold_the_hand() -> None:
    """An image shows it as something unknown, between the fingers: its track is parked far away then."""
    X_WT, rows = np.eye(4), np.zeros((len(bench.NAMES), TRACK_SIZE))
    X_WT[:3, 3] = [0.5, 0.3, 0.04]
    parked = Track(ObjectStatus.GONE, 0.0, pose(0.0, 0.0, -50.0), np.zeros(6), np.zeros((6, 6)))
    rows[CAN], sizes = parked.pack(), np.full((len(bench.NAMES), 3), 0.06)
    middle = np.array([0.53, 0.31, 0.05])
    thing = Thing(1, ObjectStatus.TRACKED, 0.0, 0.0, middle, (middle + 0.02 * np.eye(4, 3),)).pack()
    for around, stands in ((True, False), (False, True)):
        left = obstacles_beside(Hand(touched=CAN, around=around), X_WT, sizes, rows.ravel(), None, thing)[2]
        assert left is not None and [one.stands for one in things_of(left)] == [stands]
