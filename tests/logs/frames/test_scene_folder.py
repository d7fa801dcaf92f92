"""BOP folders: what is written is read, and what cannot be is refused by name and value."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from tests.assets.building.pictured import Shots, box, cameras, shots, write
from twin_diagram.errors import FramesError
from twin_diagram.logs.frames import FrameFolder, ViewCamera
from twin_diagram.logs.frames.extra_camera import ExtraCamera
from twin_diagram.logs.frames.scene_folder import read_mask
from twin_diagram.signals.calibration_error import CalibrationError
from twin_diagram.signals.lens import Lens, unit_rays


@pytest.fixture(scope="module")
def taken() -> Shots:
    return shots([box((0.04, 0.03, 0.05))], cameras(3, 0.02), masked=True)


@pytest.fixture
def folder(taken: Shots, tmp_path: Path) -> Path:
    return write(taken, tmp_path / "scene")


def edit(folder: Path, change: Callable[[dict[str, Any]], Any], name: str = "scene_camera.json") -> None:
    path = folder / name
    entries = json.loads(path.read_text()) if path.exists() else {}
    change(entries)
    path.write_text(json.dumps(entries))


def test_what_is_written_is_read(folder: Path, taken: Shots) -> None:
    frames = FrameFolder(folder)
    assert len(frames) == 3 and frames.posed and frames.has_masks and frames.numbers == [0, 1, 2]
    for k, true in enumerate(taken.frames):
        frame = frames.read(k)
        np.testing.assert_allclose(frame.depth, true.depth, atol=6e-5)
        np.testing.assert_array_equal(frame.rgb, true.rgb)
        np.testing.assert_array_equal(frame.mask, true.mask)
        np.testing.assert_allclose(frame.camera.R_WC, true.camera.R_WC, atol=1e-9)
        np.testing.assert_allclose(frame.camera.p_WC, true.camera.p_WC, atol=1e-9)
        assert (frame.camera.fx, frame.camera.cx, frame.camera.cy) == (300.0, 99.5, 79.5)
        assert frame.time == k and frame.colour is frame.camera


def test_camera_projects_along_its_rays(taken: Shots) -> None:
    camera = taken.frames[1].camera
    points = camera.rays() * 0.7 @ camera.R_WC.T + camera.p_WC
    u, v, z = camera.project(points)
    np.testing.assert_allclose(u, np.broadcast_to(np.arange(200), u.shape), atol=1e-9)
    np.testing.assert_allclose(v.T, np.broadcast_to(np.arange(160), v.T.shape), atol=1e-9)
    np.testing.assert_allclose(z, 0.7)
    assert camera.project(camera.p_WC - camera.R_WC[:, 2])[0] == -1e9


def test_without_extrinsics_the_camera_stands(folder: Path) -> None:
    edit(folder, lambda e: [e[k].pop(key) for k in e for key in ("cam_R_w2c", "cam_t_w2c")])
    frames = FrameFolder(folder)
    assert not frames.posed
    np.testing.assert_array_equal(frames.read(1).camera.R_WC, np.eye(3))


def test_a_picture_that_is_cut_off_is_refused_in_one_line(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    whole = (folder / "depth" / "000001.png").read_bytes()
    (folder / "depth" / "000001.png").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(FramesError, match=r"000001\.png: not a readable image"):
        FrameFolder(folder).read(1)
    assert capfd.readouterr() == ("", "")  # nothing of OpenCV's own


def test_a_frame_is_read_when_its_turn_comes(folder: Path) -> None:
    (folder / "depth" / "000002.png").write_bytes(b"no image")
    frames = FrameFolder(folder)
    frames.read(0)
    with pytest.raises(FramesError, match=r"000002.png: not a readable image"):
        frames.read(2)


def test_times_and_a_depth_camera_of_its_own(folder: Path) -> None:
    (folder / "times.json").write_text("[0.5, 0.6, 0.8]")
    turn = [0, -1, 0, 1, 0, 0, 0, 0, 1]
    extra = {"depth_camera": {"cam_K": [150, 0, 50, 0, 160, 40, 0, 0, 1], "R_CD": turn, "t_CD": [15, 0, 0]}}
    (folder / "camera_extra.json").write_text(json.dumps(extra))
    frame = FrameFolder(folder).read(2)
    assert frame.time == 0.8 and (frame.camera.fx, frame.camera.fy, frame.camera.cy) == (150, 160, 40)
    R_CD = frame.colour.R_WC.T @ frame.camera.R_WC
    np.testing.assert_allclose(R_CD.ravel(), turn, atol=1e-9)
    np.testing.assert_allclose(frame.colour.R_WC.T @ (frame.camera.p_WC - frame.colour.p_WC), [0.015, 0, 0], atol=1e-9)


def test_grey_pictures_are_read_in_the_place_of_colours(folder: Path) -> None:
    colours = FrameFolder(folder).read(1).rgb
    (folder / "gray").mkdir()
    for path in (folder / "rgb").iterdir():
        cv2.imwrite(str(folder / "gray" / path.name), cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
    assert FrameFolder(folder).coloured
    np.testing.assert_array_equal(FrameFolder(folder).read(1).rgb, colours)
    shutil.rmtree(folder / "rgb")
    frames = FrameFolder(folder)
    assert not frames.coloured
    np.testing.assert_array_equal(
        frames.read(1).rgb, np.dstack([cv2.imread(str(folder / "gray" / "000001.png"), cv2.IMREAD_GRAYSCALE)] * 3)
    )


@pytest.mark.parametrize("held", [3, 2, 6])
def test_a_picture_stays_as_its_pixels_are(held: int, folder: Path) -> None:
    """Depth and K do not turn with how a telephone was held."""
    path = folder / "rgb" / "000001.png"
    path.unlink()
    shade = np.add.outer(np.arange(160), np.arange(200) // 2).astype(np.uint8)
    picture = Image.fromarray(np.dstack([shade, shade // 2, 255 - shade]))
    told = Image.Exif()
    told[0x0112] = held
    picture.save(folder / "rgb" / "000001.jpg", exif=told, quality=95)
    read = FrameFolder(folder).read(1).rgb
    assert read is not None and np.abs(read - np.asarray(picture, dtype=float)).mean() < 3.0


def test_a_depth_camera_may_tell_its_own_scale(folder: Path, taken: Shots) -> None:
    own = {"cam_K": [300, 0, 99.5, 0, 300, 79.5, 0, 0, 1], "depth_scale": 0.1}
    (folder / "camera_extra.json").write_text(json.dumps({"depth_camera": own}))
    edit(folder, lambda entries: [one.pop("depth_scale") for one in entries.values()])
    np.testing.assert_allclose(FrameFolder(folder).read(1).depth, taken.frames[1].depth, atol=6e-5)


@pytest.mark.parametrize("scale", [1.0, 0.1, 0.25])
def test_depth_at_the_end_of_its_sixteen_bits_is_none(scale: float, folder: Path) -> None:
    """65535 is what cameras write where they see nothing, and where what is far ends: no wall stands there."""
    edit(folder, lambda entries: [one.update(depth_scale=scale) for one in entries.values()])
    path = folder / "depth" / "000001.png"
    image = np.full((160, 200), 4000, dtype=np.uint16)
    image[:40], image[40, 0], image[41, 0] = 65535, 0, 65534
    cv2.imwrite(str(path), image)
    depth = FrameFolder(folder).read(1).depth
    assert not depth[:40].any() and depth[40, 0] == 0.0
    np.testing.assert_allclose(depth[42:], 4.0 * scale, rtol=1e-6)
    assert depth[41, 0] == pytest.approx(65.534 * scale)


def test_distortion_is_taken_out(folder: Path, taken: Shots) -> None:
    (folder / "camera_extra.json").write_text(json.dumps({"distortion": [0.3, 0, 0, 0, 0]}))
    frame, c = FrameFolder(folder).read(0), taken.frames[0].camera
    # A pixel of the straight picture shows what the bent one has farther out, by 1 + k1 r².
    x, y = (20 - c.cx) / c.fx, (30 - c.cy) / c.fy
    r2 = x * x + y * y
    u, v = x * (1 + 0.3 * r2) * c.fx + c.cx, y * (1 + 0.3 * r2) * c.fy + c.cy
    ray = c.R_WC @ [(u - c.cx) / c.fx, (v - c.cy) / c.fy, 1.0]
    assert frame.depth[30, 20] == pytest.approx(-c.p_WC[2] / ray[2], abs=2e-4)  # the table's; depth is in tenths of mm
    assert abs(u - 20) > 1.5


@pytest.mark.parametrize("distortion", [(-0.28, 0.07, 0.0002, -0.0003, 0.0), (-0.28, 0.07, 0.0002, -0.0003)])
def test_depth_of_a_bent_picture_is_that_between_its_pixels(distortion: tuple[float, ...]) -> None:
    """A wall seen at 45°: the nearest pixel's depth would be up to 5 mm off."""
    bent = Lens(640, 480, 600.0, 600.0, 320.3, 238.1, (*distortion, 0.0)[:5])
    camera = ViewCamera(640, 480, 600.0, 600.0, 320.3, 238.1, np.eye(3), np.zeros(3))
    n = np.array([1.0, 0.0, -1.0])
    seen, want = ((-1.0 / (unit_rays(lens) @ n)).astype(np.float32) for lens in (bent, bent.straight))
    got = ExtraCamera(np.array(distortion), np.array(distortion)).straight_depth(seen, camera)
    there = (got > 0.0) & (want > 0.0) & (want < 3.0)
    assert there.mean() > 0.5 and np.abs(got - want)[there].max() < 1e-4


def test_what_a_camera_is_called_is_told_and_passed_over(folder: Path) -> None:
    assert FrameFolder(folder).notes == []
    said = {"serial": "0123", "depth_camera": {"cam_K": [9, 0, 4, 0, 9, 3, 0, 0, 1], "width": 8}}
    (folder / "camera_extra.json").write_text(json.dumps(said))
    notes = FrameFolder(folder).notes
    assert [note.rsplit(": ", 1)[1] for note in notes] == ["serial is not read", "width is not read"]


def test_one_sensors_depth_may_lie_a_hundredth_of_a_millimetre_beside_its_colours(folder: Path) -> None:
    colour = json.loads((folder / "scene_camera.json").read_text())["1"]["cam_K"]
    half = [0.5 * x for x in colour[:8]] + [1]  # of a depth image half as wide
    own = {"cam_K": half, "t_CD": [-0.0109, 0.0079, -0.0002]}

    def notes() -> list[str]:
        (folder / "camera_extra.json").write_text(json.dumps({"depth_camera": own}))
        return FrameFolder(folder).notes

    (note,) = notes()
    assert "t_CD is 0.0135 mm long; is it in metres? It counts as mm" in note
    own["t_CD"] = [15.0, 0, 0]
    assert notes() == []
    # Another sensor's: turned by half a degree, or of another lens.
    own |= {
        "t_CD": [0.0149, 0, 0],
        "R_CD": [1, 0, 0, 0, np.cos(0.009), -np.sin(0.009), 0, np.sin(0.009), np.cos(0.009)],
    }
    with pytest.raises(FramesError, match="It must be in mm"):
        notes()
    own |= {"R_CD": np.eye(3).ravel().tolist(), "cam_K": [1.5 * half[0], 0, half[2], 0, 1.5 * half[4], *half[5:]]}
    with pytest.raises(FramesError, match="It must be in mm"):
        notes()


def test_numbers_that_may_be_of_another_unit_are_said(folder: Path) -> None:
    (folder / "times.json").write_text("[0, 66, 133]")
    edit(folder, lambda e: [one.update(cam_t_w2c=[x / 1000 for x in one["cam_t_w2c"]]) for one in e.values()])
    place, time = FrameFolder(folder).notes
    assert "mm long at most; is it in metres? It counts as mm" in place
    assert "frames are 66.5 s apart; is it in ms? It counts as s" in time
    edit(folder, lambda e: [one.update(cam_t_w2c=[0, 0, 0]) for one in e.values()])
    (folder / "times.json").write_text("[0, 2, 4]")
    assert FrameFolder(folder).notes == []


def test_pictures_of_other_kinds_and_json_with_a_mark_are_read(folder: Path) -> None:
    rgb = FrameFolder(folder).read(1).rgb
    for path in (folder / "rgb").iterdir():
        image = cv2.imread(str(path))
        path.unlink()
        cv2.imwrite(str(path.with_suffix(".bmp")), image)
    told = (folder / "scene_camera.json").read_bytes()
    (folder / "scene_camera.json").write_bytes(b"\xef\xbb\xbf" + told)
    again = FrameFolder(folder).read(1).rgb
    assert rgb is not None and again is not None and np.array_equal(again, rgb)


@pytest.mark.parametrize("depth_apart", [False, True])
@pytest.mark.parametrize(
    ("lens", "told"),
    [("fisheye", [-0.04, 0.02, -0.01, 0.003]), ("brown", [0.6, -1.9, 0.0004, -0.0003, 1.1, 0.45, -1.7, 1.0])],
)
def test_a_fisheye_and_a_rational_lens_are_straightened(lens: str, told: list[float], depth_apart: bool) -> None:
    """Pictures of the bent ones' own columns: straight, each pixel tells which it came from."""
    x, y = (np.arange(640) - 320.3) / 400.0, (np.arange(480)[:, None] - 238.1) / 390.0
    r2 = x**2 + y**2
    if lens == "fisheye":
        angle, r = np.arctan(np.sqrt(r2)), np.sqrt(r2)
        column = 400.0 * x / r * sum(k * angle ** (2 * n + 1) for n, k in enumerate([1.0, *told])) + 320.3
    else:
        k1, k2, p1, p2, k3, k4, k5, k6 = told
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        column = 400.0 * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)) + 320.3
    none, own = np.zeros(0), np.array(told)
    bent, kinds = (
        ((none, own), (False, lens == "fisheye")) if depth_apart else ((own, none), (lens == "fisheye", False))
    )
    extra = ExtraCamera(*bent, depth_apart, fisheyes=kinds)
    camera = ViewCamera(640, 480, 400.0, 390.0, 320.3, 238.1, np.eye(3), np.zeros(3))
    inner = np.s_[60:-60, 60:-60]  # what lies beyond the bent picture mixes with none
    # The inverse of depth is interpolated: what is linear in the column comes back as it is.
    seen = np.broadcast_to((1.0 / (1.0 + np.arange(640) / 640)).astype(np.float32), (480, 640))
    got = extra.straight_depth(np.ascontiguousarray(seen), camera)
    assert np.abs(column - np.arange(640)).max() > 20.0
    np.testing.assert_allclose((640 * (1 / got[inner] - 1)), column[inner], atol=0.05)
    painted = np.dstack([np.broadcast_to((np.arange(640) // 4).astype(np.uint8), (480, 640))] * 3)
    shade = extra.straight(painted, camera)[..., 0].astype(float)
    want = painted[..., 0] if depth_apart else column / 4
    assert np.abs(shade - want)[inner].max() < 1.1


def test_a_distortion_that_no_lens_has_is_refused(folder: Path) -> None:
    (folder / "camera_extra.json").write_text(json.dumps({"distortion": [-5, 0, 0, 0]}))
    with pytest.raises(FramesError, match=r"camera_extra.json: distortion -5, 0, 0, 0 folds the picture over"):
        FrameFolder(folder).read(0)


def test_how_well_a_camera_is_calibrated_may_be_told(folder: Path) -> None:
    assert FrameFolder(folder).calibration is None
    told = {"position": 4.0, "rotation": 0.01, "depth_scale": 0.02}
    (folder / "camera_extra.json").write_text(json.dumps({"calibration_std": told}))
    assert FrameFolder(folder).calibration == CalibrationError(0.004, 0.01, depth_scale=0.02)
    depth = {"depth_camera": {"cam_K": [150, 0, 50, 0, 160, 40, 0, 0, 1]}, "calibration_std": {}}
    (folder / "camera_extra.json").write_text(json.dumps(depth))
    assert FrameFolder(folder).calibration == CalibrationError()


def extra(folder: Path, told: str) -> None:
    (folder / "camera_extra.json").write_text(f'{{"calibration_std": {told}}}')


def depth_camera(folder: Path, K: str, **more: list[float]) -> None:
    own = {"cam_K": [int(x) for x in K.split(",")], **more}
    (folder / "camera_extra.json").write_text(json.dumps({"depth_camera": own}))


def out(path: Path, target: Path) -> None:
    path.unlink()
    path.symlink_to(target)


def small(path: Path) -> None:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(path), image[:-2])


REFUSED: dict[str, tuple[Callable[[Path], Any], str]] = {
    "no file": (lambda f: (f / "scene_camera.json").unlink(), "scene_camera.json: no such file"),
    "no JSON": (lambda f: (f / "scene_camera.json").write_text("{"), "not readable as JSON"),
    "count": (lambda f: (f / "rgb" / "000001.png").unlink(), "rgb: 2 files, .* has 3: frame 1 is missing"),
    "beyond": (lambda f: shutil.copy(f / "depth/000001.png", f / "depth/000007.png"), "frame 7 is not in"),
    "name": (lambda f: shutil.copy(f / "depth/000001.png", f / "depth/first.png"), "named by their frame's number"),
    "two masks": (
        lambda f: shutil.copy(f / "mask_visib/000001_000000.png", f / "mask_visib/000001_000001.png"),
        "two things are masked; copy the masks of one into a folder of its own, for --masks",
    ),
    "size": (lambda f: small(f / "depth/000001.png"), "depth is 200 × 158, before it was 200 × 160"),
    "mask size": (lambda f: [small(p) for p in (f / "mask_visib").iterdir()], "200 × 158, the picture is 200 × 160"),
    "all depth": (lambda f: [small(p) for p in (f / "depth").iterdir()], "camera_extra.json"),
    "empty mask": (
        lambda f: cv2.imwrite(str(f / "mask_visib/000001_000000.png"), np.zeros((160, 200), np.uint8)),
        "000001_000000.png: the mask is empty; leave out frames",
    ),
    "8 bits": (
        lambda f: cv2.imwrite(str(f / "depth/000001.png"), np.zeros((160, 200), np.uint8)),
        "one channel of 16 bits, not uint8",
    ),
    "link": (lambda f: out(f / "rgb/000001.png", f.parent / "x.png"), "a link that leads out of|no such file"),
    "folder link": (
        lambda f: ((f / "depth").rename(f.parent / "d"), (f / "depth").symlink_to(f.parent / "d")),
        "depth: a link that leads out of",
    ),
    "reflection": (
        lambda f: edit(f, lambda e: e["1"].update(cam_R_w2c=[-x for x in e["1"]["cam_R_w2c"]])),
        "frame 1: cam_R_w2c is no rotation: it is a reflection",
    ),
    "scaled rotation": (
        lambda f: edit(f, lambda e: e["1"].update(cam_R_w2c=[1.1, 0, 0, 0, 1, 0, 0, 0, 1])),
        "R Rᵀ is 0.21 off the identity",
    ),
    "NaN": (lambda f: edit(f, lambda e: e["2"].update(cam_t_w2c=[0, float("nan"), 0])), "frame 2: cam_t_w2c must be 3"),
    "half posed": (lambda f: edit(f, lambda e: [e["2"].pop(k) for k in ("cam_R_w2c", "cam_t_w2c")]), "frame 2 has no"),
    "focal": (lambda f: edit(f, lambda e: e["0"].update(cam_K=[0, 0, 1, 0, 1, 1, 0, 0, 1])), "cam_K must be"),
    "scale": (lambda f: edit(f, lambda e: e["0"].update(depth_scale=-1)), "depth_scale is -1"),
    "words": (lambda f: edit(f, lambda e: e["0"].update(cam_K="K")), "'K', not numbers"),
    "times": (lambda f: (f / "times.json").write_text("[0, 2, 1]"), "frame 2 is at 1 s, the one before it at 2 s"),
    "time twice": (lambda f: (f / "times.json").write_text("[0, 1, 1]"), "frame 2 is at 1 s, the one before it at 1 s"),
    "no time": (lambda f: (f / "times.json").write_text("[NaN, 1, 2]"), "frame 0 is at nan s: times must be finite"),
    "few times": (lambda f: (f / "times.json").write_text("[0, 2]"), "a time .* for each of the 3 frames"),
    "one time less": (lambda f: (f / "times.json").write_text('{"0": 0, "2": 1}'), "the 3 frames: frame 1 has none"),
    "distortion": (lambda f: (f / "camera_extra.json").write_text('{"distortion": [1, 2]}'), "0 or 4 or 5 or 8 finite"),
    "inverse depth camera": (lambda f: depth_camera(f, K="1, 0, 0, 0, 1, 0, 0, 0, 1", R_DC=[1]), "R_DC is not read"),
    "a lens of another kind": (
        lambda f: (f / "camera_extra.json").write_text('{"distortion": [0.1, 0, 0, 0], "model": "fisheye"}'),
        "camera_extra.json: model is not read; what is: distortion, lens, depth_camera, calibration_std",
    ),
    "an unknown lens": (
        lambda f: (f / "camera_extra.json").write_text('{"lens": "mirror"}'),
        "lens is 'mirror'; must be brown or fisheye",
    ),
    "a fisheye of five": (
        lambda f: (f / "camera_extra.json").write_text('{"distortion": [0, 0, 0, 0, 0], "lens": "fisheye"}'),
        "distortion must be 4 finite numbers",
    ),
    "a fisheye that folds": (
        lambda f: (f / "camera_extra.json").write_text('{"distortion": [-9, 0, 0, 0], "lens": "fisheye"}'),
        "distortion -9, 0, 0, 0 folds the picture over",
    ),
    "a slip of writing": (
        lambda f: (f / "camera_extra.json").write_text('{"distorsion": [0.1, 0, 0, 0]}'),
        "distorsion is not read",
    ),
    "another name": (
        lambda f: (f / "camera_extra.json").write_text('{"dist_coeffs": [0.1, 0, 0, 0]}'),
        "dist_coeffs is not read; what is: distortion",
    ),
    "a number of its own": (lambda f: (f / "camera_extra.json").write_text('{"k1": 0.1}'), "k1 is not read"),
    "metres": (
        lambda f: depth_camera(f, K="9, 0, 0, 0, 9, 0, 0, 0, 1", t_CD=[0.025, 0, 0]),
        "t_CD is 0.025 mm long; is it in metres",
    ),
    "size of depth": (lambda f: depth_camera(f, K="9, 0, 0, 0, 9, 0, 0, 0, 1", depth_scale=[0]), "depth_scale is 0"),
    "skew depth camera": (lambda f: depth_camera(f, K="9, 1, 0, 0, 9, 0, 0, 0, 1"), "depth_camera: cam_K must be"),
    "no calibration": (lambda f: extra(f, "3"), "calibration_std must hold position, .*, not 3"),
    "another calibration": (lambda f: extra(f, '{"shift": 1}'), "calibration_std must hold position"),
    "negative calibration": (lambda f: extra(f, '{"focal": -0.1}'), "calibration_std: focal is negative: -0.1"),
    "calibration in words": (lambda f: extra(f, '{"focal": "good"}'), "focal must be 1 finite numbers, not good"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case: str, folder: Path) -> None:
    cv2.imwrite(str(folder.parent / "x.png"), np.zeros((160, 200, 3), np.uint8))
    spoil, said = REFUSED[case]
    spoil(folder)
    with pytest.raises(FramesError, match=said):
        frames = FrameFolder(folder)
        for k in range(len(frames)):
            frames.read(k)


def test_a_frame_twice_and_a_truth_for_a_number_are_refused(folder: Path) -> None:
    edit(folder, lambda entries: entries.update({"02": entries["2"]}))
    with pytest.raises(FramesError, match="frame 2 is there twice, as '02' too"):
        FrameFolder(folder)
    edit(folder, lambda entries: (entries.pop("02"), entries["1"].update(depth_scale=True)))
    with pytest.raises(FramesError, match="frame 1: depth_scale is True, not numbers"):
        FrameFolder(folder)


def test_masks_may_have_any_number_of_channels(tmp_path: Path) -> None:
    """Also an opaque fourth one; of a dark thing that is cut out that one is the mask."""
    mask = np.zeros((8, 9), np.uint8)
    mask[2:5, 3:7] = 255
    full, none = np.full_like(mask, 255), np.zeros_like(mask)
    for image in (
        mask,
        mask // 255,
        np.dstack([mask] * 3),
        np.dstack([mask] * 3 + [full]),
        np.dstack([none] * 3 + [mask]),
    ):
        cv2.imwrite(str(tmp_path / "m.png"), image)
        np.testing.assert_array_equal(read_mask(tmp_path / "m.png"), mask > 0)


def test_a_mask_of_the_whole_picture_is_refused(folder: Path) -> None:
    path = min((folder / "mask_visib").iterdir())
    cv2.imwrite(str(path), np.full_like(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), 255))
    with pytest.raises(FramesError, match="the mask holds the whole picture"):
        FrameFolder(folder).read(0)


def test_an_inverted_mask_is_refused(folder: Path) -> None:
    path = min((folder / "mask_visib").iterdir())
    cv2.imwrite(str(path), 255 - cv2.imread(str(path), cv2.IMREAD_UNCHANGED))
    with pytest.raises(FramesError, match="% of the picture and its four corners; is it inverted"):
        FrameFolder(folder).read(0)


def test_masks_of_several_things_are_passed_over_where_none_are_asked_for(folder: Path) -> None:
    shutil.copy(folder / "mask_visib/000001_000000.png", folder / "mask_visib/000001_000001.png")
    frames = FrameFolder(folder, masked=False)
    assert not frames.has_masks and frames.read(1).mask is None
