"""The planner keeps clear of further instances and of unknown things as of the library's first."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.planning.collision.collision_scene import TUNING, Scene, load_scene
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.layouts import TRACK_SIZE, ObjectStatus, Track
from twin_diagram.signals.things import FURTHER_TRACK_SIZE, Thing

Array = npt.NDArray[np.float64]
Q = np.array([0.6, 0.2, 0.0, -2.1, 0.0, 2.3, 1.4])
CUBE = np.array([[x, y, z] for x in (-0.05, 0.05) for y in (-0.05, 0.05) for z in (-0.1, 0.1)])


@pytest.fixture(scope="module")
def scene() -> Scene:
    library = {name: Asset.load(models_dir() / "objects" / name) for name in ("can", "sugar_box")}
    return load_scene(scenario.ArmModel(), [], library)


def track(place: Array, status: ObjectStatus = ObjectStatus.TRACKED) -> Array:
    return Track(status, 0.0, np.r_[1.0, 0.0, 0.0, 0.0, place], np.zeros(6), np.zeros((6, 6))).pack()


def none() -> Array:
    return np.zeros(2 * TRACK_SIZE)


def distances(scene: Scene, *told: Array | None) -> Array:
    forecast = scene.forecast(*told)  # type: ignore[arg-type]
    return scene.clearance.distances(Q[None], scene.around(forecast, np.zeros(1)), 2.0)[0]


def test_a_further_instance_is_as_far_as_the_first_would_be_there(scene: Scene) -> None:
    place = np.array([0.5, 0.35, 0.1])
    first = distances(scene, np.concatenate([track(np.zeros(3), ObjectStatus.UNSEEN), track(place)]))
    rows = np.zeros((3, FURTHER_TRACK_SIZE))
    rows[1] = [4, 1, *track(place)]
    rows[2] = [0, 0, *track(place)]  # a free slot, whatever stands in it
    beside = distances(scene, none(), rows.ravel())
    assert len(beside) == len(first) + 1 and beside[2] == pytest.approx(first[1], abs=1e-12)
    assert beside[-1] == first[-1]  # the arm to itself comes last
    rows[1, 2] = ObjectStatus.GONE
    assert distances(scene, none(), rows.ravel())[2] > 100.0


def test_an_unknown_thing_is_kept_clear_of_by_its_pieces_grown_a_little(scene: Scene) -> None:
    tool = scene.clearance.chain.place(Q[None]).X_WL[0, -1, :3, 3]
    far = tool + [0.0, 0.5, 0.0]
    thing = Thing(2, ObjectStatus.TRACKED, 0.0, 0.0, far, (CUBE + far, CUBE + far + [0.0, 0.1, 0.0]))
    free = distances(scene, none(), None, np.concatenate([Thing().pack(), Thing().pack()]))
    found = distances(scene, none(), None, np.concatenate([Thing().pack(), thing.pack()]))
    assert len(free) == 3 and len(found) == 4
    nearer = Thing(2, ObjectStatus.LOST, 0.0, 0.0, far, tuple(p - [0.0, 0.1, 0.0] for p in thing.pieces))
    assert found[2] - distances(scene, none(), None, nearer.pack())[2] == pytest.approx(0.1, abs=0.02)
    contacts = scene.clearance.contacts(
        Q[None], scene.around(scene.forecast(none(), None, thing.pack()), np.zeros(1)), 2.0, 0.0
    )
    assert set(contacts.body) == {2} and contacts.distance.min() == pytest.approx(found[2])
    assert TUNING.thing_growth > 0.0
    for status in (ObjectStatus.UNSEEN, ObjectStatus.GONE):
        away = Thing(2, status, 0.0, 0.0, far, thing.pieces)
        assert len(distances(scene, none(), None, away.pack())) == 3


def test_growth_is_what_is_said(scene: Scene) -> None:
    far = np.array([0.5, 0.6, 0.3])
    thing = Thing(1, ObjectStatus.TRACKED, 0.0, 0.0, far, (CUBE + far,))
    forecast = scene.forecast(none(), None, thing.pack())
    _, grown = forecast.at(np.zeros(1))
    np.testing.assert_allclose(grown[-1], TUNING.thing_growth)
    assert forecast.present.tolist() == [False, False, True] and not forecast.moving.any()
    # What is not a number is nothing to plan with.
    broken = thing.pack()
    broken[9] = np.nan
    assert len(scene.forecast(none(), None, broken).present) == 2


def test_an_unknown_thing_goes_on_as_it_goes_and_what_is_not_known_of_that_makes_it_larger(scene: Scene) -> None:
    far, v = np.array([0.5, 0.6, 0.3]), np.array([0.0, -0.3, 0.0])

    def ahead(variance: float) -> tuple[Array, Array]:
        piece, gone = CUBE + far, np.array([0.0, -0.02, 0.0])
        thing = Thing(1, ObjectStatus.MOVING, 0.0, 0.0, far, (piece,), v, variance, gone)
        forecast = scene.forecast(none(), None, thing.pack())
        assert forecast.moving.tolist() == [False, False, True]
        poses, grown = forecast.at(np.array([0.0, 0.1, 0.5, 9.0]))
        return poses[-1, :, :3, 3], grown[-1]

    places, grown = ahead(0.02**2)
    np.testing.assert_allclose(places[:3, 1], [-0.02, -0.05, -0.17], atol=1e-12)
    assert places[3, 1] == pytest.approx(-0.02 - 0.3 * (TUNING.steady + TUNING.fade))
    assert grown[0] == pytest.approx(TUNING.thing_growth)
    assert (np.diff(grown) >= 0.0).all() and grown[1] > grown[0]
    assert (ahead(0.1**2)[1][1:] > grown[1:]).all()
    slow = Thing(1, ObjectStatus.TRACKED, 0.0, 0.0, far, (CUBE + far,), 0.9 * TUNING.rest_speed * np.eye(3)[0])
    assert not scene.forecast(none(), None, slow.pack()).moving.any()
