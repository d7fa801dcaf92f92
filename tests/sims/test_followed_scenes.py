"""What is said of a followed scene is counted as it should be: by known poses, not by a tracker."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twin_diagram.logs.frames.view_camera import ViewCamera
from twin_diagram.runs.tracking.track_frames import REAL
from twin_diagram.signals import rotations
from twin_diagram.signals.calibration_error import shared_covariances

BENCHMARKS = Path(__file__).resolve().parents[2] / "sims" / "benchmarks"
sys.path[:0] = [str(BENCHMARKS)]

from scene_truth import tallies  # noqa: E402
from scene_truth.film import Truth  # noqa: E402
from scene_truth.script import LIFT, PERIOD, Actor, Carry  # noqa: E402
from synctwin_truth.told_camera import CameraError  # noqa: E402

FRAMES = 30
PLACES = np.array([[0.0, 0.0, 1.0], [0.2, 0.0, 1.0], [0.4, 0.0, 1.0]])
"""Of two tins and a box, before a camera that stands at W's origin."""


def kind(name: str) -> Any:
    return SimpleNamespace(asset=SimpleNamespace(name=name), symmetric="z" if name == "tin" else None)


SCRIPT: Any = SimpleNamespace(
    actors=tuple(
        Actor(kind(name), True, np.eye(3), p, ()) for name, p in zip(("tin", "tin", "box"), PLACES, strict=True)
    )
)


def truth() -> Truth:
    R = np.broadcast_to(np.eye(3), (FRAMES, 3, 3, 3))
    p = np.broadcast_to(PLACES, (FRAMES, 3, 3))
    return Truth(R, p, np.ones((FRAMES, 3)), np.zeros((FRAMES, 3), dtype=bool), np.eye(3), np.zeros(3))


def said(track: int, asset: str, p: Any, turn: Any = (0.0, 0.0, 0.0), **changes: Any) -> dict[str, Any]:
    q = rotations.exp(np.array(turn)).tolist()
    one = {"track": track, "asset": asset, "status": "tracked", "probability": 0.95, "p_WO": list(p), "q_WO": q}
    return one | {"covariance": (1e-6 * np.eye(6)).tolist(), "hypotheses": []} | changes


def right() -> list[dict[str, Any]]:
    return [said(k, "box" if k == 2 else "tin", p + [1e-3, 0.0, 0.0]) for k, p in enumerate(PLACES)]


def tally(tmp_path: Path, frames: list[list[dict[str, Any]]]) -> tallies.Tally:
    file = tmp_path / "objects.jsonl"
    file.write_text("".join(json.dumps({"frame": k, "objects": one}) + "\n" for k, one in enumerate(frames)))
    return tallies.score(file, SCRIPT, truth(), {}, "scene")


def test_what_is_right_is_right_and_its_claims_are_weighed(tmp_path: Path) -> None:
    found = tally(tmp_path, [right()] * FRAMES)
    assert found.counts == {"frames": FRAMES, "claims": 3 * FRAMES, "open": 3 * FRAMES, "open and right": 3 * FRAMES}
    assert not found.lines and found.until_found == [0.0] * 3 and not found.until_said
    np.testing.assert_allclose(found.millimetres, 1.0)
    np.testing.assert_allclose(sorted(found.nees[:3]), [1 / 6, 1 / 5, 1 / 5])
    assert all(found.inside) and all(ok for _, ok in found.confidence)


def test_what_the_cameras_calibration_makes_of_a_scene_is_told_apart(tmp_path: Path) -> None:
    """A tracker sees what a camera shows that is not where it is told: it cannot know, and claims that it may be so."""
    rng = np.random.default_rng(0)
    whole, left = [], []
    for _ in range(40):
        error = CameraError.drawn(rng)
        told = error.told(ViewCamera(640, 480, 560.0, 560.0, 319.5, 239.5, np.eye(3), np.zeros(3)))
        here = replace(truth(), told=told, calibration=error.calibration)
        x, y, z = (1.0 + error.depth_scale) * PLACES[2]
        u, v = 560.0 * x / z + 319.5, 560.0 * y / z + 239.5
        p = told.R_WC @ [(u - told.cx) * z / told.fx, (v - told.cy) * z / told.fy, z] + told.p_WC
        own = 1e-3 * rng.standard_normal(6)
        turn = rotations.log(rotations.from_matrix(rotations.matrix(rotations.exp(own[:3])) @ told.R_WC))
        view = ((p - told.p_WC) @ told.R_WC)[None], told.R_WC, told.fx, told.fy
        spread = 1e-6 * np.eye(6) + shared_covariances(REAL, *view)[0]
        file = tmp_path / "objects.jsonl"
        claim = said(2, "box", p + own[3:], turn, covariance=spread.tolist())
        file.write_text(json.dumps({"frame": 0, "objects": [claim]}) + "\n")
        found = tallies.score(file, SCRIPT, here, {}, "scene")
        whole.append(found.nees[0])
        left.append(found.nees_left[0])
    # Of 240 numbers of unit variance.
    assert abs(np.mean(whole) - 1.0) < 0.3 and abs(np.mean(left) - 1.0) < 0.3


@pytest.mark.parametrize(
    ("wrong", "kind"),
    [
        (said(7, "box", [0.0, 0.0, 1.0]), "wrong object"),
        (said(7, "box", [0.0, 0.3, 1.0]), "invented"),
        (said(7, "tin", [0.0, 0.3, 1.0]), "invented"),
    ],
)
def test_what_is_not_there_is_counted(wrong: dict[str, Any], kind: str, tmp_path: Path) -> None:
    found = tally(tmp_path, [[*right(), wrong]] * FRAMES)
    assert found.counts[kind] == FRAMES and len(found.lines) == FRAMES
    quiet = tally(tmp_path, [[*right(), wrong | {"probability": 0.4}]] * FRAMES)
    assert not quiet.lines, "what is improbable is not claimed"
    lost = tally(tmp_path, [[*right(), wrong | {"status": "lost"}]] * FRAMES)
    assert not lost.lines


def test_a_flip_counts_and_so_does_how_long_it_is_not_said(tmp_path: Path) -> None:
    flipped = [*right()[:2], said(2, "box", PLACES[2], (0.0, 0.0, np.pi))]
    spun = [*[one | {"q_WO": [0.0, 0.0, 0.0, 1.0]} for one in right()[:2]], right()[2]]
    found = tally(tmp_path, [right()] * 10 + [flipped] * 15 + [spun] * 5)
    assert found.counts["flip"] == 15, "a tin may be turned about z"
    np.testing.assert_allclose(found.until_said, [15 * PERIOD])


def test_alikes_that_change_names_are_swapped(tmp_path: Path) -> None:
    swapped = [said(1, "tin", PLACES[0]), said(0, "tin", PLACES[1]), right()[2]]
    found = tally(tmp_path, [right()] * 10 + [swapped] * 20)
    assert found.counts["swap"] == 2 and not found.counts["invented"]


def test_what_is_found_late_is_told(tmp_path: Path) -> None:
    found = tally(tmp_path, [right()[:2]] * 20 + [right()] * 10)
    assert sorted(found.until_found) == [0.0, 0.0, pytest.approx(20 * PERIOD)]
    never = tally(tmp_path, [right()[:2]] * FRAMES)
    assert np.inf in never.until_found and never.counts["open and right"] == 2 * FRAMES


def test_a_thing_is_carried_over_the_others_and_leans_half_way() -> None:
    R1 = rotations.matrix(rotations.exp(np.array([0.0, 0.0, 1.0])))
    way = Carry(1.0, 3.0, np.zeros(3), np.array([0.3, 0.1, 0.0]), np.eye(3), R1, np.array([0.4, 0.0, 0.0]))
    one = Actor(kind("box"), True, np.eye(3), np.zeros(3), (way,))
    assert not one.pose(0.9)[2] and one.pose(2.0)[2] and not one.pose(3.1)[2]
    np.testing.assert_allclose(one.pose(0.0)[1], np.zeros(3))
    np.testing.assert_allclose(one.pose(2.0)[1], [0.15, 0.05, LIFT])
    np.testing.assert_allclose(one.pose(9.0)[1], [0.3, 0.1, 0.0], atol=1e-12)
    np.testing.assert_allclose(one.pose(9.0)[0], R1, atol=1e-12)
    assert one.pose(2.0)[0][2, 2] < np.cos(0.35)
