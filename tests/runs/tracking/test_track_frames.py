"""`twin-diagram track`: poses come out as they were, in whatever world, and what is wrong with the input is said."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
import trimesh
from scipy.spatial import Delaunay

from tests.assets.building.pictured import Shots, cameras, shots, write
from twin_diagram.assets import shapes
from twin_diagram.assets.building.from_mesh import build_from_mesh
from twin_diagram.assets.mesh import write_obj
from twin_diagram.cli import main
from twin_diagram.logs.frames import FrameFolder, RgbdFrame, ViewCamera
from twin_diagram.perception.depth_noise import DepthSigma
from twin_diagram.runs.tracking import track_frames
from twin_diagram.signals import rotations
from twin_diagram.signals.calibration_error import CalibrationError

Array = npt.NDArray[np.float64]
SIZE = (0.11, 0.05, 0.08)
"""Of the known box, red as the first body of the pictures."""
STEP = 0.01
"""How far it is pushed from frame to frame [m]."""
YAW = 0.4


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("library")
    made = shapes.box(SIZE)
    write_obj(made.mesh, folder / "source.obj", np.full((64, 64, 3), (200, 40, 40), dtype=np.uint8))
    build_from_mesh(folder / "source.obj", "brick", folder / "assets", 0.4, None, "m", False)
    return folder / "assets"


def body(size: tuple[float, float, float], x: float, y: float, yaw: float) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(size)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(yaw, [0, 0, 1]))
    mesh.apply_translation([x, y, size[2] / 2])
    return mesh


def larger(camera: ViewCamera) -> ViewCamera:
    return replace(camera, width=400, height=320, fx=520.0, fy=520.0, cx=199.5, cy=159.5)


@pytest.fixture(scope="module")
def taken() -> Shots:
    """Six frames of a camera that stands; the brick is pushed, an unknown box stands by."""
    view = larger(cameras(3, 0.03, 35.0, 50.0, 0.7)[1])
    frames = []
    for k in range(6):
        (one,) = shots(
            [body(SIZE, STEP * k - 0.04, 0.02, YAW), body((0.05, 0.06, 0.07), 0.02, -0.13, 0.2)], [view]
        ).frames
        frames.append(replace(one, number=k, time=k / 15.0))
    return Shots(frames)


def folder_of(taken: Shots, folder: Path) -> Path:
    write(taken, folder)
    (folder / "times.json").write_text(json.dumps([frame.time for frame in taken.frames]))
    return folder


@pytest.fixture(scope="module")
def scene(taken: Shots, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As BOP's are: with masks of several things, black where one is hidden, which tracking does not ask for."""
    folder = folder_of(taken, tmp_path_factory.mktemp("scene") / "frames")
    masks = folder / "mask_visib"
    masks.mkdir()
    for number in range(len(taken.frames)):
        for thing in range(2):
            cv2.imwrite(str(masks / f"{number:06}_{thing:06}.png"), np.zeros((320, 400), np.uint8))
    return folder


def track(library: Path, frames: Path, out: Path, *more: str) -> int:
    return main(["track", "--library", str(library), "--frames", str(frames), "--out", str(out), *more])


def lines(out: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (out / "objects.jsonl").read_text().splitlines()]


@pytest.fixture(scope="module")
def tracked(library: Path, scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out") / "run"
    assert track(library, scene, out) == 0
    return out


def of(line: dict[str, Any], asset: str | None) -> dict[str, Any]:
    (one,) = [entry for entry in line["objects"] if entry["asset"] == asset]
    return one


def angle(q: list[float], yaw: float) -> float:
    """Between an attitude and a yaw, up to the half turns that a plain box of three unlike edges has."""
    R = rotations.matrix(np.array(q)[None])[0]
    c, s = np.cos(yaw), np.sin(yaw)
    true = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    turns = [np.diag(d) for d in ([1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1])]
    return min(float(np.arccos(np.clip((np.trace(R.T @ true @ t) - 1) / 2, -1, 1))) for t in turns)


def test_a_pushed_box_is_followed_in_w(tracked: Path) -> None:
    found = lines(tracked)
    assert [line["frame"] for line in found] == list(range(6))
    np.testing.assert_allclose([line["time"] for line in found], np.arange(6) / 15.0)
    assert len({of(line, "brick")["track"] for line in found}) == 1
    for k, line in enumerate(found):
        one = of(line, "brick")
        true = np.array([STEP * k - 0.04, 0.02, SIZE[2] / 2])
        assert np.linalg.norm(np.array(one["p_WO"]) - true) < (0.002 if k == 0 else 0.004), k
        assert angle(one["q_WO"], YAW) < np.radians(2.0)
        covariance = np.array(one["covariance"])
        assert covariance.shape == (6, 6) and np.linalg.eigvalsh(covariance)[0] > 0
        assert 0.5 < one["probability"] <= 1.0 and 0.5 < one["visible"] <= 1.0
        assert one["status"] in ("tracked", "moving") and one["pieces"] == [] and one["free"] == []
        assert one["hypotheses"][0]["p_WO"] == one["p_WO"]


def test_what_moves_is_known_along_its_way_no_better_than_depth_may_be_late(tracked: Path) -> None:
    """Depth that was half a frame late put what was carried 5 to 13 mm off, and millimetres were told."""
    told = [np.sqrt(np.diag(np.array(of(line, "brick")["covariance"]))[3:]) for line in lines(tracked)]
    assert told[0][0] < 0.3 * STEP
    assert 0.4 * STEP < told[-1][0] < STEP
    assert max(told[-1][1:]) < 0.4 * STEP


def test_what_is_found_again_elsewhere_is_not_stale_in_the_frame_that_shows_it(library: Path, tmp_path: Path) -> None:
    """The filter takes the first pose there for an outlier, but the frame shows it."""
    view = larger(cameras(3, 0.03, 35.0, 50.0, 0.7)[1])
    frames = []
    for k, (x, time) in enumerate([(-0.06, 0.0), (-0.06, 0.1), (None, 0.5), (None, 0.9), (0.08, 1.0), (0.08, 1.1)]):
        (one,) = shots([body(SIZE, x or 0.0, 0.02 if x else -1.0, YAW)], [view]).frames
        frames.append(replace(one, number=k, time=time))
    assert track(library, folder_of(Shots(frames), tmp_path / "frames"), tmp_path / "out") == 0
    with (tmp_path / "out" / "poses.csv").open() as file:
        shown = [int(row["im_id"]) for row in csv.DictReader(file)]
    assert shown == [0, 1, 4, 5]
    told = [of(line, "brick") for line in lines(tmp_path / "out")]
    assert "stale" not in {told[k]["status"] for k in shown}
    assert np.linalg.norm(np.array(told[4]["p_WO"]) - [0.08, 0.02, SIZE[2] / 2]) < 0.003


def test_the_axis_of_a_round_thing_is_free_whichever_it_is(tmp_path: Path) -> None:
    turn = trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0])
    rod = trimesh.creation.cylinder(0.03, 0.14, sections=64)
    rod.apply_transform(turn)
    rod.export(tmp_path / "rod.stl")
    build_from_mesh(tmp_path / "rod.stl", "rod", tmp_path / "library", 0.4, None, "m", False)
    lying = rod.copy()
    lying.apply_translation([0.0, 0.0, 0.03])
    taken = shots([lying, body((0.05, 0.06, 0.07), 0.02, -0.13, 0.2)], [larger(cameras(3, 0.03, 35.0, 50.0, 0.7)[1])])
    assert track(tmp_path / "library", folder_of(taken, tmp_path / "scene"), tmp_path / "out") == 0
    assert of(lines(tmp_path / "out")[0], "rod")["free"] == [[1.0, 0.0, 0.0]]


@pytest.mark.long
def test_a_mesh_without_colours_is_found_by_its_shape(scene: Path, tmp_path: Path) -> None:
    """An STL tells no colours, and those that pictures show of it veto nothing; another box stays unknown."""
    for name, size in (("brick", SIZE), ("other", (0.1, 0.1, 0.03))):
        trimesh.creation.box(np.array(size) * 1000.0).export(tmp_path / f"{name}.stl")
        build_from_mesh(tmp_path / f"{name}.stl", name, tmp_path / "bare", 0.4, None, "mm", False)
    assert track(tmp_path / "bare", scene, tmp_path / "out") == 0
    for k, line in enumerate(lines(tmp_path / "out")):
        one = of(line, "brick")
        true = np.array([STEP * k - 0.04, 0.02, SIZE[2] / 2])
        assert np.linalg.norm(np.array(one["p_WO"]) - true) < 0.004 and angle(one["q_WO"], YAW) < np.radians(2.0), k
        assert {entry["asset"] for entry in line["objects"]} == {"brick", None}


def test_results_are_bops_in_the_cameras_frame(tracked: Path, taken: Shots) -> None:
    head, *rows = (tracked / "poses.csv").read_text().splitlines()
    assert head == "scene_id,im_id,obj_id,score,R,t,time" and len(rows) == 6
    camera = taken.frames[0].camera
    for row, line in zip(rows, lines(tracked), strict=True):
        scene_id, im_id, obj_id, score, R, t, time = row.split(",")
        one = of(line, "brick")
        assert (scene_id, int(im_id), obj_id) == ("0", line["frame"], "1")
        assert float(score) == pytest.approx(one["probability"], abs=1e-5)
        p_C = camera.R_WC.T @ (np.array(one["p_WO"]) - camera.p_WC) * 1000
        np.testing.assert_allclose(np.array(t.split(), dtype=float), p_C, atol=1e-4)
        R_WO = rotations.matrix(np.array(one["q_WO"])[None])[0]
        np.testing.assert_allclose(np.array(R.split(), dtype=float).reshape(3, 3), camera.R_WC.T @ R_WO, atol=1e-6)
        assert float(time) == pytest.approx(line["time"])


def test_an_unknown_thing_keeps_its_number_and_its_pieces_hold_it(tracked: Path) -> None:
    found = [of(line, None) for line in lines(tracked)]
    assert len({one["track"] for one in found}) == 1 and found[0]["track"] != of(lines(tracked)[0], "brick")["track"]
    box = np.random.default_rng(3).uniform(-0.5, 0.5, (500, 3)) * [0.05, 0.06, 0.07] + [0.0, 0.0, 0.035]
    turn = np.array([[np.cos(0.2), -np.sin(0.2), 0.0], [np.sin(0.2), np.cos(0.2), 0.0], [0.0, 0.0, 1.0]])
    inside = box @ turn.T + [0.02, -0.13, 0.0]
    for one in found:
        hulls = [Delaunay(np.array(piece)) for piece in one["pieces"]]
        assert 1 <= len(hulls) <= 8
        assert np.mean(np.any([hull.find_simplex(inside) >= 0 for hull in hulls], axis=0)) > 0.9
        assert np.linalg.norm(np.array(one["p_WO"])[:2] - [0.02, -0.13]) < 0.04


def test_the_same_bits_again_and_in_the_cameras_own_world(
    library: Path, scene: Path, tracked: Path, tmp_path: Path, taken: Shots
) -> None:
    assert track(library, scene, tmp_path / "again") == 0
    for name in ("poses.csv", "objects.jsonl"):
        assert (tmp_path / "again" / name).read_bytes() == (tracked / name).read_bytes()
    bare = shutil.copytree(scene, tmp_path / "bare")
    cameras_file = bare / "scene_camera.json"
    entries = json.loads(cameras_file.read_text())
    for entry in entries.values():
        del entry["cam_R_w2c"], entry["cam_t_w2c"]
    cameras_file.write_text(json.dumps(entries))
    assert track(library, bare, tmp_path / "own") == 0
    camera = taken.frames[0].camera
    for here, there in zip(lines(tmp_path / "own"), lines(tracked), strict=True):
        p_W = camera.R_WC @ np.array(of(here, "brick")["p_WO"]) + camera.p_WC
        np.testing.assert_allclose(p_W, of(there, "brick")["p_WO"], atol=2e-3)


def test_a_pose_that_is_told_is_where_it_begins(library: Path, scene: Path, tracked: Path, tmp_path: Path) -> None:
    assert track(library, scene, tmp_path / "told", "--init", str(tracked / "poses.csv")) == 0
    for here, there in zip(lines(tmp_path / "told"), lines(tracked), strict=True):
        np.testing.assert_allclose(of(here, "brick")["p_WO"], of(there, "brick")["p_WO"], atol=2e-3)


def test_frames_are_read_in_turn(library: Path, scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a frame says does not depend on those after it."""
    seen: list[int] = []
    read = FrameFolder.read
    monkeypatch.setattr(FrameFolder, "read", lambda self, k: seen.append(k) or read(self, k))
    assert track(library, scene, tmp_path / "out") == 0
    assert seen == list(range(6))


def test_what_is_wrong_is_one_line_and_nothing_is_written(
    library: Path, scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    poses = tmp_path / "poses.csv"
    (tmp_path / "empty").mkdir()
    head = "scene_id,im_id,obj_id,score,R,t,time\n"
    bad = "0,0,1,1,1 0 0 0 1 0 0 0 2,0 0 500,0\n"
    good = bad.replace("0 0 2,", "0 0 1,")
    for arguments, text, said in (
        ((tmp_path / "none", scene), "", "none"),
        ((tmp_path / "empty", scene), "", "no whole asset"),
        ((next(p.parent for p in library.glob("*/asset.yaml")), scene), "", "name the folder that holds it"),
        ((library, tmp_path / "nowhere"), "", "no such folder of frames"),
        ((library, scene), head + bad, "R is no rotation"),
        ((library, scene), head + bad.replace("0 0 2", "0 0 1").replace("0,0,1,", "0,0,7,"), "obj_id 7"),
        ((library, scene), "a,b\n1,2\n", "no BOP result"),
        ((library, scene), "", "no pose of the first frame"),
        ((library, scene), head, "no pose of the first frame"),
        ((library, scene), head + good.replace("0,0,1", "0,5,1", 1), "no pose of the first frame, im_id 0"),
        ((library, scene), head + good.replace("0,0,1,1,", "0,0,1,nan,", 1), "score one"),
        ((library, scene), head + good.replace("0 0 500", "0 0 -500"), "not before the camera"),
        ((library, scene), head + good.replace("0 0 500", "1e300 0 500"), "not before the camera"),
        ((library, scene), head + good.replace("0 0 500", "0 0 0.5"), "is it in another unit"),
    ):
        poses.write_text(text)
        more = ("--init", str(poses)) if text or "first frame" in said else ()
        out = tmp_path / "out"
        assert track(*arguments, out, *more) == 2
        error = capsys.readouterr().err.strip().splitlines()
        assert len(error) == 1 and said in error[0], error
        assert not out.exists()


def test_what_was_tracked_before_a_stop_is_kept_whole(
    library: Path,
    scene: Path,
    tracked: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Ctrl-C in the fourth frame: half an hour of frames was lost."""
    read = FrameFolder.read

    def stopped(folder: FrameFolder, index: int) -> RgbdFrame:
        if index == 3:
            raise KeyboardInterrupt
        return read(folder, index)

    monkeypatch.setattr(FrameFolder, "read", stopped)
    assert track(library, scene, tmp_path / "out") == 130
    assert "the first 3 of 6 frames" in capsys.readouterr().err
    for name in ("poses.csv", "objects.jsonl"):
        some, every = ((folder / name).read_text() for folder in (tmp_path / "out", tracked))
        assert every.startswith(some) and 0 < len(some.splitlines()) < len(every.splitlines())
    monkeypatch.setattr(FrameFolder, "read", lambda folder, _: stopped(folder, 3))
    assert track(library, scene, tmp_path / "none") == 130 and not (tmp_path / "none").exists()


def test_a_network_takes_the_frames_apart(
    library: Path, scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What it does not show is not found; a file that is none is refused before anything is read."""

    class Red:
        def __init__(self, file: Path) -> None:
            self.turned = file.stem == "blue"

        def __call__(self, rgb: Any, depth: Any, *_: Any) -> tuple[Any, float]:
            return (rgb[..., 0] > 120).astype(int) * (rgb[..., 1] < 90) * (not self.turned), 1.0

    assert track(library, scene, tmp_path / "out", "--segmenter", str(tmp_path / "none.onnx")) == 2
    assert "none.onnx: no such file" in capsys.readouterr().err and not (tmp_path / "out").exists()
    monkeypatch.setattr("twin_diagram.perception.segmentation.learned.OnnxSegmenter", Red)
    for name, found in (("red", 6), ("blue", 0)):
        assert track(library, scene, tmp_path / name, "--segmenter", f"{name}.onnx") == 0
        assert len((tmp_path / name / "poses.csv").read_text().splitlines()) == 1 + found
        assert not any(one["asset"] is None for line in lines(tmp_path / name) for one in line["objects"])


def test_frames_without_times_are_told_to_be_a_second_apart(
    library: Path, taken: Shots, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = folder_of(Shots(taken.frames[:2]), tmp_path / "frames")
    for times in (True, False):
        assert track(library, frames, tmp_path / "out") == 0
        assert ("1 s apart" in capsys.readouterr().err) == (not times)
        (frames / "times.json").unlink(missing_ok=True)


def test_poses_without_a_heading_are_told_to_lack_it(
    library: Path, scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "init.csv").write_text("0,0,1,1,1 0 0 0 1 0 0 0 1,0 0 500,0\n" * 2)
    assert track(library, scene, tmp_path / "out", "--init", str(tmp_path / "init.csv")) == 2
    error = capsys.readouterr().err.strip()
    assert error.endswith(
        "init.csv: no BOP result: its first line must name the columns: scene_id,im_id,obj_id,score,R,t,time"
    )


def test_an_obj_id_of_zero_is_one(library: Path, taken: Shots, tmp_path: Path) -> None:
    own = shutil.copytree(library, tmp_path / "library")
    told = own / "brick" / "asset.yaml"
    told.write_text(told.read_text() + "\nobj_id: 0\n")
    frames = folder_of(Shots(taken.frames[:1]), tmp_path / "frames")
    assert track(own, frames, tmp_path / "out") == 0
    (row,) = csv.DictReader((tmp_path / "out" / "poses.csv").read_text().splitlines())
    assert row["obj_id"] == "0"


@pytest.mark.parametrize(("grey", "said"), [(True, "no rgb/, gray/ is read"), (False, "no rgb/, nor gray/")])
def test_pictures_without_colours_are_told(
    grey: bool, said: str, library: Path, taken: Shots, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = folder_of(Shots(taken.frames[:1]), tmp_path / "frames")
    if grey:
        (frames / "rgb").rename(frames / "gray")
    else:
        shutil.rmtree(frames / "rgb")
    assert track(library, frames, tmp_path / "out") == 0
    assert said in capsys.readouterr().err


def test_without_a_table_a_thing_is_found_that_stands_on_nothing(library: Path, taken: Shots, tmp_path: Path) -> None:
    """A thing held before the camera, none of its faces towards it: it was looked for as it lies on a table alone."""
    frame = taken.frames[0]
    near = frame.depth.copy()
    brick = np.all(frame.rgb == (200, 40, 40), axis=2) if frame.rgb is not None else near > 0
    near[~brick] = 0.0
    alone = Shots([replace(frame, depth=near), replace(frame, number=1, time=0.1, depth=near)])
    assert track(library, folder_of(alone, tmp_path / "frames"), tmp_path / "out") == 0
    assert len(lines(tmp_path / "out")) == 2
    for line in lines(tmp_path / "out"):
        one = of(line, "brick")
        assert np.linalg.norm(np.array(one["p_WO"]) - (-0.04, 0.02, SIZE[2] / 2)) < 0.003
        assert angle(one["q_WO"], YAW) < np.radians(2.0)


def test_noise_on_a_wall_is_nothing_that_stands_on_it(library: Path, tmp_path: Path) -> None:
    """Before a camera that hangs upside down nothing else tells table from wall."""
    wall = trimesh.creation.box((1.6, 0.02, 1.0))
    wall.apply_translation([0.0, 0.5, 0.45])
    away = np.array([0.0, -np.cos(0.5), np.sin(0.5)])
    x, z = np.array([-1.0, 0.0, 0.0]), -away
    view = ViewCamera(400, 320, 380.0, 380.0, 199.5, 159.5, np.stack([x, np.cross(z, x), z], axis=1), away * 0.9)
    rng = np.random.default_rng(3)
    (frame,) = shots([body(SIZE, -0.04, 0.02, YAW), wall], [view]).frames
    noisy = frame.depth + 0.003 * frame.depth**2 * rng.standard_normal(frame.depth.shape)
    taken = Shots([replace(frame, depth=noisy.astype(np.float32))])
    assert track(library, folder_of(taken, tmp_path / "frames"), tmp_path / "out") == 0
    one = of(lines(tmp_path / "out")[0], "brick")
    assert np.linalg.norm(np.array(one["p_WO"]) - [-0.04, 0.02, SIZE[2] / 2]) < 0.004


def test_frames_without_depth_come_before_the_first_that_counts(
    library: Path, taken: Shots, tracked: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Cameras begin with empty pictures: of these no table was found, nor anything after them."""
    specks = np.zeros_like(taken.frames[0].depth)
    specks[100, 100:120] = 0.7
    begun = ["--init", str(tracked / "poses.csv")]
    for k, (depth, more) in enumerate(((0.0 * specks, []), (specks, begun))):
        shown = Shots([replace(taken.frames[0], depth=depth), taken.frames[1]])
        assert track(library, folder_of(shown, tmp_path / f"frames{k}"), tmp_path / f"out{k}", *more) == 0
        none, line = lines(tmp_path / f"out{k}")
        assert none == {"frame": 0, "time": 0.0, "objects": []}
        np.testing.assert_allclose(of(line, "brick")["p_WO"][:2], [STEP - 0.04, 0.02], atol=2e-3)
        assert "begins at frame 1" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["black", "longest range", "specks"])
def test_an_empty_frame_takes_nothing_away(kind: str, library: Path, taken: Shots, tmp_path: Path) -> None:
    """All that was known was looked through at a camera's longest range, and lost after three frames, at 0.03."""
    depth = np.zeros_like(taken.frames[0].depth)
    if kind == "longest range":
        depth += 4.0
    elif kind == "specks":
        depth[100, 100:120] = 0.001
    empty = replace(taken.frames[0], rgb=np.zeros_like(taken.frames[0].rgb), depth=depth)
    shown = [taken.frames[0]] * 3 + [empty] * 6 + [taken.frames[0]]
    frames = Shots([replace(frame, number=k, time=k / 15.0) for k, frame in enumerate(shown)])
    assert track(library, folder_of(frames, tmp_path / "frames"), tmp_path / "out") == 0
    found = [of(line, "brick") for line in lines(tmp_path / "out")]
    before = found[2]["probability"]
    hidden = [one["probability"] for one in found[3:9]]
    assert hidden == sorted(hidden, reverse=True) and 0.9 * before < hidden[-1] < before
    assert {one["status"] for one in found[3:9]} == {"tracked"} and {one["visible"] for one in found[3:9]} == {0.0}
    assert found[-1]["probability"] > 0.99 * before and len({one["track"] for one in found}) == 1
    assert sum(line["frame"] >= 3 and len(line["objects"]) != 2 for line in lines(tmp_path / "out")) == 0


@pytest.mark.parametrize("begin", [-100.0, 1.7e9])
def test_times_may_begin_anywhere(begin: float, library: Path, taken: Shots, tracked: Path, tmp_path: Path) -> None:
    """What was before 0 passed for never seen, and of a clock that counts from 1970 the table lost the fractions."""
    moved = Shots([replace(frame, time=frame.time + begin) for frame in taken.frames[:2]])
    assert track(library, folder_of(moved, tmp_path / "frames"), tmp_path / "out") == 0
    told = [float(line.split(",")[-1]) for line in (tmp_path / "out" / "poses.csv").read_text().splitlines()[1:]]
    np.testing.assert_allclose(np.array(told) - begin, [0.0, 1 / 15], atol=1e-6)
    for here, there in zip(lines(tmp_path / "out"), lines(tracked)[:2], strict=True):
        assert here["time"] == pytest.approx(there["time"] + begin, abs=1e-6)
        np.testing.assert_allclose(of(here, "brick")["p_WO"], of(there, "brick")["p_WO"], atol=1e-6)


@pytest.mark.parametrize(
    ("K", "said"),
    [
        ([1e9, 0, 200, 0, 1e9, 160, 0, 0, 1], "fx is 1e+09 for 400 pixels"),
        ([520, 0, 200, 0, 1e-3, 160, 0, 0, 1], "fy is 0.001 for 320 pixels"),
    ],
)
def test_a_view_that_is_no_cameras_is_refused(
    K: list[float], said: str, library: Path, scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A focal length in another unit: points a million pixels wide took hours to be laid out."""
    frames = shutil.copytree(scene, tmp_path / "frames")
    entries = json.loads((frames / "scene_camera.json").read_text())
    (frames / "scene_camera.json").write_text(json.dumps({k: e | {"cam_K": K} for k, e in entries.items()}))
    assert track(library, frames, tmp_path / "out") == 2
    error = capsys.readouterr().err.strip().splitlines()
    assert len(error) == 1 and said in error[0] and not (tmp_path / "out").exists()


@pytest.mark.parametrize("factor", [1000.0, 0.001])
def test_depth_in_another_unit_is_refused(
    factor: float, library: Path, scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = shutil.copytree(scene, tmp_path / "frames")
    entries = json.loads((frames / "scene_camera.json").read_text())
    wrong = {k: e | {"depth_scale": e["depth_scale"] * factor} for k, e in entries.items()}
    (frames / "scene_camera.json").write_text(json.dumps(wrong))
    assert track(library, frames, tmp_path / "out") == 2
    error = capsys.readouterr().err.strip().splitlines()
    assert len(error) == 1 and "is depth_scale in another unit" in error[0] and not (tmp_path / "out").exists()


def test_a_negative_seed_is_refused(
    library: Path, scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert track(library, scene, tmp_path / "out", "--seed", "-1") == 2
    assert capsys.readouterr().err.strip() == "error: --seed -1: must not be negative"


@pytest.mark.long
def test_what_is_taken_away_is_lost_within_half_a_second_and_found_again(
    library: Path, taken: Shots, tmp_path: Path
) -> None:
    """Three frames with the brick, seven without, three with it six centimetres aside; 15 a second."""
    view = taken.frames[0].camera
    stays = body((0.05, 0.06, 0.07), 0.02, -0.13, 0.2)
    with_it, without, aside = (shots([body(SIZE, x, 0.02, YAW), stays], [view]).frames[0] for x in (-0.04, 9.0, 0.02))
    frames = [with_it] * 3 + [without] * 7 + [aside] * 3
    shown = Shots([replace(one, number=k, time=k / 15.0) for k, one in enumerate(frames)])
    assert track(library, folder_of(shown, tmp_path / "frames"), tmp_path / "out") == 0
    found = [of(line, "brick") for line in lines(tmp_path / "out")]
    assert all(one["status"] == "tracked" and one["probability"] > 0.9 for one in found[1:3])
    assert all(one["status"] == "lost" and one["probability"] < 0.1 and one["visible"] < 0.3 for one in found[9:10])
    probabilities = [one["probability"] for one in found[2:10]]
    assert probabilities == sorted(probabilities, reverse=True)
    assert abs(found[-1]["p_WO"][0] - 0.02) < 0.003 and found[-1]["probability"] > 0.9


def test_hypotheses_share_the_objects_probability(tracked: Path) -> None:
    """A box of one colour looks the same after half a turn: nothing tells which way round it was found."""
    for line in lines(tracked):
        one = of(line, "brick")
        assert sum(h["probability"] for h in one["hypotheses"]) == pytest.approx(one["probability"])
        turned = [angle(h["q_WO"], YAW) for h in one["hypotheses"]]
        assert max(turned) < np.radians(4.0) and len(turned) >= 2


@pytest.fixture(scope="module")
def two_alike(taken: Shots, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two bricks; the first is pushed towards the camera's right, both stay apart; the second is gone for a while."""
    view = taken.frames[0].camera
    frames = []
    for k in range(14):
        bodies = [body(SIZE, 0.005 * k - 0.06, 0.07, YAW)]
        if not 6 <= k < 10:
            bodies.append(body(SIZE, 0.02, -0.08, -0.5))
        both = trimesh.util.concatenate(bodies)  # one body has one colour
        frames.append(replace(shots([both], [view]).frames[0], number=k, time=k / 15.0))
    return folder_of(Shots(frames), tmp_path_factory.mktemp("alike") / "frames")


def bricks(line: dict[str, Any]) -> dict[int, dict[str, Any]]:
    return {entry["track"]: entry for entry in line["objects"] if entry["asset"] == "brick"}


def held_to_two_alike(found: list[dict[int, dict[str, Any]]], known_by: int) -> None:
    """Hold tracks to where the two bricks were: each keeps its number, also the one that nobody saw for a while."""
    first, second = (
        next(t for t, one in found[known_by].items() if (one["p_WO"][1] > 0.0) == positive)
        for positive in (True, False)
    )
    for k, line in enumerate(found[known_by:], start=known_by):
        assert set(line) == {first, second}, k
        assert np.linalg.norm(np.array(line[first]["p_WO"]) - [0.005 * k - 0.06, 0.07, SIZE[2] / 2]) < 0.005, k
        if not 6 <= k < 11:
            assert np.linalg.norm(np.array(line[second]["p_WO"]) - [0.02, -0.08, SIZE[2] / 2]) < 0.003, k
    assert found[9][second]["probability"] < 0.5 < found[13][second]["probability"]


def test_alikes_keep_their_numbers(library: Path, two_alike: Path, tmp_path: Path) -> None:
    assert track(library, two_alike, tmp_path / "out") == 0
    held_to_two_alike([bricks(line) for line in lines(tmp_path / "out")], 2)
    rows = (tmp_path / "out" / "poses.csv").read_text().splitlines()[1:]
    assert sum(row.split(",")[1] == "13" for row in rows) == 2


def test_alikes_that_are_told_each_begin_where_they_are(library: Path, two_alike: Path, tmp_path: Path) -> None:
    """The same row twice is one brick."""
    assert track(library, two_alike, tmp_path / "out") == 0
    head, *rows = (tmp_path / "out" / "poses.csv").read_text().splitlines()
    told = [row.split(",", 2)[2] for row in rows if row.split(",")[1] == "2"]
    poses = tmp_path / "poses.csv"
    poses.write_text("\n".join([head, *(f"0,0,{row}" for row in [*told, told[0]])]) + "\n")
    assert track(library, two_alike, tmp_path / "told", "--init", str(poses)) == 0
    held_to_two_alike([bricks(line) for line in lines(tmp_path / "told")], 0)


def test_what_the_calibration_leaves_open_is_in_each_covariance(
    library: Path, scene: Path, tracked: Path, tmp_path: Path
) -> None:
    """A renderer's camera is exact; one that is told to be 4 mm and 2 % off is so for all that it shows."""
    told = tmp_path / "told"
    shutil.copytree(scene, told)
    (told / "camera_extra.json").write_text('{"calibration_std": {"position": 4.0, "depth_scale": 0.02}}')
    assert track(library, told, tmp_path / "out") == 0
    camera = FrameFolder(scene, masked=False).read(5).camera
    exact, doubted = of(lines(tracked)[5], "brick"), of(lines(tmp_path / "out")[5], "brick")
    assert exact["p_WO"] == doubted["p_WO"]
    more = np.array(doubted["covariance"]) - np.array(exact["covariance"])
    sight = np.array(exact["p_WO"]) - camera.p_WC
    np.testing.assert_allclose(more[3:, 3:], 0.004**2 / 3 * np.eye(3) + 0.02**2 * np.outer(sight, sight), atol=1e-9)
    np.testing.assert_allclose(more[:3], 0.0, atol=1e-12)


@pytest.mark.parametrize(("posed", "shift"), [(True, 0.005), (False, 0.0)])
def test_a_real_cameras_calibration_is_doubted_where_nothing_is_told(posed: bool, shift: float) -> None:
    folder: Any = SimpleNamespace(calibration=None, posed=posed)
    real = DepthSigma(correlated=0.6)
    doubt = track_frames._doubt(folder, real)
    assert doubt.shift == shift and doubt.depth_scale == 0.01 and (doubt.turn > 0.0) == posed
    assert track_frames._doubt(folder, DepthSigma(lasting=0.3)) == doubt, "as that of who rounds disparities"
    assert not track_frames._doubt(folder, DepthSigma(correlated=0.0)).variances.any(), "white noise is a renderer's"
    folder.calibration = CalibrationError(0.001)
    assert track_frames._doubt(folder, real).depth_scale == 0.0
