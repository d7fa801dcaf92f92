"""The page of a run: one file, each object's figures, the truth beside them where it is known, how it was displayed."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from tests.logs.frames.test_transforms_folder import frames
from tests.runs.learning.test_record import filled
from twin_diagram.logs.frames.transforms_folder import write_transforms
from twin_diagram.runs.learning.display_strips import TUNING, cut_out
from twin_diagram.runs.learning.gallery import TrueCloud, write_gallery
from twin_diagram.runs.learning.record import Learned, LearningRecord, RunState
from twin_diagram.runs.learning.shape_worker import FRAMES


def with_cloud(folder: Path) -> tuple[LearningRecord, RunState, npt.NDArray[np.float64]]:
    record, state = filled(folder)
    state.learned[0].state = "finished"
    cloud = record.library / "object_01"
    cloud.mkdir(parents=True)
    points = np.random.default_rng(0).normal(size=(50, 3))
    normals = points / np.linalg.norm(points, axis=1)[:, None]
    np.savez(cloud / "cloud.npz", points=points, normals=normals, colours=np.full((50, 3), 0.5))
    return record, state, points


def test_the_gallery_is_one_file_that_shows_what_failed(tmp_path: Path) -> None:
    record, state, points = with_cloud(tmp_path / "run")
    state.learned[0].grasps = 2
    state.learned[0].figures |= {
        "mass_std": 0.001,
        "centre_std": [0.0005, 0.0006, 0.0007],
        "moments": [1e-4, 2e-4, 3e-4],
        "moments_std": [1e-6, 2e-6, 6.3e-5],
        "by": {"mass": "measured", "centre": "measured", "inertia": "from shape alone"},
        "not weighed": "its log is empty",
        "pictures": 70,
        "slips": [[12, 0.004, 0.1]],
        "notes": ["shown in 2 grasps only: out of reach"],
    }
    state.learned.append(Learned("reported_01", "reported", "too wide <for> the fingers"))
    state.learned.append(Learned("object_02", "failed", "it was lost", "no frames"))
    write_gallery(record, state)
    page = (record.folder / "gallery.html").read_text()
    assert all(f">1 {state}</span>" in page for state in ("finished", "reported", "failed")) and ">3 in all<" in page
    assert "too wide &lt;for&gt; the fingers" in page
    assert "500 ± 2 g" in page and "± 0.98, ± 1.2, ± 1.4 mm" in page and "100 ± 2, 200 ± 3.9, 300 ± 120 kg·mm²" in page
    assert '<td class="guess">100 ± 2' in page, "what was not measured stands out"
    assert '500 ± 2 g <span class="by">measured</span>' in page and '<span class="by guess">from shape alone' in page
    assert page.count("--again") == 1 and "--again object_02" in page, "what has a second try is told how"
    state.learned[0].figures["centre"] = [0.0021, -0.014, 0.0]
    write_gallery(record, state)
    told = '2.1 ± 0.98, -14 ± 1.2, 0 ± 1.4 mm off the middle of its box <span class="by">measured'
    assert told in (record.folder / "gallery.html").read_text()
    assert "its log is empty" in page and "out of reach" in page and "it was lost; no frames" in page
    assert "70 pictures in 2 grasps; slipped by 4 mm and 6°" in page
    assert page.count("<canvas") == 1 and "http" not in page.replace("http-equiv", "")
    (drawn,) = json.loads(page.split('id="data">')[1].split("</script>")[0])["object_01"]
    facing = np.frombuffer(base64.b64decode(drawn["normals"]), np.int8).reshape(-1, 3)
    np.testing.assert_allclose(facing / 127.0, points / np.linalg.norm(points, axis=1, keepdims=True), atol=0.005)
    spread = np.sort(np.linalg.norm(points[:, None] - points[None], axis=2), axis=1)
    assert np.median(spread[:, 1]) < drawn["disc"] < spread[:, 10].max(), "discs close the gaps between points"


def test_a_figure_has_no_more_places_than_its_error(tmp_path: Path) -> None:
    record, state, _ = with_cloud(tmp_path / "run")
    state.learned[0].figures |= {"mass": 0.6564862, "mass_std": 0.05, "centre": [-0.00712862, -0.0002717, 0.0123456]}
    state.learned[0].figures["centre_std"] = [0.00460891, 0.0183, 1e-6]
    write_gallery(record, state)
    page = (record.folder / "gallery.html").read_text()
    assert "656 ± 98 g" in page and "-7.1 ± 9, 0 ± 36, 12.3456 ± 0.002 mm" in page


def test_the_truth_stands_beside_what_was_learned_in_the_same_axes(tmp_path: Path) -> None:
    record, state, points = with_cloud(tmp_path / "run")
    figures = {
        "centre": [0.002, 0.0, -0.001],
        "centre_std": [1e-4] * 3,
        "moments": [1e-4, 2e-4, 3e-4],
        "mass_std": 0.001,
    }
    state.learned[0].figures |= figures
    moments = np.array([1.1e-4, 2.1e-4, 1.234e-3])
    # O lies at the learned centre: a true one 0.5 mm along x is 2.5 mm off the middle of the box there.
    true = TrueCloud(points, points, points, 0.501, np.array([5e-4, 0.0, 0.0]), moments, 1.4e-4)
    write_gallery(record, state, {"object_01": true})
    page = (record.folder / "gallery.html").read_text()
    cells = re.findall('<td class="true">(.*?)</td>', page)
    assert cells == ["501 g", "2.5, 0, -1 mm", "110, 210, 1234 kg·mm²"]
    assert "0.14 mm off the true one" in page and '<span class="of right">true</span>' in page
    write_gallery(record, state)
    page = (record.folder / "gallery.html").read_text()
    assert 'class="true"' not in page and ">true<" not in page and '<span class="of whole">learned</span>' in page


def test_how_an_object_was_displayed_is_shown_grasp_by_grasp(tmp_path: Path) -> None:
    record, state, _ = with_cloud(tmp_path / "run")
    write_transforms(record.of("object_01") / FRAMES, frames(5))
    state.learned[0].figures |= {"pictures_by_grasp": [3, 2], "seen_after_grasps": [0.9, 0.991]}
    state.learned.append(Learned("object_02", "failed", "it was lost", figures={"pictures_by_grasp": [0]}))
    write_gallery(record, state)
    page = (record.folder / "gallery.html").read_text()
    first, second = page.split("grasp 2: 2 pictures, 99.1 % of the surface seen by its end")
    assert "grasp 1: 3 pictures, 90.0 %" in first
    assert first.count("data:image/jpeg") == 3 and second.count("data:image/jpeg") == 2
    text = re.findall('data:image/jpeg;base64,([^"]+)', page)[0]
    assert cv2.imdecode(np.frombuffer(base64.b64decode(text), np.uint8), 1).shape == (TUNING.edge, TUNING.edge, 3)
    # Of a grasp in which none was well followed there are none; the next one's are still the next one's.
    state.learned[0].figures |= {"pictures_by_grasp": [3, 0, 2], "seen_after_grasps": [0.9, 0.91, 0.991]}
    write_gallery(record, state)
    page = (record.folder / "gallery.html").read_text()
    assert page.count("data:image/jpeg") == 5 and "grasp 2:" not in page
    assert "grasp 3: 2 pictures, 99.1 % of the surface seen by its end" in page
    # What is torn is missing, and the page is there all the same.
    next((record.of("object_01") / FRAMES).rglob("*.png")).write_bytes(b"torn")
    write_gallery(record, state)
    assert "data:image/jpeg" not in (record.folder / "gallery.html").read_text()


def test_a_cut_out_is_square_about_the_object_also_at_the_edge() -> None:
    rgb = np.zeros((60, 80, 3), np.uint8)
    mask = np.zeros((60, 80), bool)
    mask[:10, 70:] = True
    rgb[mask] = 255
    cut = cut_out(rgb, mask)
    assert cut.shape == (TUNING.edge, TUNING.edge, 3) and cut[0, -1].min() > 250
    white = (cut > 128).all(axis=2).mean()
    assert white > 0.3, "it fills a good part of what is shown"
    assert cut_out(rgb, np.zeros_like(mask)).max() == 0, "the middle, where there is no object"
