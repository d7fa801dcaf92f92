"""The scene as the monitor takes it: who is there, how fast, and what is to be left to each."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.planning.braking.drake_distances import ARM, DrakeDistances
from twin_diagram.planning.braking.scene_now import TUNING, SceneNow, read_scene
from twin_diagram.planning.collision.collision_scene import TUNING as COLLISION_SCENE
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import Hand
from twin_diagram.signals.layouts import ObjectStatus, Track
from twin_diagram.signals.things import THING_SIZE, Thing

NAMES = ("can", "sugar_box")
SIZES = np.array([[0.08, 0.08, 0.08], [0.08, 0.16, 0.16]])
RADII = 0.5 * np.linalg.norm(SIZES, axis=1)
Q = np.array([0.0, 0.2, 0.0, -2.1, 0.0, 2.3, 0.785])
PARAMS = scenario.Braking(clearance=0.005, unforeseen=0.02)


@pytest.fixture(scope="module")
def near() -> DrakeDistances:
    library = {name: Asset.load(models_dir() / "objects" / name) for name in NAMES}
    arm = scenario.ArmModel(model="arms/panda_hand.urdf", tool_frame="panda_tcp")
    return DrakeDistances(arm, [scenario.Fixture()], library, 1, 2)


def track(status: ObjectStatus, std: float = 1e-4, velocity: Array | None = None, x: float = 0.5) -> Array:
    v = np.zeros(6) if velocity is None else velocity
    return Track(status, 0.0, np.array([1.0, 0, 0, 0, x, 0.1, 0.05]), v, std**2 * np.eye(6)).pack()


def scene(near: DrakeDistances, *tracks: Array, age: float = 0.0, **told: Array | None) -> SceneNow:
    ports: dict[str, Array | None] = {"further_tracks": None, "things": None, "hand": None}
    return read_scene(near, SIZES, Q, None, age, tracks=np.concatenate(tracks), **(ports | told))


def test_what_stands_is_left_the_clearance_and_what_its_covariance_and_the_images_age_say(near: DrakeDistances) -> None:
    seen = scene(near, track(ObjectStatus.TRACKED, 1e-3), track(ObjectStatus.UNSEEN), age=0.1)
    left = seen.others(PARAMS, 0.0)
    assert left.margin[0] == 0.005, "the table is where it is told"
    assert left.margin[1] == pytest.approx(0.005 + 0.003 + 0.02 * 0.1, abs=2e-4)
    assert list(left.speed) == [0.0] * 6
    assert list(left.growth) == [0.0] + [0.02] * 5
    assert seen.others(PARAMS, 0.004).margin == pytest.approx(left.margin + 0.004)
    assert list(seen.shapes.present) == [True, False, False, False, False]
    vague = scene(near, track(ObjectStatus.LOST, 0.2), track(ObjectStatus.UNSEEN))
    assert vague.others(PARAMS, 0.0).margin[1] == pytest.approx(0.005 + TUNING.doubt)


def test_what_moves_is_as_fast_as_its_farthest_point_and_where_its_track_takes_it(near: DrakeDistances) -> None:
    velocity = np.array([0.0, 0, 0.5, 0.2, 0, 0])
    seen = scene(near, track(ObjectStatus.UNSEEN), track(ObjectStatus.MOVING, velocity=velocity))
    assert seen.others(PARAMS, 0.0).speed[2] == pytest.approx(0.2 + 0.5 * RADII[1])
    present, X_WO = seen.at(0.1)
    assert list(np.flatnonzero(present)) == [1]
    assert X_WO[1, :3, 3] == pytest.approx([0.52, 0.1, 0.05])


def test_further_instances_and_things_fill_their_slots(near: DrakeDistances) -> None:
    nobody = track(ObjectStatus.UNSEEN)
    further = np.concatenate([[7.0, 1.0], track(ObjectStatus.TRACKED, x=0.7)])
    box = 0.05 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    rows = np.zeros((2, THING_SIZE))
    rows[1] = Thing(1, ObjectStatus.TRACKED, 0.0, 0.0, np.array([0.5, 0, 0.3]), (box,)).pack()
    seen = scene(near, nobody, nobody, further_tracks=further, things=rows.ravel())
    assert list(seen.shapes.present) == [False, False, True, False, True]
    assert seen.shapes.assets == (1,)
    assert seen.radii[2] == RADII[1]
    np.testing.assert_allclose(seen.shapes.things[1][0], box)
    assert seen.others(PARAMS, 0.0).margin[5] == pytest.approx(0.005 + COLLISION_SCENE.thing_growth)
    free = scene(near, nobody, nobody, further_tracks=np.r_[0.0, further[1:]], things=np.full(2 * THING_SIZE, np.nan))
    assert not free.shapes.present.any()


def test_the_hands_object_is_no_obstacle(near: DrakeDistances) -> None:
    both = track(ObjectStatus.TRACKED), track(ObjectStatus.TRACKED, x=0.7)
    held = scene(near, *both, hand=Hand(held=1, on_support=True).pack())
    assert list(held.shapes.present[:2]) == [True, False]
    assert (held.shapes.held, held.shapes.on_support) == (1, True)
    assert scene(near, *both, hand=Hand(held=1, support=0).pack()).shapes.support == 0
    for std, unsure in ((0.002, 3 * 0.002), (0.1, TUNING.doubt)):
        doubtful = Hand(held=1, covariance=np.diag([1.0, 1.0, 1.0, std**2, std**2, std**2]))
        assert scene(near, *both, hand=doubtful.pack()).shapes.unsure == pytest.approx(unsure)
    touched = scene(near, *both, hand=Hand(touched=0).pack())
    assert list(touched.shapes.present[:2]) == [False, True]
    assert (touched.shapes.held, touched.shapes.on_support) == (ARM, False)


def test_an_unknown_thing_that_moves_is_where_it_goes_and_as_fast(near: DrakeDistances) -> None:
    nobody = track(ObjectStatus.UNSEEN)
    box = 0.05 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    v, gone = np.array([0.3, 0.0, 0.0]), np.array([0.02, 0.0, 0.0])
    rows = np.zeros((2, THING_SIZE))
    rows[1] = Thing(1, ObjectStatus.MOVING, 0.0, 0.0, np.zeros(3), (box,), v, 0.04**2, gone).pack()
    seen = scene(near, nobody, nobody, things=rows.ravel())
    present, X_WO = seen.at(0.1)
    assert list(np.flatnonzero(present)) == [4]
    np.testing.assert_allclose(X_WO[4, :3, 3], gone + 0.1 * v, atol=1e-12)
    left = seen.others(PARAMS, 0.0)
    assert left.speed[5] == pytest.approx(0.3)
    assert left.growth[5] == pytest.approx(PARAMS.unforeseen + 0.04)
    assert left.growth[4] == pytest.approx(PARAMS.unforeseen)
