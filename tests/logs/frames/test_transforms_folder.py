"""Nerfstudio's folders: what is written is read again, and what cannot be used is refused in one line."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.runs.learning.held_box import HALF, camera, shown, turned
from tests.synthetic_scene import box_hit
from twin_diagram.errors import FramesError
from twin_diagram.logs.frames.hand_boxes import Boxes
from twin_diagram.logs.frames.scene_folder import RgbdFrame
from twin_diagram.logs.frames.transforms_folder import TransformsFolder, write_transforms
from twin_diagram.runs.learning.motion import pose


def frames(count: int = 2) -> list[RgbdFrame]:
    X_TB = np.eye(4)
    X_TB[2, 3] = 0.05
    found = []
    for k in range(count):
        one = shown(turned(0.5 * k), X_TB, k)
        rgb = np.random.default_rng(k).integers(0, 255, one.picture.rgb.shape).astype(np.uint8)
        camera = one.picture.camera
        found.append(RgbdFrame(k, float(k), rgb, one.picture.depth, one.mask, camera, camera))
    return found


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    sent = frames()
    folder = write_transforms(tmp_path / "frames", sent, [~frame.mask for frame in sent if frame.mask is not None])
    got = TransformsFolder(folder)
    assert len(got) == 2 and got.has_masks
    for k, frame in enumerate(sent):
        back = got.read(k)
        assert back.rgb is not None and (back.rgb == frame.rgb).all()
        assert back.mask is not None and (back.mask == frame.mask).all()
        assert back.depth == pytest.approx(frame.depth, abs=5.1e-5)
        assert back.camera.R_WC == pytest.approx(frame.camera.R_WC)
        assert back.camera.p_WC == pytest.approx(frame.camera.p_WC)
        for name in ("fx", "fy", "cx", "cy", "width", "height"):
            assert getattr(back.camera, name) == getattr(frame.camera, name)
    assert (folder / "hands" / "0001.png").is_file()


def test_boxes_of_the_hand_are_read_again(tmp_path: Path) -> None:
    sent = Boxes(pose(np.eye(3)[[1, 2, 0]], np.array([0.1, 0.0, -0.2])), np.zeros((2, 3)), np.full((2, 3), 0.02))
    (got,) = TransformsFolder(write_transforms(tmp_path / "frames", frames(1), None, [sent])).hands
    assert got.X_ST == pytest.approx(sent.X_ST) and got.low == pytest.approx(sent.low)
    assert got.high == pytest.approx(sent.high)
    assert TransformsFolder(write_transforms(tmp_path / "bare", frames(1))).hands == []


def test_poses_and_pixels_are_as_nerfstudio_has_them(tmp_path: Path) -> None:
    told = json.loads((write_transforms(tmp_path / "frames", frames(1)) / "transforms.json").read_text())
    camera = frames(1)[0].camera
    X = np.array(told["frames"][0]["transform_matrix"])
    # OpenGL: the camera looks along its own negative z axis, y is up in the picture.
    assert X[:3, 2] == pytest.approx(-camera.R_WC[:, 2]) and X[:3, 1] == pytest.approx(-camera.R_WC[:, 1])
    assert X[:3, 0] == pytest.approx(camera.R_WC[:, 0])
    # A pixel's centre is at a half there.
    assert (told["cx"], told["cy"]) == (camera.cx + 0.5, camera.cy + 0.5)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda told: told.pop("frames"), "frames"),
        (lambda told: told["frames"][1].pop("depth_file_path"), "depth"),
        (lambda told: told["frames"][0].pop("transform_matrix"), "transform_matrix"),
        (lambda told: told["frames"][0].update(transform_matrix=(2 * np.eye(4)).tolist()), "rotation"),
        (lambda told: told.update(k4=-1e-4), "distortion k4"),
        (lambda told: told["frames"][0].update(k4=0.1), "frame 0: distortion k4"),
        (lambda told: told.update(k1=None), "k1 is None, not a number"),
        (lambda told: told["frames"][1].update(k2="x"), "k2 is 'x', not a number"),
        (lambda told: told.update(k3=float("nan")), "k3 is nan"),
        (lambda told: told.update(depth_unit_scale_factor="1 mm"), "depth_unit_scale_factor is '1 mm'"),
        (lambda told: told.update(depth_unit_scale_factor=[1]), "depth_unit_scale_factor is"),
        (lambda told: told.update(depth_unit_scale_factor=True), "depth_unit_scale_factor is True"),
        (lambda told: told.update(depth_unit_scale_factor=0), "depth_unit_scale_factor is 0 m"),
        (lambda told: told.update(camera_model="OPENCV_FISHEYE"), "FISHEYE"),
        (lambda told: told["frames"][1].update(camera_model="OPENCV_FISHEYE"), "frame 1: camera_model OPENCV_FISHEYE"),
        (lambda told: told["frames"][1].pop("mask_path"), "frame 1 has no mask_path, others have"),
        (lambda told: told["frames"][1].update(file_path="images/0009.png"), "images/0009.png: no such file"),
        (lambda told: told["frames"][0].update(depth_file_path="../depth.png"), "depth.png: no such file"),
        (lambda told: told["frames"][0].update(mask_path=7), "frame 0: mask_path is 7, not a file's name"),
        (lambda told: told["frames"][1]["transform_matrix"][0].__setitem__(3, float("nan")), "frame 1: .* no rotation"),
        (lambda told: told["frames"][1]["transform_matrix"].__setitem__(3, [0, 0, 1, 1]), "frame 1: .* no rotation"),
        (lambda told: told["frames"][1].update(transform_matrix=np.diag([1.0, 1, -1, 1]).tolist()), "no rotation"),
        (lambda told: told["frames"][1].update(fl_x=-300.0), "frame 1: fl_x and fl_y are -300"),
        (lambda told: told.pop("fl_x"), "fl_x is None, not a number"),
        (lambda told: told.update(applied_transform=[[1, 0], [0, 1]]), "applied_transform is not 3 × 4"),
        (
            lambda told: told.update(applied_transform=np.diag([2.0, 2, 2, 1])[:3].tolist()),
            "applied_transform holds no",
        ),
        (lambda told: told.update(applied_scale=0), "applied_scale is 0"),
        (lambda told: told.update(hand_boxes=3), "hand_boxes is no list"),
        (lambda told: told.update(hand_boxes=[3]), "hand_boxes 0 has no transform_matrix"),
        (lambda told: told.update(hand_boxes=[{"transform_matrix": np.eye(4).tolist()}]), "has no low and high"),
        (
            lambda told: told.update(
                hand_boxes=[{"transform_matrix": np.eye(4).tolist(), "low": [[0, 0, 0]], "high": []}]
            ),
            "hand_boxes 0: low and high are not corners",
        ),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(tmp_path: Path, change: object, word: str) -> None:
    folder = write_transforms(tmp_path / "frames", frames())
    told = json.loads((folder / "transforms.json").read_text())
    change(told)  # type: ignore[operator]
    (folder / "transforms.json").write_text(json.dumps(told))
    with pytest.raises(FramesError, match=word) as error:
        TransformsFolder(folder)
    assert "\n" not in str(error.value)


def changed(folder: Path, **more: object) -> TransformsFolder:
    told = json.loads((folder / "transforms.json").read_text())
    told.update(more)
    (folder / "transforms.json").write_text(json.dumps(told))
    return TransformsFolder(folder)


def test_what_was_applied_to_the_poses_is_undone(tmp_path: Path) -> None:
    folder = write_transforms(tmp_path / "frames", frames(2))
    before = TransformsFolder(folder).read(1).camera
    told = json.loads((folder / "transforms.json").read_text())
    X_AW = np.array([[0.0, 1, 0, 0.2], [-1, 0, 0, 0.0], [0, 0, 1, -0.4], [0, 0, 0, 1]])
    for frame in told["frames"]:
        X = X_AW @ np.array(frame["transform_matrix"])
        X[:3, 3] *= 0.25
        frame["transform_matrix"] = X.tolist()
    X = X_AW @ pose(np.eye(3), np.array([0.1, 0.2, 0.3]))
    X[:3, 3] *= 0.25
    hands = [{"transform_matrix": X.tolist(), "low": [[0, 0, 0]], "high": [[1, 1, 1]]}]
    applied = {"applied_transform": X_AW[:3].tolist(), "applied_scale": 0.25}
    got = changed(folder, frames=told["frames"], hand_boxes=hands, **applied)
    assert got.hands[0].X_ST[:3, 3] == pytest.approx([0.1, 0.2, 0.3])
    after = got.read(1)
    assert after.camera.R_WC == pytest.approx(before.R_WC) and after.camera.p_WC == pytest.approx(before.p_WC)


def test_each_frame_may_have_a_lens_of_its_own(tmp_path: Path) -> None:
    folder = write_transforms(tmp_path / "frames", frames(2))
    told = json.loads((folder / "transforms.json").read_text())
    told["frames"][1].update(fl_x=300.0, fl_y=310.0, cx=100.5, cy=90.5)
    got = changed(folder, frames=told["frames"])
    assert got.read(0).camera.fx == 240.0
    assert [getattr(got.read(1).camera, name) for name in ("fx", "fy", "cx", "cy")] == [300.0, 310.0, 100.0, 90.0]


def test_a_picture_of_another_size_than_told_is_refused_as_it_is_read(tmp_path: Path) -> None:
    got = changed(write_transforms(tmp_path / "frames", frames(1)), w=640, h=480)
    with pytest.raises(FramesError, match="240 × 200 pixels, w × h are 640 × 480") as error:
        got.read(0)
    assert "\n" not in str(error.value)


def test_a_lens_that_is_told_to_bend_nothing_is_read(tmp_path: Path) -> None:
    folder = write_transforms(tmp_path / "frames", frames(1))
    told = json.loads((folder / "transforms.json").read_text())
    told.update(k1=0, p1=0.0)
    told["frames"][0].update(k2=0.0)
    del told["depth_unit_scale_factor"]
    before = TransformsFolder(folder).read(0).depth
    (folder / "transforms.json").write_text(json.dumps(told))
    assert TransformsFolder(folder).read(0).depth == pytest.approx(10.0 * before), "a millimetre, where nothing is told"


def test_what_a_lens_bends_is_taken_out(tmp_path: Path) -> None:
    """A box seen through a lens that moves the corners by some 20 pixels: pixel by pixel where its rays lead."""
    told = {"k1": -0.25, "k2": 0.06, "p1": 0.002, "p2": -0.003, "k3": 0.01}
    view, X_WB = camera(), turned(0.5) @ pose(np.eye(3), np.array([0.0, 0.0, 0.05]))
    shown_x, shown_y = view.rays()[..., 0], view.rays()[..., 1]
    x, y = shown_x, shown_y
    for _ in range(60):  # Brown's formula, inverted
        r = x**2 + y**2
        radial = 1.0 + told["k1"] * r + told["k2"] * r**2 + told["k3"] * r**3
        x, y = (
            (shown_x - 2.0 * told["p1"] * x * y - told["p2"] * (r + 2.0 * x**2)) / radial,
            (shown_y - told["p1"] * (r + 2.0 * y**2) - 2.0 * told["p2"] * x * y) / radial,
        )
    bent = np.stack([x, y, np.ones_like(x)], axis=-1)
    assert np.abs(bent - view.rays())[..., :2].max() * view.fx > 15.0

    def seen(rays: np.ndarray) -> RgbdFrame:
        R, p = X_WB[:3, :3], X_WB[:3, 3]
        depth, _ = box_hit(R.T @ (view.p_WC - p), (rays @ view.R_WC.T) @ R, HALF)
        mask = np.isfinite(depth)
        rgb = np.clip(127 + 250 * rays[..., [0, 1, 0]], 0, 255).astype(np.uint8)
        return RgbdFrame(0, 0.0, rgb, np.where(mask, depth, 2.0).astype(np.float32), mask, view, view)

    got = changed(write_transforms(tmp_path / "frames", [seen(bent)]), **told).read(0)
    want = seen(view.rays())
    assert got.mask is not None and want.mask is not None and got.rgb is not None and want.rgb is not None
    assert (got.mask & want.mask).sum() > 0.97 * (got.mask | want.mask).sum()
    inner = cv2.erode(want.mask.astype(np.uint8), np.ones((5, 5))) > 0
    assert np.abs(got.depth - want.depth)[inner].max() < 1e-3
    there = got.depth > 0.0
    assert there.mean() > 0.9 and np.abs(got.rgb[there].astype(int) - want.rgb[there]).max() <= 4
    assert (got.camera.fx, got.camera.cx, got.camera.cy) == (view.fx, view.cx, view.cy)


def test_a_lens_that_folds_the_picture_over_is_refused_as_it_is_read(tmp_path: Path) -> None:
    got = changed(write_transforms(tmp_path / "frames", frames(1)), k1=-5.0)
    with pytest.raises(FramesError, match="frame 0: distortion -5, 0, 0, 0, 0 folds") as error:
        got.read(0)
    assert "\n" not in str(error.value)


def test_depth_of_fewer_pixels_than_its_picture_is_read_on_its_own_grid(tmp_path: Path) -> None:
    """As telephones with a lidar record it: 256 × 192 beside 1920 × 1440."""
    (sent,) = frames(1)
    folder = write_transforms(tmp_path / "frames", [sent])
    for name in ("images", "masks"):
        path = str(folder / name / "0000.png")
        image = cv2.imread(path, cv2.IMREAD_UNCHANGED)
        cv2.imwrite(path, cv2.resize(image, None, fx=3, fy=3, interpolation=cv2.INTER_NEAREST))
    view = sent.camera
    more = {"w": 720, "h": 600, "fl_x": 3 * view.fx, "fl_y": 3 * view.fy}
    got = changed(folder, **more, cx=3 * (view.cx + 0.5), cy=3 * (view.cy + 0.5)).read(0)
    assert got.rgb is not None and (got.rgb == sent.rgb).all() and (got.mask == sent.mask).all()
    assert [getattr(got.camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")] == pytest.approx(
        [view.width, view.height, view.fx, view.fy, view.cx, view.cy]
    )
    cv2.imwrite(str(folder / "masks" / "0000.png"), np.eye(100, dtype=np.uint8) * 255)
    with pytest.raises(FramesError, match="the mask is of another size than depth"):
        TransformsFolder(folder).read(0)


def test_depth_may_be_an_array_of_floating_point(tmp_path: Path) -> None:
    (sent,) = frames(1)
    folder = write_transforms(tmp_path / "frames", [sent])
    told = json.loads((folder / "transforms.json").read_text())["frames"]
    told[0]["depth_file_path"] = "depth/0000.npy"
    depth = sent.depth.copy()
    depth[0, :3] = [np.nan, np.inf, -1.0]
    np.save(folder / "depth" / "0000.npy", depth[..., None])
    got = changed(folder, frames=told, depth_unit_scale_factor=1.0).read(0)
    assert (got.depth[0, :3] == 0.0).all() and (got.depth[1:] == sent.depth[1:]).all()
    for wrong, word in ((np.zeros((2, 2, 2)), "one channel"), (np.array([{}]), "not a readable array")):
        np.save(folder / "depth" / "0000.npy", wrong, allow_pickle=True)
        with pytest.raises(FramesError, match=word):
            TransformsFolder(folder).read(0)
    (folder / "depth" / "0000.npy").write_bytes(b"")
    with pytest.raises(FramesError, match="not a readable array"):
        TransformsFolder(folder).read(0)


def test_depth_at_the_end_of_its_sixteen_bits_is_none(tmp_path: Path) -> None:
    (sent,) = frames(1)
    folder = write_transforms(tmp_path / "frames", [sent])
    path = str(folder / "depth" / "0000.png")
    image = cv2.imread(path, cv2.IMREAD_UNCHANGED)
    image[0, :2] = 65535, 65534
    cv2.imwrite(path, image)
    assert TransformsFolder(folder).read(0).depth[0, :2] == pytest.approx([0.0, 6.5534])
