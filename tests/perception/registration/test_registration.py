"""RegisteredPose, search, recognition and tracking on ray-cast images, where the truth is exact."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RotationMatrix

from tests.registration_kernels import linearise, unexplained
from tests.synthetic_scene import Thing, camera, picture, yawed
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.assets.procedural import write_box
from twin_diagram.perception.registration import global_search
from twin_diagram.perception.registration.assessment import assess
from twin_diagram.perception.registration.data_association import Poses, look
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.global_search import search
from twin_diagram.perception.registration.hues import alike, hues
from twin_diagram.perception.registration.model_cloud import ModelCloud, fibonacci_sphere, visible
from twin_diagram.perception.registration.point_kernels import COARSE, FINE
from twin_diagram.perception.registration.recognition import recognise
from twin_diagram.perception.registration.registration import RegisteredPose, register
from twin_diagram.perception.registration.residuals import brightness
from twin_diagram.perception.registration.resting import resting
from twin_diagram.perception.registration.rotation import cross, exp, from_quaternion, log, skew, to_quaternion
from twin_diagram.perception.registration.slots import SLOT_SIZE, Slot
from twin_diagram.perception.registration.tracking import step
from twin_diagram.perception.registration.view import Known
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.layouts import PoseMeasurement

Array = npt.NDArray[np.float64]
PARAMS = scenario.Registration()
SEEDS = {"sugar_box": 7, "gelatin_box": 11, "cracker_box": 3, "mover": 2, "can": 5}
VIEW = camera()
GRID = Grid.of(VIEW, 2)


@pytest.fixture(scope="module")
def library() -> dict[str, ModelCloud]:
    folder = models_dir() / "objects"
    return {name: ModelCloud.of(Asset.load(folder / name), PARAMS.model_points) for name in SEEDS}


def standing(model: ModelCloud, name: str, x: float, y: float, yaw: float) -> Thing:
    return Thing(model.asset, SEEDS[name], yawed(yaw), np.array([x, y, model.asset.size[2] / 2]))


def shot(
    things: list[Thing], seed: int | None = 0, time: float = 0.0, balls: list[tuple[Array, float]] | None = None
) -> Segments:
    rng = None if seed is None else np.random.default_rng(seed)
    rgb, depth, _ = picture(VIEW, things, rng, balls=balls)
    return segment(rgb, depth, time, GRID, scenario.Perception())


def errors(found: RegisteredPose | PoseMeasurement, thing: Thing) -> tuple[float, float]:
    """Position error [mm] and rotation error [deg], for a symmetric object that of its axis."""
    if isinstance(found, PoseMeasurement):
        R, p = from_quaternion(found.pose[:4]), found.pose[4:]
    else:
        R, p = found.R, found.p
    if thing.asset.symmetric_axis == "z":
        angle = np.arccos(np.clip(R[:, 2] @ thing.R[:, 2], -1.0, 1.0))
    else:
        angle = np.linalg.norm(log(R @ thing.R.T))
    return float(np.linalg.norm(p - thing.p) * 1e3), float(np.degrees(angle))


vectors = st.tuples(*[st.floats(-1.7, 1.7)] * 3).map(np.array)


@given(v=vectors, w=vectors)
def test_rotations_agree_with_drake(v: Array, w: Array) -> None:
    angle = float(np.linalg.norm(v))
    R = exp(v)
    if angle > 1e-6:
        from pydrake.common.eigen_geometry import AngleAxis

        assert np.allclose(R, AngleAxis(angle, v / angle).rotation(), atol=1e-12)
    if angle < 3.0:
        assert np.allclose(log(R), v, atol=1e-6)
    q = to_quaternion(R)
    assert np.allclose(from_quaternion(q), R, atol=1e-12) and q[0] >= 0
    drake = RotationMatrix(R).ToQuaternion().wxyz()
    assert min(np.abs(q - drake).max(), np.abs(q + drake).max()) < 1e-9
    assert np.allclose(RotationMatrix(Quaternion(q / np.linalg.norm(q))).matrix(), R, atol=1e-9)
    assert np.allclose(skew(v) @ w, np.cross(v, w)) and np.allclose(cross(v, w), np.cross(v, w))


def test_visible_points_of_a_box_are_three_faces(library: dict[str, ModelCloud]) -> None:
    model = library["sugar_box"]
    for direction in fibonacci_sphere(20):
        seen = visible(model.points, model.normals, direction, 2 * model.spacing)
        facing = model.normals @ direction > 0.1
        # A convex object hides nothing of itself.
        assert (seen == facing).mean() > 0.99


def test_far_side_of_a_mug_is_seen_into_and_its_near_inside_not() -> None:
    mug = ModelCloud.of(Asset.load(models_dir() / "objects" / "mug"), 400)
    inner = np.hypot(mug.points[:, 0], mug.points[:, 1]) < 0.0385
    # From above, at 45°: the upper far inside shows, the lower far inside is hidden by the near wall.
    direction = np.array([0.0, -np.sqrt(0.5), np.sqrt(0.5)])
    seen = visible(mug.points, mug.normals, direction, 2 * mug.spacing)
    far = inner & (mug.points[:, 1] > 0.03)
    assert seen[far & (mug.points[:, 2] > 0.01)].mean() > 0.8
    assert seen[far & (mug.points[:, 2] < -0.035) & (mug.points[:, 2] > -0.045)].mean() < 0.3


def test_normal_equations_are_the_gradient_of_the_distances(library: dict[str, ModelCloud]) -> None:
    """Geometry alone, on a smooth surface: a small step changes each distance as the Jacobian says."""
    model, name = library["sugar_box"], "sugar_box"
    thing = standing(model, name, 0.5, 0.0, 0.5)
    frame = Frame.of(shot([thing], None))
    pose = Poses(thing.R[None], thing.p[None])
    before = look(model, frame, pose, 300, FINE)
    on = before.seen & (np.abs(before.distance) < 1e-3)
    rng = np.random.default_rng(0)
    for _ in range(5):
        move = rng.standard_normal((1, 6)) * 1e-4
        after = look(model, frame, pose.moved(move), 300, FINE)
        both = on & after.seen & (np.abs(after.distance) < 3e-3)
        expected = before.distance - (
            np.einsum("bpi,bi->bp", cross(before.r, before.n), move[:, :3])
            + np.einsum("bpi,bi->bp", before.n, move[:, 3:])
        )
        assert np.abs(after.distance - expected)[both].max() < 2e-5
        assert both.sum() > 200


def test_colour_alone_finds_the_way_along_a_face(library: dict[str, ModelCloud]) -> None:
    model, name = library["cracker_box"], "cracker_box"
    thing = standing(model, name, 0.5, 0.0, 0.0)
    frame = Frame.of(shot([thing], None))
    # One face fills the view: shape says nothing about sliding along it.
    for slide in (np.array([0.0, 0.003, 0.0]), np.array([0.0, 0.0, -0.003])):
        start = Poses(thing.R[None], (thing.p + slide)[None])
        looked = look(model, frame, start, 600, FINE)
        both, _ = linearise(looked, frame, FINE, 0.007, 0.3)
        back = np.linalg.solve(both.H[0] + 1e-3 * np.eye(6), both.b[0])[3:]
        assert back @ -slide > 0.6 * slide @ slide


@settings(max_examples=25)
@given(gain=st.floats(0.2, 1.5), tilt=vectors)
def test_brightness_is_fitted(gain: float, tilt: Array) -> None:
    rng = np.random.default_rng(0)
    n = rng.standard_normal((1, 80, 3))
    n /= np.linalg.norm(n, axis=2, keepdims=True)
    colour = rng.random((1, 80, 3))
    light = np.clip(gain + 0.1 * n @ tilt, 0.15, 1.9)
    found = brightness(light[..., None] * colour, colour, n, np.ones((1, 80)))
    assert np.abs(found - light).max() < 0.06


@pytest.mark.parametrize("name", ["sugar_box", "cracker_box", "can", "gelatin_box"])
@pytest.mark.parametrize("noise", [None, 4])
def test_recovers_the_pose(library: dict[str, ModelCloud], name: str, noise: int | None) -> None:
    model = library[name]
    rng = np.random.default_rng(1)
    found = []
    for k in range(4):
        thing = standing(model, name, rng.uniform(0.35, 0.7), rng.uniform(-0.35, 0.35), rng.uniform(-np.pi, np.pi))
        segments = shot([thing], None if noise is None else noise + k)
        R = exp(np.radians(4.0) * rng.standard_normal(3) / np.sqrt(3)) @ thing.R
        p = thing.p + 0.006 * rng.standard_normal(3) / np.sqrt(3)
        result = register(model, Frame.of(segments), R, p, PARAMS, points_W=segments.points_W[::4])
        assert result.quality > 0.8 and result.visible_share > 0.9
        found.append(errors(result, thing))
    millimetres, degrees = np.median(found, axis=0)
    assert millimetres < 0.5 and degrees < 0.5
    assert np.max(found) < 2.0


def test_covariance_covers_the_errors(library: dict[str, ModelCloud]) -> None:
    model, name = library["gelatin_box"], "gelatin_box"
    values = []
    for k in range(12):
        thing = standing(model, name, 0.4 + 0.02 * k, -0.3 + 0.05 * k, 0.5 * k)
        result = register(model, Frame.of(shot([thing], k)), thing.R, thing.p, PARAMS)
        assert np.allclose(result.covariance, result.covariance.T)
        assert np.linalg.eigvalsh(result.covariance).min() > 0
        error = np.concatenate([log(result.R @ thing.R.T), result.p - thing.p])
        values.append(error @ np.linalg.solve(result.covariance, error))
    # Six degrees of freedom: not overconfident, and not without meaning.
    assert 0.05 < np.mean(values) < 8.0


def test_claimed_covariance_is_the_true_scatter(library: dict[str, ModelCloud]) -> None:
    """Of registrations of noisy images by a camera that is where it is told."""
    model, name = library["gelatin_box"], "gelatin_box"
    turned, shifted = [], []
    for k in range(16):
        thing = standing(model, name, 0.4 + 0.02 * k, -0.3 + 0.035 * k, 0.5 * k)
        result = register(model, Frame.of(shot([thing], k)), thing.R, thing.p, PARAMS)
        error = np.concatenate([log(result.R @ thing.R.T), result.p - thing.p])
        for part, values in ((slice(0, 3), turned), (slice(3, 6), shifted)):
            values.append(error[part] @ np.linalg.solve(result.covariance[part, part], error[part]))
    # Three degrees of freedom each: no more than half as much again, and not much too little.
    assert 1.0 < np.mean(turned) < 4.5
    assert 1.0 < np.mean(shifted) < 4.5


def test_weak_direction_keeps_the_prediction_and_says_so(tmp_path: Path) -> None:
    """A grey can's turn about its axis cannot be seen."""
    asset = Asset.load(models_dir() / "objects" / "can")
    grey = replace(asset, colours=np.full_like(asset.colours, 0.5))
    model = ModelCloud.of(grey, PARAMS.model_points)
    thing = Thing(asset, 5, np.eye(3), np.array([0.5, 0.0, asset.size[2] / 2]))
    segments = shot([thing], 3)
    yaw = 0.8
    shapes = replace(PARAMS, colour_weight=0.0)
    # The texture is left out: only geometry counts here.
    result = register(model, Frame.of(segments), yawed(yaw), thing.p + [0.003, -0.002, 0.002], shapes)
    assert np.linalg.norm(result.p - thing.p) < 2e-3
    assert abs(np.arctan2(result.R[1, 0], result.R[0, 0]) - yaw) < 0.1
    assert np.sqrt(result.covariance[2, 2]) > 0.3
    assert np.sqrt(np.diag(result.covariance)[3:]).max() < 3e-3


@pytest.mark.long
def test_unexplained_points_pull_a_grey_face_sideways(library: dict[str, ModelCloud]) -> None:
    """Only the opposite direction knows that a face without texture lies too far to one side."""
    model, name = library["sugar_box"], "sugar_box"
    thing = standing(model, name, 0.5, 0.0, 0.0)
    segments = shot([thing], 2)
    slide = np.array([0.0, 0.012, 0.0])
    pull = unexplained(model, segments.points_W, Poses(thing.R[None], (thing.p + slide)[None]), VIEW.p_WC, 0.02, 0.1)
    assert pull.b[0, 4] < 0
    rest = unexplained(model, segments.points_W, Poses(thing.R[None], thing.p[None]), VIEW.p_WC, 0.02, 0.1)
    assert abs(rest.b[0, 4]) < 0.3 * abs(pull.b[0, 4])


def test_wrong_pose_and_wrong_object_do_not_fit(library: dict[str, ModelCloud], tmp_path: Path) -> None:
    model, name = library["sugar_box"], "sugar_box"
    thing = standing(model, name, 0.5, 0.1, 0.3)
    segments = shot([thing], 2)
    frame = Frame.of(segments)
    assert register(model, frame, thing.R, thing.p, PARAMS).quality > 0.9
    # The other side, and upside down: the same shape.
    for turn in (np.array([0, 0, np.pi]), np.array([np.pi, 0, 0])):
        assert register(model, frame, thing.R @ exp(turn), thing.p, PARAMS).quality < PARAMS.minimum_quality
    # The same box with another picture on it.
    size = tuple(float(x) for x in thing.asset.size)
    twin = Asset.load(write_box(tmp_path / "twin", "twin", size, texture_seed=99))  # type: ignore[arg-type]
    other = ModelCloud.of(twin, PARAMS.model_points)
    assert register(other, frame, thing.R, thing.p, PARAMS).quality < PARAMS.minimum_quality


def test_half_hidden_is_still_exact_and_hidden_is_said(library: dict[str, ModelCloud]) -> None:
    model, name = library["cracker_box"], "cracker_box"
    thing = standing(model, name, 0.45, 0.0, 0.2)
    towards = VIEW.p_WC - thing.p
    towards /= np.linalg.norm(towards)
    side = np.array([0.0, 1.0, 0.0])
    half = [(thing.p + 0.15 * towards + 0.07 * side, 0.06)]
    segments = shot([thing], 2, balls=half)
    result = register(model, Frame.of(segments), thing.R, thing.p + [0.003, 0.003, 0.0], PARAMS)
    assert 0.3 < result.visible_share < 0.9
    assert result.quality > 0.8 and errors(result, thing)[0] < 2.0 and errors(result, thing)[1] < 1.5
    all_of_it = [(thing.p + 0.3 * towards, 0.14)]
    segments = shot([thing], 2, balls=all_of_it)
    fit = assess(model, Frame.of(segments), Poses(thing.R[None], thing.p[None]), 600)
    assert fit.visible_share[0] < 0.1 and fit.points[0] < 30


def test_many_poses_at_once_are_as_good_as_one_by_one(library: dict[str, ModelCloud]) -> None:
    model, name = library["gelatin_box"], "gelatin_box"
    thing = standing(model, name, 0.5, 0.1, 0.3)
    frame = Frame.of(shot([thing], 2))
    rng = np.random.default_rng(0)
    R = exp(0.1 * rng.standard_normal((5, 3))) @ thing.R
    p = thing.p + 0.01 * rng.standard_normal((5, 3))
    together, _ = linearise(look(model, frame, Poses(R, p), 120, COARSE), frame, COARSE, 0.02, 0.3)
    for k in range(5):
        alone, _ = linearise(look(model, frame, Poses(R[[k]], p[[k]]), 120, COARSE), frame, COARSE, 0.02, 0.3)
        assert np.allclose(alone.H[0], together.H[k]) and np.allclose(alone.b[0], together.b[k])


def test_resting_orientations(library: dict[str, ModelCloud]) -> None:
    box = resting(library["sugar_box"].asset)
    assert len(box) == 6 and np.allclose(box[0][0], np.eye(3))
    assert np.allclose(sorted({round(h, 6) for _, h in box}), np.sort(library["sugar_box"].asset.size / 2))
    can = resting(library["can"].asset)
    assert len(can) == 3 and np.allclose(can[0][0], np.eye(3))
    for R, height in box + can:
        assert np.allclose(R @ R.T, np.eye(3)) and np.linalg.det(R) == pytest.approx(1.0) and height > 0


def test_facets_of_one_face_count_once(library: dict[str, ModelCloud]) -> None:
    """A scanned box rested in 57 ways, most of them one another's like to a tenth of a degree."""
    asset = library["sugar_box"].asset
    corners = np.concatenate(asset.convex_pieces)
    bumps = corners + np.random.default_rng(0).uniform(-2e-4, 2e-4, (40, *corners.shape))  # a scanner's roughness
    ways = resting(replace(asset, convex_pieces=(bumps.reshape(-1, 3),)))
    assert len(ways) == 6 and np.allclose(ways[0][0], np.eye(3), atol=0.03)


def test_a_vain_search_ends_before_it_is_refined(
    library: dict[str, ModelCloud], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A sugar box where a can stands: no start fits, and none is registered exactly."""
    segments = shot([standing(library["can"], "can", 0.5, 0.0, 0.4)])
    asked: list[Array] = []

    def exactly(model: ModelCloud, frame: Frame, R: Array, p: Array, *rest: Any, **named: Any) -> RegisteredPose:
        asked.append(p)
        return register(model, frame, R, p, *rest, **named)

    monkeypatch.setattr(global_search, "register", exactly)
    model, frame = library["sugar_box"], Frame.of(segments)
    assert search(model, frame, segments.points_W, resting(model.asset), PARAMS) is None
    assert not asked
    can = library["can"], frame, segments.points_W, resting(library["can"].asset), PARAMS
    assert search(*can, least=1.01) is None and not asked
    assert search(*can) is not None
    assert asked


@pytest.mark.parametrize("yaw", np.linspace(-3.0, 3.1, 6))
@pytest.mark.parametrize("name", ["sugar_box", "gelatin_box"])
def test_search_finds_any_yaw(library: dict[str, ModelCloud], name: str, yaw: float) -> None:
    model = library[name]
    thing = standing(model, name, 0.55, -0.1, yaw)
    segments = shot([thing], 8)
    found = search(model, Frame.of(segments), segments.points_W, resting(model.asset)[:1], PARAMS)
    assert found is not None and found.score > 0.8
    assert errors(found.registration, thing)[0] < 1.0 and errors(found.registration, thing)[1] < 1.0


def test_search_finds_what_lies_on_its_side(library: dict[str, ModelCloud]) -> None:
    model, name = library["sugar_box"], "sugar_box"
    R = yawed(0.7) @ exp(np.array([np.pi / 2, 0.0, 0.0]))
    thing = Thing(model.asset, SEEDS[name], R, np.array([0.5, 0.1, model.asset.size[1] / 2]))
    segments = shot([thing], 8)
    found = search(model, Frame.of(segments), segments.points_W, resting(model.asset)[1:], PARAMS)
    assert found is not None and errors(found.registration, thing)[0] < 1.0


def test_recognises_which_is_which(library: dict[str, ModelCloud]) -> None:
    places = {"sugar_box": (0.45, -0.2, 0.5), "gelatin_box": (0.6, 0.0, 2.0), "can": (0.5, 0.2, 0.0)}
    things = {name: standing(library[name], name, *place) for name, place in places.items()}
    segments = shot(list(things.values()), 4)
    assert segments.count == 3
    # The mover is wanted too, but is not there.
    wanted = dict(enumerate([library[name] for name in (*places, "mover")]))
    orientations = {k: resting(model.asset)[:1] for k, model in wanted.items()}
    free = np.ones(len(segments.labels), dtype=bool)
    found = recognise(wanted, orientations, segments, Frame.of(segments), free, PARAMS, 60)
    assert sorted(found) == [0, 1, 2]
    for k, name in enumerate(places):
        assert errors(found[k].registration, things[name])[0] < 1.0
    assert free.all()


def test_hues_do_not_see_the_light() -> None:
    rng = np.random.default_rng(0)
    colours = rng.random((500, 3)) * 0.9 + 0.1
    assert alike(hues(colours), hues(0.5 * colours)) > 0.95
    assert hues(np.zeros((5, 3))).sum() == 0.0


def test_slot_survives_packing() -> None:
    slot = Slot(True, exp(np.array([0.3, -0.2, 1.0])), np.array([0.4, 0.1, 0.05]), np.arange(6.0), 1.25, 1.5, 3)
    vector = slot.pack()
    again = Slot.unpack(vector)
    assert vector.shape == (SLOT_SIZE,)
    assert np.allclose(again.R, slot.R, atol=1e-15) and again.attempts == 3 and again.seen == 1.25 and again.known
    assert np.array_equal(again.velocity, slot.velocity)


def follow(library: dict[str, ModelCloud], frames: list[Segments]) -> list[list[PoseMeasurement]]:
    """Runs the tracker over images; what came out for each."""
    known = [Known.of(model) for model in library.values()]
    slots = [Slot() for _ in known]
    out = []
    for segments in frames:
        slots, found, _ = step(known, slots, segments, PARAMS, 60)
        out.append(found)
    return out


def test_follows_what_moves_and_turns(library: dict[str, ModelCloud]) -> None:
    chosen = {name: library[name] for name in ("mover", "can")}
    things = []
    for k in range(10):
        mover = standing(library["mover"], "mover", 0.6, -0.15 + 0.02 * k, 0.2 + 0.05 * k)
        things.append([mover, standing(library["can"], "can", 0.45, 0.2, 0.0)])
    out = follow(chosen, [shot(pair, k, k / 15) for k, pair in enumerate(things)])
    for pair, found in zip(things, out, strict=True):
        for thing, one in zip(pair, found, strict=True):
            assert one.quality > 0.7
            assert errors(one, thing)[0] < 2.0 and errors(one, thing)[1] < 1.5
    assert [found[0].time for found in out] == [k / 15 for k in range(10)]


def test_covered_lens_jump_and_absence(library: dict[str, ModelCloud]) -> None:
    chosen = {name: library[name] for name in ("sugar_box", "mover")}
    first = standing(library["sugar_box"], "sugar_box", 0.45, -0.2, 0.5)
    later = standing(library["sugar_box"], "sugar_box", 0.6, 0.2, -1.0)
    dark = segment(
        np.zeros((480, 640, 3), np.uint8), np.zeros((480, 640), np.float32), 0.0, GRID, scenario.Perception()
    )
    frames = [shot([first], k, k / 15) for k in range(3)]
    frames += [replace(dark, time=k / 15) for k in range(3, 6)]
    frames += [shot([later], k, k / 15) for k in range(6, 12)]
    out = follow(chosen, frames)
    quality = [found[0].quality for found in out]
    assert min(quality[:3]) > 0.8
    # In the dark: nothing seen, and the last pose kept.
    assert quality[3:6] == [0.0] * 3
    assert np.array_equal(out[5][0].pose, out[2][0].pose)
    # It comes back elsewhere within a search period or two; no pose on the way is wild.
    assert min(quality[10:]) > 0.8
    for k, found in enumerate(out):
        if found[0].quality > 0:
            assert errors(found[0], first if k < 3 else later)[0] < 2.0
    # What is not there is never seen.
    assert all(found[1].quality == 0.0 for found in out)


def test_neighbours_3_cm_apart(library: dict[str, ModelCloud]) -> None:
    sugar, gelatin = library["sugar_box"], library["gelatin_box"]
    gap = 0.03 + (sugar.asset.size[0] + gelatin.asset.size[0]) / 2
    things = [standing(sugar, "sugar_box", 0.5, 0.0, np.pi / 2), standing(gelatin, "gelatin_box", 0.5, gap, np.pi / 2)]
    chosen = {"sugar_box": sugar, "gelatin_box": gelatin}
    out = follow(chosen, [shot(things, k, k / 15) for k in range(3)])
    for thing, one in zip(things, out[-1], strict=True):
        assert one.quality > 0.8 and errors(one, thing)[0] < 1.0 and errors(one, thing)[1] < 1.0


def test_same_images_same_bits(library: dict[str, ModelCloud]) -> None:
    chosen = {name: library[name] for name in ("sugar_box", "can")}
    things = [standing(chosen["sugar_box"], "sugar_box", 0.5, 0.0, 0.3), standing(chosen["can"], "can", 0.6, 0.2, 0.0)]
    frames = [shot(things, k, k / 15) for k in range(3)]
    one, two = follow(chosen, frames), follow(chosen, frames)
    for a, b in zip(one, two, strict=True):
        assert np.array_equal(np.concatenate([m.pack() for m in a]), np.concatenate([m.pack() for m in b]))


def test_empty_library_and_empty_image(library: dict[str, ModelCloud]) -> None:
    assert follow({}, [shot([], 0)]) == [[]]
    (found,) = follow({"can": library["can"]}, [shot([], 0)])
    assert found[0].quality == 0.0
