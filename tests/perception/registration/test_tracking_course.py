"""The course of tracking with registration replaced by given answers: who is looked for, where, with what."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tests.registration_bench import turn
from twin_diagram import scenario
from twin_diagram.perception.registration import tracking, where_expected
from twin_diagram.perception.registration.colour_shift import ALIGNED
from twin_diagram.perception.registration.global_search import TUNING as GLOBAL_SEARCH
from twin_diagram.perception.registration.naming import Naming
from twin_diagram.perception.registration.registration import RegisteredPose
from twin_diagram.perception.registration.slots import SLOT_SIZE, Slot
from twin_diagram.perception.registration.turned_alike import TUNING as TURNED
from twin_diagram.perception.registration.view import Known, View
from twin_diagram.perception.registration.where_expected import RESTING

Array = npt.NDArray[np.float64]
PARAMS = scenario.Registration(reach=0.021)
P = np.array([0.5, 0.1, 0.05])


@pytest.fixture(autouse=True)
def on_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing here is in the air; `test_mistaken` tells what is."""
    monkeypatch.setattr(tracking, "floats", lambda known, view, one: False)


def pose(p: Any = P, **changes: Any) -> RegisteredPose:
    sure = 1e-14 * np.eye(6)
    return replace(RegisteredPose(np.eye(3), np.asarray(p, dtype=float), sure, 0.9, 0.9, 1.0, 300.0), **changes)


def slot(velocity: Any = (0.0,) * 6, **changes: Any) -> Slot:
    return replace(Slot(True, np.eye(3), P, np.asarray(velocity, dtype=float), 1.0), **changes)


class Image:
    """Points in a row 1 cm apart from P on, and what was asked about them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, count: int = 40, time: float = 1.1) -> None:
        self.asked: list[Any] = []
        self.answers: list[RegisteredPose] = []
        points = P + np.arange(count)[:, None] * [0.01, 0.0, 0.0]
        self.segments: Any = SimpleNamespace(
            points_W=points, normals_W=2.0 * points, labels=np.zeros(count, dtype=int), time=time
        )
        self.view = View(self.segments, "frame", PARAMS, 10)  # type: ignore[arg-type]
        monkeypatch.setattr(tracking, "claimed", self.claimed)
        monkeypatch.setattr(where_expected, "claimed", self.claimed)
        monkeypatch.setattr(where_expected, "register", self.register)
        monkeypatch.setattr(tracking, "nearby", self.nearby)
        monkeypatch.setattr(where_expected, "assess", self.assess)
        monkeypatch.setattr(where_expected, "followed_past_tears", lambda cloud, view, one, *at: one)
        monkeypatch.setattr(where_expected, "floats", lambda *one: False)
        for module in (tracking, where_expected):
            monkeypatch.setattr(module, "stands_out", lambda *one, **anew: True)
        self.ahead = 20.0

    def assess(self, cloud: Any, image: Any, poses: Any, count: int, level: int, slack: float) -> Any:
        """As many points fit ahead as is told, and ten where it was."""
        assert image == "frame" and count == PARAMS.model_points and slack == 0.01 and poses.R.shape == (2, 3, 3)
        np.testing.assert_allclose(poses.p[1], P)
        return SimpleNamespace(points=np.array([self.ahead, 10.0]))

    def claimed(self, cloud: Any, segments: Any, R: Array, p: Array, reach: float, most: int | None = None) -> Any:
        """All points within `reach` along the row of where the object would be."""
        self.asked.append(("claimed", reach, most))
        return np.flatnonzero(np.abs(segments.points_W[:, 0] - p[0]) < reach)

    def register(
        self, cloud: Any, image: Any, R: Array, p: Array, params: Any, *, prior: Any, points_W: Any, rests: bool
    ) -> Any:
        assert image == "frame" and params is PARAMS
        assert rests == (prior is RESTING)
        self.asked.append(("register", p.copy(), prior, len(points_W)))
        return self.answers.pop(0)

    def nearby(self, cloud: Any, image: Any, R: Array, p: Array, points: Array, normals: Array, params: Any) -> Any:
        np.testing.assert_array_equal(normals, 2.0 * points)
        self.asked.append(("nearby", p.copy(), len(points)))
        return SimpleNamespace(registration=self.answers.pop(0)) if self.answers else None


KNOWN = Known(SimpleNamespace(radius=0.04, turns=[], mistaken=[], coloured=True), ["upright"], ["fallen"])  # type: ignore[arg-type, list-item]
BAD = {"quality": 0.1}
FOUND = pose()


def test_what_stands_still_is_looked_for_where_it_was_and_held_there(monkeypatch: pytest.MonkeyPatch) -> None:
    image = Image(monkeypatch)
    image.answers = [pose()]
    found = tracking.register_where_expected(KNOWN, slot(), image.view)
    assert found is not None
    (claim, (_, p, prior, thin)) = image.asked
    assert claim == ("claimed", 0.021, 120) and thin == 3
    np.testing.assert_allclose(p, P)
    np.testing.assert_allclose(prior**-0.5, [0.03] * 3 + [0.005] * 3)
    image.answers, image.asked = [pose(**BAD)], []
    assert tracking.register_where_expected(KNOWN, slot(), image.view) is None and len(image.asked) == 2


def test_what_moves_is_looked_for_ahead_then_where_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    image = Image(monkeypatch)
    image.answers = [pose(**BAD), pose()]
    moving = slot([0.0, 0.0, 0.0, 0.2, 0.0, 0.0])
    assert tracking.register_where_expected(KNOWN, moving, image.view) is not None
    looked = [one for one in image.asked if one[0] == "register"]
    np.testing.assert_allclose([one[1] for one in looked], [P + [0.02, 0.0, 0.0], P])
    for one in looked:
        np.testing.assert_allclose(one[2] ** -0.5, [0.2] * 3 + [0.03] * 3)
    image.answers, image.asked = [pose()], []
    tracking.register_where_expected(KNOWN, moving, image.view)
    assert len(image.asked) == 2, "what is found ahead is not looked for again"
    image.answers = [pose(**BAD), pose(**BAD)]
    assert tracking.register_where_expected(KNOWN, moving, image.view) is None


def test_what_stops_is_looked_for_where_it_was_first(monkeypatch: pytest.MonkeyPatch) -> None:
    image = Image(monkeypatch)
    image.answers, image.ahead = [pose(**BAD), pose()], 9.0
    assert tracking.register_where_expected(KNOWN, slot([0.0, 0.0, 0.0, 0.2, 0.0, 0.0]), image.view) is not None
    looked = [one[1] for one in image.asked if one[0] == "register"]
    np.testing.assert_allclose(looked, [P, P + [0.02, 0.0, 0.0]])


def test_an_object_that_slipped_is_looked_for_6_cm_about_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Radius 4 cm and 6 more: rows of points 1 cm apart reach from 0 to 9 cm, four to each place."""
    image = Image(monkeypatch)
    points = np.repeat(P + np.arange(20)[:, None] * [0.01, 0.0, 0.0], 4, axis=0) + [0.0, 1e-4, 0.0]
    image.segments.points_W, image.segments.normals_W = points, 2.0 * points
    free = np.ones(80, dtype=bool)
    image.answers = [pose()]
    assert tracking.register_around(KNOWN, slot(), image.view, free) is not None
    assert image.asked[-1][0] == "nearby" and image.asked[-1][2] == 40
    np.testing.assert_allclose(image.asked[-1][1], P)
    assert tracking.register_around(KNOWN, slot(), image.view, free) is None, "nothing found"
    image.answers = [pose(**BAD)]
    assert tracking.register_around(KNOWN, slot(), image.view, free) is None, "not believed"
    for left, looks in ((30, True), (29, False)):
        free = np.zeros(80, dtype=bool)
        free[:left] = free[60:] = True
        image.asked = []
        tracking.register_around(KNOWN, slot(), image.view, free)
        assert bool(image.asked) == looks


def test_an_objects_own_points_are_those_within_12_mm(monkeypatch: pytest.MonkeyPatch) -> None:
    image = Image(monkeypatch)
    free = tracking.unexplained_by([KNOWN, KNOWN], {1: pose(P + [0.1, 0.0, 0.0])}, image.segments)
    assert image.asked == [("claimed", 0.012, None)]
    np.testing.assert_array_equal(np.flatnonzero(~free), [9, 10, 11])


def test_only_what_was_found_before_is_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Slot] = []

    def expected(known: Any, own: Slot, view: Any) -> Any:
        asked.append(own)
        return pose() if own.attempts == 0 else None

    monkeypatch.setattr(tracking, "register_where_expected", expected)
    monkeypatch.setattr(tracking, "register_where_held", lambda k, *_: pose() if k == 3 else None)
    slots = [Slot(), slot(), slot(attempts=1), slot(attempts=1)]
    found = tracking.follow_known([KNOWN] * 4, slots, None)  # type: ignore[arg-type]
    assert list(found) == [1, 3] and asked == slots[1:], "the last is held"


def test_what_was_lost_less_than_three_tenths_of_a_second_ago_is_regained(monkeypatch: pytest.MonkeyPatch) -> None:
    image = Image(monkeypatch, time=1.3)
    tried: list[Any] = []

    def around(known: Any, own: Slot, view: Any, free: Any) -> Any:
        tried.append((own.seen, int(free.sum())))
        return pose(P + [0.1, 0.0, 0.0]) if own.seen != 1.25 else None

    monkeypatch.setattr(tracking, "register_around", around)
    slots = [slot(seen=s) for s in (0.99, 1.001, 1.1, 1.25, 1.2)] + [Slot(seen=1.25)]
    free = np.ones(40, dtype=bool)
    found = tracking.regain_lost([KNOWN] * 6, slots, {2: pose()}, image.view, free)
    assert list(found) == [1, 4] and tried == [(1.001, 40), (1.25, 37), (1.2, 37)]
    np.testing.assert_array_equal(np.flatnonzero(~free), [9, 10, 11])


@pytest.mark.parametrize(("angle", "kept"), [(0.5, 4.2), (0.7, 0.0)])
def test_what_is_found_again_keeps_its_odds_if_it_lies_the_same_way_round(
    monkeypatch: pytest.MonkeyPatch, angle: float, kept: float
) -> None:
    """An image that shows it late says nothing of what those before told of its turns: regained, or challenged."""
    before: list[float] = []
    image, own = Image(monkeypatch), slot(odds=4.2)
    other = pose(R=turn(angle, 0.0, 0.0))
    monkeypatch.setattr(tracking, "register_around", lambda *_: other)

    def asked(known: Known, view: View, one: RegisteredPose, odds: float = 0.0) -> RegisteredPose:
        before.append(odds)
        return one

    monkeypatch.setattr(tracking, "unmistaken", asked)
    assert tracking.regain_lost([KNOWN], [own], {}, image.view, np.ones(40, dtype=bool))[0] is other
    found = {0: SimpleNamespace(likeness=9.0, registration=other)}
    least: list[float] = []
    monkeypatch.setattr(tracking, "recognise", lambda *_, **named: least.append(named["least"]) or found)
    monkeypatch.setattr(tracking, "coarse_score", lambda *_: np.array([0.5]))
    monkeypatch.setattr(tracking, "label_of", lambda segments, own: 0)
    monkeypatch.setattr(tracking, "judged", lambda *_: 1.0)
    monkeypatch.setattr(tracking, "_convincing", lambda *_: True)
    monkeypatch.setattr(tracking, "with_name", lambda known, view, one: one)
    monkeypatch.setattr(tracking, "claimed", lambda *_: np.arange(40))
    assert tracking.challenger(KNOWN, own, pose(), image.view, np.ones(40, dtype=bool)) is not None
    assert before == [kept, kept]
    assert least == [0.5 * GLOBAL_SEARCH.hopeless], "what is far less like it than where it was followed"


@pytest.mark.parametrize(("told", "before", "wins"), [(-5.0, 2.0, False), (-5.0, -6.0, True), (-0.5, 6.0, True)])
def test_a_challenger_that_its_outline_speaks_against_gives_no_way(
    monkeypatch: pytest.MonkeyPatch, told: float, before: float, wins: bool
) -> None:
    """Half hidden, a cup that moved passed for one turned by 100°, 3 cm higher: likelier by its colours alone."""
    image, own = Image(monkeypatch), replace(slot(), named=Naming(before, 3))
    found = {0: SimpleNamespace(likeness=9.0, registration=pose())}
    monkeypatch.setattr(tracking, "recognise", lambda *_, **__: found)
    monkeypatch.setattr(tracking, "coarse_score", lambda *_: np.array([0.5]))
    monkeypatch.setattr(tracking, "label_of", lambda segments, own: 0)
    monkeypatch.setattr(tracking, "judged", lambda *_: 1.0)
    monkeypatch.setattr(tracking, "_convincing", lambda *_: True)
    monkeypatch.setattr(tracking, "with_name", lambda known, view, one: replace(one, named=Naming(told)))
    monkeypatch.setattr(tracking, "unmistaken", lambda known, view, one, odds: one)
    monkeypatch.setattr(tracking, "claimed", lambda *_: np.arange(40))
    other = tracking.challenger(KNOWN, own, pose(), image.view, np.ones(40, dtype=bool))
    assert (other is not None) == wins


def test_a_step_follows_then_regains_then_searches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of five objects one is followed, one regained, two are searched, of which one is found; one waits its turn."""
    calls: list[Any] = []
    free = np.ones(40, dtype=bool)
    monkeypatch.setattr(tracking.Frame, "of", staticmethod(lambda segments: SimpleNamespace(shift=ALIGNED)))
    monkeypatch.setattr(tracking, "follow_known", lambda *_: {0: pose(shape=0.95)})
    monkeypatch.setattr(tracking, "unexplained_by", lambda library, found, segments: free)
    monkeypatch.setattr(
        tracking, "regain_lost", lambda library, slots, found, view, free: {1: pose(P + 0.01, shape=0.95)}
    )

    def searched(library: Any, slots: Any, wanted: Any, view: View, left: Any, _: Any) -> dict[int, RegisteredPose]:
        calls.append(list(wanted))
        assert left is free and view.smallest in {40, 41}
        return {k: pose(P + 0.2) for k in wanted if k == 2}

    monkeypatch.setattr(tracking, "search_for", searched)
    slots = [slot(), slot(), Slot(next_search=1.1), Slot(attempts=1), Slot(next_search=1.11)]
    image: Any = SimpleNamespace(time=1.1, labels=np.zeros(40))
    after, results, _ = tracking.step([KNOWN] * 5, slots, image, PARAMS, 40)
    assert calls == [[2, 3]]
    assert [one.quality for one in results] == [0.9, 0.9, 0.9, 0.0, 0.0] and {one.time for one in results} == {1.1}
    assert [one.known for one in after] == [True, True, True, False, False]
    assert [one.attempts for one in after] == [0, 0, 0, 2, 0] and after[4] == slots[4]
    np.testing.assert_allclose(after[1].velocity[3:], 0.6 * 0.1 * np.ones(3))
    assert not after[2].velocity.any(), "how fast it is, a search cannot say"
    assert after[3].next_search == pytest.approx(1.1 + PARAMS.search_period)
    # Where too little is left unexplained, nothing is searched and nothing postponed.
    after, _, _ = tracking.step([KNOWN] * 5, slots, image, PARAMS, 41)
    assert calls[-1] == [] and after[3] == slots[3]


def test_a_doubtful_pose_gives_way_to_its_challenger_one_in_an_image(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three poses lack half of their colours: one waits, the longest waiting is challenged, the other one next time."""
    monkeypatch.setattr(tracking.Frame, "of", staticmethod(lambda segments: SimpleNamespace(shift=ALIGNED)))
    monkeypatch.setattr(
        tracking, "follow_known", lambda *_: {k: pose(P + k, shape=0.95, quality=0.5) for k in range(3)}
    )
    monkeypatch.setattr(tracking, "unexplained_by", lambda library, found, segments: np.zeros(40, dtype=bool))
    other = [pose(P + 0.5)]
    monkeypatch.setattr(tracking, "challenger", lambda known, own, one, view, free: other[0])
    moving = np.full(6, 0.1)
    slots = [
        slot(p=P + 0, next_search=2.0, attempts=3),
        slot(moving, p=P + 1, next_search=0.5, attempts=2),
        slot(p=P + 2, next_search=1.0),
    ]
    image: Any = SimpleNamespace(time=1.1, labels=np.zeros(40))
    after, results, _ = tracking.step([KNOWN] * 3, slots, image, PARAMS, 40)
    np.testing.assert_allclose([one.p for one in after], [P, P + 0.5, P + 2])
    assert after[1].attempts == 0 and not after[1].velocity.any() and results[1].quality == 0.9
    assert [after[k].attempts for k in (0, 2)] == [3, 0] and [after[k].next_search for k in (0, 2)] == [2.0, 1.0]
    other[0] = None  # type: ignore[assignment]
    after, _, _ = tracking.step([KNOWN] * 3, slots, image, PARAMS, 40)
    np.testing.assert_allclose(after[1].p, P + 1)
    assert after[1].attempts == 3 and after[1].next_search > 1.1, "the next challenge waits"


@pytest.mark.parametrize(("lost", "whose"), [(0.45, 1), (2.0, 0)])
def test_a_challenger_where_an_alike_was_lost_is_that_one(
    monkeypatch: pytest.MonkeyPatch, lost: float, whose: int
) -> None:
    monkeypatch.setattr(tracking.Frame, "of", staticmethod(lambda segments: SimpleNamespace(shift=ALIGNED)))
    monkeypatch.setattr(tracking, "follow_known", lambda *_: {0: pose(P, shape=0.95, quality=0.5)})
    monkeypatch.setattr(tracking, "unexplained_by", lambda library, found, segments: np.zeros(40, dtype=bool))
    monkeypatch.setattr(tracking, "regain_lost", lambda *_: {})
    monkeypatch.setattr(tracking, "challenger", lambda *_: pose(P + 0.5))
    slots = [slot(p=P), slot(p=P + lost, seen=0.2, next_search=9.0)]
    image: Any = SimpleNamespace(time=1.1, labels=np.zeros(40))
    after, results, _ = tracking.step([KNOWN] * 2, slots, image, PARAMS, 99)
    np.testing.assert_allclose(after[whose].p, P + 0.5)
    np.testing.assert_allclose(after[1 - whose].p, slots[1 - whose].p)
    assert results[whose].quality == 0.9


@pytest.mark.parametrize(("after", "near", "just"), [(0.067, 0.08, True), (0.2, 0.24, True), (0.4, 0.48, False)])
def test_how_far_what_is_carried_can_have_got_grows_with_time(after: float, near: float, just: bool) -> None:
    known = tracking.aloft(slot((0.0,) * 5 + (0.3,), seen=1.0, alike=0.7), 1.0 + after)
    assert known.near == pytest.approx(near, rel=0.01) and known.just_lost == just
    there, apart = known.p + [0.0, 0.9 * near, 0.0], known.p + [0.0, 1.1 * near, 0.0]
    assert known.may_be(pose(there)) and not known.may_be(pose(apart))
    assert not known.may_be(pose(there, likeness=0.2, shape=1.0))


def test_every_other_search_tries_what_has_fallen(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def recognise(models: Any, orientations: Any, *rest: Any) -> Any:
        asked[:] = [models, orientations, *rest[2:]]
        return {1: SimpleNamespace(registration=FOUND)}

    monkeypatch.setattr(tracking, "recognise", recognise)
    told = [Naming(4.0, 1)]
    monkeypatch.setattr(tracking, "with_name", lambda _, __, one: replace(one, named=told[0], by_shape=False))
    monkeypatch.setattr(tracking, "search_by_shape", lambda *_: {})
    monkeypatch.setattr(tracking, "unexplained_by", lambda *_: np.ones(3, dtype=bool))
    image = Image(monkeypatch)
    slots = [Slot(attempts=k) for k in range(4)]
    found = tracking.search_for([KNOWN] * 4, slots, [0, 1, 3], image.view, np.ones(3, dtype=bool), {})
    assert found == {1: replace(FOUND, odds=TURNED.most, named=told[0], by_shape=False)} and list(asked[0]) == [0, 1, 3]
    assert asked[1] == {0: ["upright"], 1: ["fallen"], 3: ["fallen"]} and asked[3:] == [PARAMS, 10, {}, []]
    told[0] = Naming(-4.0, 1)
    assert not tracking.search_for([KNOWN] * 4, slots, [0, 1, 3], image.view, np.ones(3, dtype=bool), {}), (
        "it is another"
    )


def test_a_slot_comes_back_from_its_vector() -> None:
    one = Slot(
        True,
        turn(0.1, 0.2, 0.3),
        P,
        np.arange(6.0),
        1.5,
        2.5,
        3,
        0.8,
        2.0,
        True,
        0.01 * np.arange(6.0),
        Naming(1.5, 2, 7),
        True,
    )
    packed = one.pack()
    assert packed.shape == (SLOT_SIZE,) == (30,)
    back = Slot.unpack(packed)
    assert (back.known, back.seen, back.next_search, back.attempts) == (True, 1.5, 2.5, 3)
    assert (back.alike, back.odds, back.aloft, back.named) == (0.8, 2.0, True, Naming(1.5, 2, 7)) and back.by_shape
    for name in ("R", "p", "velocity", "aside"):
        np.testing.assert_allclose(getattr(back, name), getattr(one, name), atol=1e-12)
    assert not Slot.unpack(Slot().pack()).known


def test_what_has_no_colours_is_looked_for_standing_and_lying_beside_its_likes() -> None:
    bare = Known(replace_model(coloured=False), ["upright"], ["fallen"])  # type: ignore[arg-type, list-item]
    assert tracking.orientations(bare, Slot(), 0.0) == ["upright", "fallen"]
    assert tracking._rivals([KNOWN, bare, bare, bare], [1]) == [(bare.model, ["upright", "fallen"])]
    assert tracking._rivals([KNOWN, bare], [0, 1]) == []


def replace_model(coloured: bool) -> Any:
    return SimpleNamespace(radius=0.04, turns=[], coloured=coloured)
