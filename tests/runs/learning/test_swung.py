"""What was swung is kept as it is, and where the object crept in the hand its pose is taken in the middle."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydrake.math import RigidTransform
from scipy.spatial.transform import Rotation

from tests.estimation.weighing.conftest import MODEL, POSTURE
from twin_diagram import scenario
from twin_diagram.estimation.weighing import Grip, WeighingError
from twin_diagram.estimation.weighing.excitation import NotClear
from twin_diagram.estimation.weighing.held import Held
from twin_diagram.logs.measured_log import Log
from twin_diagram.model import Model
from twin_diagram.runs.learning import swinging, weighing
from twin_diagram.runs.learning.bearing import Borne
from twin_diagram.runs.learning.cell import TUNING as CELL
from twin_diagram.runs.learning.cell import Cell, Recording
from twin_diagram.runs.learning.felt_weight import first_mass
from twin_diagram.runs.learning.following import Followed
from twin_diagram.runs.learning.motion import Mover, pointing, pose
from twin_diagram.runs.learning.record import SWUNG
from twin_diagram.runs.learning.shown_object import ShownObject
from twin_diagram.runs.learning.swing_room import first_with_room
from twin_diagram.runs.learning.swung_log import Swung, read_swung, slipped, way_slipped, write_swung
from twin_diagram.runs.learning.weighing import Slipping, grip_on, share_of, swing
from twin_diagram.scenario.file import load_scenario
from twin_diagram.signals.arrays import Array


def swung() -> Swung:
    rng = np.random.default_rng(0)
    q, v, tau = rng.normal(size=(3, 20, 2))
    log = Log(0.005 * np.arange(20), ("a", "b"), q, velocity=v, torque=tau, source="loaded")
    X_TS = np.eye(4)
    X_TS[:3, :3], X_TS[:3, 3] = Rotation.from_rotvec([0.3, 0.0, 0.1]).as_matrix(), [0.0, 0.01, 0.05]
    return Swung(log, {"left": -0.02, "right": 0.02}, X_TS, way=np.linspace(-1.0, 1.0, 20) ** 3)


def test_what_was_swung_comes_back(tmp_path: Path) -> None:
    sent = slipped(swung(), np.eye(4))
    write_swung(tmp_path / "swung.npz", sent)
    back = read_swung(tmp_path / "swung.npz")
    assert back.fingers == sent.fingers and back.slip == sent.slip and (back.X_TS == sent.X_TS).all()
    assert back.way is not None and sent.way is not None and (back.way == sent.way).all()
    write_swung(tmp_path / "swung.npz", replace(sent, way=None))
    assert read_swung(tmp_path / "swung.npz").way is None
    assert (back.log.position == sent.log.position).all() and back.log.joints == ("a", "b")
    assert back.log.torque is not None and sent.log.torque is not None and (back.log.torque == sent.log.torque).all()


def test_what_crept_is_in_the_middle_of_its_way() -> None:
    before = swung()
    after = before.X_TS.copy()
    after[:3, :3] = after[:3, :3] @ Rotation.from_rotvec([0.0, 0.04, 0.0]).as_matrix()
    after[:3, 3] += [0.006, 0.0, -0.008]
    middle = slipped(before, after)
    assert middle.slip == pytest.approx((0.010, 0.04))
    assert middle.X_TS[:3, 3] == pytest.approx(before.X_TS[:3, 3] + [0.003, 0.0, -0.004])
    half = Rotation.from_matrix(before.X_TS[:3, :3].T @ middle.X_TS[:3, :3]).as_rotvec()
    assert half == pytest.approx([0.0, 0.02, 0.0], abs=1e-12)
    still = slipped(before, before.X_TS)
    assert still.X_TS == pytest.approx(before.X_TS) and still.slip == pytest.approx((0.0, 0.0), abs=1e-9)


def test_fingers_tell_when_what_they_hold_slipped() -> None:
    """As a bottle's did, which turned by 2° all at once: in by 0.21 mm, back to 0.17."""
    time, rng = np.arange(0.0, 10.0, 0.0025), np.random.default_rng(0)
    opening = 0.0643 + 2e-6 * rng.normal(size=len(time))
    opening -= np.interp(time, [2.8, 3.0, 3.3], [0.0, 2.1e-4, 1.7e-4])
    way = way_slipped(np.array([-0.3, 1.0, 2.7, 3.1, 6.0, 10.3]), np.column_stack([time, opening]))
    assert way == pytest.approx([-1.0, -1.0, -1.0, 1.0, 1.0, 1.0], abs=0.1)
    still = np.column_stack([time, 0.0643 + 2e-6 * rng.normal(size=len(time))])
    assert way_slipped(time, still) is None, "what slides between flat sides does not move them"


def drum(axis: Array, radius: float) -> Array:
    """Points (N, 3) all over a long drum about a direction (3,) through the pads' middle, every millimetre or so."""
    angle, along = np.random.default_rng(1).uniform([0.0, -0.05], [2.0 * np.pi, 0.05], (40000, 2)).T
    across = np.cross(axis, [0.0, 1.0, 0.0])
    ring = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.array([0.0, 1.0, 0.0])
    return np.asarray(radius * ring + along[:, None] * axis + np.array([0.0, 0.0, -0.0125]))


def test_pads_hold_a_flat_thing_all_over_and_a_round_one_along_a_strip() -> None:
    rng = np.random.default_rng(0)
    flat = np.column_stack([rng.uniform(-0.04, 0.04, 4000), np.full(4000, 0.02), rng.uniform(-0.06, 0.06, 4000)])
    held = grip_on(np.vstack([flat, flat * [1.0, -1.0, 1.0]]), 0.04, 75.0)
    assert held.pad_width == pytest.approx(0.021, abs=1e-3) and held.pad_length == pytest.approx(0.045, abs=2e-3)
    assert held.centre == pytest.approx((0.0, 0.0, -0.0125), abs=1e-3)
    upright = grip_on(drum(np.array([0.0, 0.0, 1.0]), 0.02), 0.04, 75.0)
    assert upright.pad_length > 0.04 and 0.008 < upright.pad_width < 0.013
    slanted = grip_on(drum(np.array([0.5, 0.0, -np.sqrt(0.75)]), 0.02), 0.04, 75.0)
    assert slanted.pad_length < 0.6 * upright.pad_length
    assert (slanted.capacity[3:] < held.capacity[3:]).all(), "about no axis does a strip hold as much as a patch"
    # Hardly any point where the pads are: what is nearest is taken for it.
    sparse = grip_on(np.vstack([flat, flat * [1.0, -1.0, 1.0]]), 0.034, 75.0)
    assert sparse.pad_length == pytest.approx(0.045, abs=2e-3)


def test_what_takes_much_of_the_grip_at_rest_is_swung_with_more_of_it() -> None:
    grip = Grip(75.0, 0.3, 0.02, 0.04, (0.0, 0.0, -0.01), 0.25)
    assert share_of(grip, 0.3, np.array([0.0, 0.0, 0.03])) == 0.25, "it hangs straight below"
    slide, turn = grip.capacity[0], grip.capacity[4]
    beside = share_of(grip, 1.0, np.array([0.05, 0.0, 0.03]))
    assert beside == pytest.approx(1.5 * np.hypot(9.81 / slide, 9.81 * 0.05 / turn))
    assert share_of(grip, 2.0, np.array([0.3, 0.0, 0.03])) == 2.5, "there is an end to it"
    # Half as much beyond what is asked at rest: half of it all would leave what hangs far beside the pads no motion.
    assert share_of(grip, 1.0, np.array([0.05, 0.0, 0.03]), 0.5) == pytest.approx(beside * 1.25 / 1.5)
    assert share_of(grip, 0.3, np.array([0.0, 0.0, 0.03]), 0.5) == pytest.approx(
        max(0.125, 1.25 * 0.3 * 9.81 / slide), rel=1e-6
    )


class Hand:
    """A cell whose fingers come together from some time on while the arm swings."""

    def __init__(self, turns: float) -> None:
        self._turns, self.opening, self.braked, self.time = turns, 0.045, False, 0.0

    @contextmanager
    def recording(self) -> Iterator[Recording]:
        told = Recording()
        for k in range(3):
            told.time.append(0.005 * k)
            for row in (told.position, told.velocity, told.torque):
                row.append(np.zeros(2))
        yield told

    def wait(self, seconds: float) -> None:
        pass

    def follow(self, times: Array, q: Array, at: Any, torque: Array | None) -> None:
        for now in times:
            self.time, self.opening = float(now), 0.045 - 0.002 * max(0.0, now - self._turns)
            at(now)

    def brake(self) -> None:
        self.braked = True


def test_what_turns_between_the_fingers_is_swung_no_further() -> None:
    motion: Any = SimpleNamespace(harmonics=SimpleNamespace(period=1.0), at=lambda times: (np.zeros((len(times), 2)),))
    calm, turning = Hand(2.0), Hand(0.5)
    noted = list[tuple[float, float]]()
    swing(calm, motion, ("a", "b"), "loaded", noted)  # type: ignore[arg-type]
    assert not calm.braked and noted[0] == (0.0, 0.045) and len(noted) == 401
    with pytest.raises(Slipping, match="turns between the fingers"):
        swing(turning, motion, ("a", "b"), "loaded", [])  # type: ignore[arg-type]
    assert turning.braked and turning.opening == pytest.approx(0.0445, abs=2e-5), "a quarter of a second later"
    bare = Hand(0.5)
    swing(bare, motion, ("a", "b"), "empty")  # type: ignore[arg-type]
    assert not bare.braked, "in an empty hand nothing turns: fingers that give way by 1 mm end no run"


def test_a_swung_arm_is_told_to_speed_up_as_steadily_as_the_motion_does() -> None:
    """Commands on chords between knots jump to and fro: torques were taken at every other one, inertia for 5 % more."""
    sent: list[Array] = []
    cell: Any = Hand(2.0)
    cell.time, cell._recording, cell._command = 0.0, Recording(), np.zeros(1)
    cell._advance = lambda until: sent.append(cell._command)
    cell.follow = lambda times, q, at, torque: Cell.follow(cell, times, q, at, torque)
    motion: Any = SimpleNamespace(harmonics=SimpleNamespace(period=1.0), at=lambda t: (np.sin(9.0 * t)[:, None],))
    swing(cell, motion, ("a", "b"), "loaded")
    tick = CELL.weighed_tick
    asked = np.diff(np.ravel(sent), 2) / tick**2
    assert asked == pytest.approx(-81.0 * np.sin(9.0 * tick * np.arange(2, len(sent))), abs=0.1)


@pytest.mark.parametrize(("mass", "told"), [(0.8, 0.8), (0.02, 0.05), (4.0, 2.5)])
def test_what_hangs_at_the_tool_is_as_heavy_as_torques_at_rest_say(mass: float, told: float) -> None:
    model, q, rest = (
        Model.load(scenario.ArmModel(model=str(MODEL), tool_frame="wsg_tcp")),
        POSTURE[None],
        np.zeros((1, 7)),
    )
    point = np.array([mass, *[0.0] * 9])
    held = Held.in_tool(model, RigidTransform())
    torque = model.inverse_dynamics(q, rest, rest)[0]
    torque[held.rows] += (held.regressor(model, q, rest, rest) @ point)[0]

    @contextmanager
    def recording() -> Iterator[Recording]:
        yield Recording(torque=[torque, torque])

    cell: Any = SimpleNamespace(q=POSTURE, recording=recording, wait=lambda seconds: None)
    assert first_mass(model, cell) == pytest.approx(told, rel=1e-6)


@pytest.mark.parametrize(("opening", "told"), [(0.04, 0.9), (0.001, None)])
def test_what_cannot_be_swung_was_weighed_at_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, opening: float, told: float | None
) -> None:
    def no_motion(*rest: Any) -> None:
        raise WeighingError("no motion about this posture is clear")

    monkeypatch.setattr(swinging, "weigh_at_rest", lambda model, mover, cell: 0.9)
    monkeypatch.setattr(swinging, "swing_held", no_motion)
    learning = scenario.Learning(into_bin=[[0.276, 0.166, 0.007], [0.564, 0.554, 0.12]])
    monkeypatch.setattr(swinging, "kept_clear", lambda tools: nullcontext())
    tools: Any = SimpleNamespace(
        learning=learning, mover=None, cell=SimpleNamespace(opening=opening), model=None, driven=None
    )
    shown = ShownObject(Followed(points=np.zeros((1, 3))), [np.eye(4)])
    with pytest.raises(WeighingError, match="no motion"):
        swinging.weigh_held(tools, shown, tmp_path)
    assert shown.mass_at_rest == told and shown.swung is None


@pytest.mark.parametrize(
    ("ways", "kept", "notes"),
    [
        ([0.004], 0.004, 0),
        ([0.036, 0.002], 0.002, 1),
        ([0.036, 0.012], 0.012, 2),
        ([0.020, 0.036], 0.020, 2),
        ([0.036, None], 0.036, 2),
    ],
)
def test_what_slid_far_is_swung_once_more_and_kept_where_it_slid_less(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ways: list[float | None], kept: float, notes: int
) -> None:
    """By 36 mm and 38° a loaded bottle slid between the fingers, and its inertia was told as sure as any."""
    asked, left = list[float](), list(ways)

    def swing_held(driven: Any, mover: Any, cell: Any, X_TS: Array, *rest: Any) -> Any:
        asked.append(rest[-1])
        if left[0] is None:
            raise Slipping("it turns between the fingers")
        return replace(swung(), X_TS=X_TS, way=None), SimpleNamespace(number=len(asked))

    def found_again(seen: Any, pictures: Any, X_ST: Array, crept: Any) -> Array:
        moved = X_ST.copy()
        moved[2, 3] += left.pop(0) or 0.0
        return moved

    monkeypatch.setattr(swinging, "weigh_at_rest", lambda model, mover, cell: 0.9)
    for name, stage in (("swing_held", swing_held), ("found_again", found_again)):
        monkeypatch.setattr(swinging, name, stage)
    for name in ("_glance", "_find_turned", "hold_seen"):
        monkeypatch.setattr(swinging, name, lambda *told: [])
    monkeypatch.setattr(swinging, "kept_clear", lambda tools: nullcontext())
    tools: Any = SimpleNamespace(
        learning=scenario.Learning(), mover=None, cell=SimpleNamespace(opening=0.04), model=None, driven=None
    )
    shown = ShownObject(Followed(points=np.zeros((1, 3))), [np.eye(4)])
    assert swinging.weigh_held(tools, shown, tmp_path) == 0.9
    assert asked == [1.0, swinging.TUNING.gentler][: len(ways)]
    assert read_swung(tmp_path / SWUNG).slip[0] == pytest.approx(kept)
    told: Any = shown.swung
    assert told.number == (1 if kept == ways[0] else 2), "the empty hand is swung as what is kept was"
    assert len(shown.notes) == notes and all("mm and 0°" in note for note in shown.notes[:1])
    assert shown.X_ST[-1][2, 3] == pytest.approx(sum(way or 0.0 for way in ways)), "where it is held now"


def test_what_is_swung_stays_before_the_arm_and_off_cameras_and_the_other_bin() -> None:
    """Over its head a hand came a metre behind the arm, where nobody told what stands and no camera sees."""
    told = load_scenario("bin_picking").twin
    mover, home = Mover(told, {}, np.full(7, 2.0)), np.array(told.home)
    tools: Any = SimpleNamespace(learning=told.learning, mover=mover, cameras=told.cameras)
    turned, down = home + [np.pi - 0.2, *6 * [0.0]], pointing(np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0]))
    ahead = pointing(np.array([0.0, -0.3, 1.0]), np.array([1.0, 0.0, 0.0]))
    at_camera = mover.goals(pose(ahead, np.array([0.42, -0.36, 0.9])), home)[:1]
    over_bin = mover.goals(pose(down, np.array([0.42, 0.36, 0.21])), home)[:1]
    assert len(at_camera) == len(over_bin) == 1
    rows = np.vstack([home, turned, at_camera, over_bin])
    free = (mover.room(rows, 0.02) >= 0.0).all(axis=1)
    with swinging.kept_clear(tools):
        kept = (mover.room(rows, 0.02) >= 0.0).all(axis=1)
    assert free.tolist() == [True, True, True, True] and kept.tolist() == [True, False, False, False]
    assert ((mover.room(rows, 0.02) >= 0.0).all(axis=1) == free).all()


def found_about(posture: Any, use: float, worst: float) -> Any:
    """A motion that takes a share of a joint's speed, and tells an object's worst moment to another one."""
    bound = SimpleNamespace(moments=np.array([0.01, worst, 0.02]))
    return SimpleNamespace(
        posture=posture, use={"velocity": use, "acceleration": 0.3, "torque": 0.4, "grip": 0.95}, bound=bound
    )


@pytest.mark.parametrize(
    ("motions", "kept"),
    [
        ([(0.8, 0.2), (0.8, 0.1)], 0),
        ([(0.35, 0.26), (0.7, 0.12), (0.8, 0.1)], 1),
        ([(0.35, 0.26), None, (0.3, 0.3)], 0),
        ([(0.35, 0.26), "slips", (0.4, 0.2)], 2),
    ],
    ids=["brisk at once", "about the second", "all feeble", "the best of the feeble"],
)
def test_a_feeble_motion_is_looked_for_about_another_posture(motions: list[Any], kept: int) -> None:
    """A cracker box of 100017 was swung at a third of its joints' speeds: the bound of its worst moment was 26 %."""
    here, tried = np.zeros(7), list[float]()
    mover: Any = SimpleNamespace(goals=lambda X_WT, near: np.stack([here + 0.3 * (1 + len(tried))]))

    def search(posture: Any) -> Any:
        told = motions[len(tried)]
        tried.append(float(posture[0]))
        if told is None:
            raise NotClear("no motion is clear")
        if told == "slips":
            raise WeighingError("no motion keeps the limit of grip")
        return found_about(posture, *told)

    assert first_with_room(mover, here, search).posture[0] == tried[kept]
    assert len(tried) == (1 if kept == 0 and motions[0][0] > 0.5 else 2 if kept == 1 else 3)


def test_what_has_no_room_about_one_posture_is_swung_about_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bin 100011's bottle and L were set down and shown a third time, as about the first posture nothing was clear."""
    here, there, tried = np.zeros(7), np.full(7, 0.5), list[float]()

    def goals(X_WT: Any, near: Any) -> Any:
        return np.stack([here + 0.05, there + 0.3 * len(tried)])

    mover: Any = SimpleNamespace(goals=goals, path=lambda q, ends: ends, timed=lambda path: path)
    cell: Any = SimpleNamespace(commanded=here, fingers={}, borne=Borne(), time=0.0)

    def motion(model: Any, mover: Any, posture: Any, *rest: Any) -> Any:
        tried.append(float(posture[0]))
        if len(tried) < clear_at:
            raise NotClear(f"no motion about posture {len(tried)}")
        return found_about(posture, 0.8, 0.1)

    monkeypatch.setattr(weighing, "best_motion", motion)
    monkeypatch.setattr(weighing, "go", lambda cell, way: None)

    def swing_(cell: Any, motion: Any, joints: Any, source: str, noted: list[tuple[float, float]], torque: Any) -> Log:
        noted += [(0.0, 0.06), (0.05, 0.06), (0.051, 0.0598), (0.1, 0.0598)]
        return swung().log

    monkeypatch.setattr(weighing, "swing", swing_)
    monkeypatch.setattr(weighing, "torques_of", lambda *told: None)
    monkeypatch.setattr(weighing, "holding", lambda model, mass, centre: lambda q: mass * np.ones(7) + centre[0])
    told: Any = (np.eye(4), np.array([np.zeros(3), np.full(3, 0.1)]), np.zeros(3), 10.0, 1.0)
    model: Any = SimpleNamespace(joints=("a",))
    clear_at = 2
    held, about = weighing.swing_held(model, mover, cell, *told)
    assert about.posture[0] == tried[1] == pytest.approx(0.8)
    assert cell.borne.torque(here, 1.0) == pytest.approx(np.ones(7)), "swung, it is borne"
    assert held.way is not None and (held.way[0], held.way[-1]) == (-1.0, 1.0), "by the fingers, where it slipped"
    tried.clear()
    clear_at = 9
    with pytest.raises(NotClear, match="posture 1"):  # what is told is of where it would be swung by right
        weighing.swing_held(model, mover, cell, *told)
    assert len(tried) == 3 and tried[0] == 0.0


def test_what_slipped_on_the_way_is_known_less_well_by_as_much(monkeypatch: pytest.MonkeyPatch) -> None:
    doubts = []

    def weigh(*arguments: Any, doubt: Any) -> Any:
        doubts.append(doubt)
        return SimpleNamespace(mass=1.0, measured=lambda: None)

    monkeypatch.setattr(weighing, "weigh", weigh)
    corners = np.array([[[0, 0, 0], [0, 1, 0], [1, 0, 0]], [[0, 0, 0], [1, 0, 0], [0, 0, 1]],
                        [[0, 0, 0], [0, 0, 1], [0, 1, 0]], [[1, 0, 0], [0, 1, 0], [0, 0, 1]]], dtype=float)  # fmt: skip
    model: Any = SimpleNamespace(arm=SimpleNamespace(link_side=True))
    surface: Any = SimpleNamespace(corners=0.1 * corners)
    for slip in ((0.0, 0.0), (0.02, 0.3)):
        weighing.inertia_of(model, replace(swung(), slip=slip), None, surface)
    still, slid = doubts
    step, turn = weighing.TUNING.slipping * 0.02, weighing.TUNING.slipping * 0.3
    assert slid.pose == pytest.approx((np.hypot(still.pose[0], step), np.hypot(still.pose[1], turn)))
    assert slid.creep == pytest.approx(tuple(np.hypot(still.creep, (0.02, 0.3))))


def test_what_is_heavy_is_swung_farther_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """With 1.42 kg in its hand the arm left its path by 23 mm, and its wrist met a bin's wall."""
    asked = list[float]()

    def room(q: Array, clearance: float) -> Array:
        asked.append(clearance)
        return np.full((len(q), 1), 0.01)

    def optimised(*told: Any, clear: Any, room: Any, **named: Any) -> None:
        assert clear(np.zeros((3, 7))).tolist() == [True] * 3 and room(np.zeros((3, 7))).shape == (3, 1)

    monkeypatch.setattr(weighing, "optimise_excitation", optimised)
    mover: Any = SimpleNamespace(room=room)
    cell: Any = SimpleNamespace(apart=0.06, force=80.0)
    points = np.random.default_rng(0).uniform(-0.03, 0.03, (200, 3))
    model = Model.load(scenario.ArmModel(model=str(MODEL), tool_frame="wsg_tcp"))
    for mass in (0.1, 1.5):
        weighing.best_motion(model, mover, POSTURE, np.eye(4), points, np.zeros(3), cell, 10.0, mass)
    assert asked == pytest.approx([0.022, 0.022, 0.05, 0.05])


def test_fingers_of_the_empty_hand_come_together_where_the_swing_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not where they let go: what was just set down may still stand between them."""
    done: list[str] = []
    cell: Any = SimpleNamespace(
        widest=0.11, commanded=np.zeros(7), fingers={}, grip=lambda opened: done.append(f"grip {opened:.1f}")
    )
    mover: Any = SimpleNamespace(path=lambda q, goals: goals, timed=lambda path: path)
    driven: Any = SimpleNamespace(joints=())
    motion: Any = SimpleNamespace(posture=np.ones(7))
    monkeypatch.setattr(weighing, "go", lambda cell, motion: done.append("go"))
    monkeypatch.setattr(weighing, "torques_of", lambda *told: np.zeros((1, 7)))
    monkeypatch.setattr(weighing, "swing", lambda *told, **further: done.append("swing"))
    weighing.swing_empty(driven, mover, cell, motion, 0.055)
    assert done == ["go", "grip 0.5", "swing", "grip 1.0"]
