"""An unknown thing that is seen from more and more sides."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.assets.building.pictured import box, cameras, shots
from twin_diagram.assets.building.from_mesh import AssetPlace
from twin_diagram.assets.building.growth import TUNING, Growth, Support, in_thing
from twin_diagram.assets.mesh import read_obj
from twin_diagram.errors import FramesError
from twin_diagram.signals import rotations

EDGES = (0.05, 0.04, 0.03)


def about_z(angle: float) -> np.ndarray:
    return rotations.matrix(rotations.exp(np.array([0.0, 0.0, angle])))


def test_from_one_side_it_stays_partial(tmp_path: Path) -> None:
    (frame,) = shots([box(EDGES)], cameras(1, 0.015), masked=True).frames
    growth = Growth().with_frame(in_thing(frame, np.eye(3), np.zeros(3)))
    assert len(growth) == 1 and not growth.ready
    assert growth.seen == pytest.approx((1 - np.cos(TUNING.faces)) / 2, abs=0.01)  # a cap of the sphere
    thing = growth.partial()
    towards = frame.camera.p_WC - thing.points
    assert (np.einsum("ni,ni->n", towards, thing.normals) > 0).all()  # of the hidden side nothing is claimed
    assert thing.points[:, 2].min() > -0.001 and np.abs(thing.points[:, 0]).max() < 0.0265
    np.testing.assert_allclose(np.median(thing.colours, axis=0), np.array([200, 40, 40]) / 255, atol=0.01)
    with pytest.raises(FramesError, match=r"thing: 1 pictures from 28 % of all sides, .* stays a partial thing"):
        growth.built(AssetPlace("thing", tmp_path / "library"))
    assert not (tmp_path / "library").exists()


def test_a_side_counts_once() -> None:
    taken = shots([box(EDGES)], cameras(2, 0.015), masked=True).frames
    growth = Growth()
    for frame in (taken[0], replace(taken[0], number=7), taken[1], taken[0]):
        growth = growth.with_frame(in_thing(frame, np.eye(3), np.zeros(3)))
    assert [f.number for f in growth.frames] == [0, 1]
    with pytest.raises(FramesError, match="no picture shows it yet"):
        Growth().partial()


@pytest.mark.long
def test_a_camera_that_moves_around_makes_an_asset(tmp_path: Path) -> None:
    growth, ready = Growth(), []
    R_WT, p_WT = rotations.matrix(rotations.exp(np.array([0.3, -0.2, 0.5]))), np.array([0.02, -0.01, 0.1])
    for frame in shots([box(EDGES)], cameras(9, 0.015), masked=True).frames:
        growth = growth.with_frame(in_thing(frame, R_WT, p_WT, turned=False))
        ready.append(growth.ready)
    assert ready == [False] * 5 + [True] * 4
    grown = growth.grown(AssetPlace("block", tmp_path / "library"))
    built = grown.built
    np.testing.assert_allclose(R_WT @ grown.R_TO @ [0.0, 0.0, 1.0], [0.0, 0.0, 1.0], atol=0.01)
    np.testing.assert_allclose(R_WT @ grown.p_TO + p_WT, [0.0, 0.0, EDGES[2] / 2], atol=0.001)
    own = read_obj(built.folder / "visual.obj").vertices @ (R_WT @ grown.R_TO).T
    np.testing.assert_allclose(np.ptp(own, axis=0), EDGES, atol=0.003)
    assert built.volume == pytest.approx(60e-6, rel=0.05)


@pytest.mark.long
def test_a_thing_that_turns_before_one_camera_makes_an_asset(tmp_path: Path) -> None:
    low, high = cameras(2, 0.015, low=5.0, high=75.0)
    growth = Growth()
    for k in range(12):
        R_WT, p_WT = about_z(k * np.pi / 6), np.array([0.01 * np.cos(k), 0.01 * np.sin(k), 0.0])
        thing = box(EDGES)
        thing.apply_transform(np.vstack([np.column_stack([R_WT, p_WT]), [0, 0, 0, 1]]))
        (frame,) = shots([thing], [low if k % 3 else high], masked=True).frames
        growth = growth.with_frame(in_thing(frame, R_WT, p_WT))
    assert growth.ready
    built = growth.built(AssetPlace("block", tmp_path / "library"))
    assert (built.size > np.array(EDGES) - 0.001).all()
    assert (built.size[:2] < np.array(EDGES)[:2] + 0.012).all()  # pixels are 1.2 mm, masks are grown by four


def test_what_hides_the_thing_keeps_its_depth_and_the_table_does_not() -> None:
    (frame,) = shots([box(EDGES)], cameras(1, 0.015), masked=True).frames
    assert frame.mask is not None
    depth = frame.depth.copy()
    depth[:5] = 0.1  # a hand
    hand = np.zeros(depth.shape, bool)
    hand[:5] = True
    posed = in_thing(replace(frame, depth=depth), about_z(0.5), np.array([0.1, 0.2, 0.3]), before=hand)
    assert (posed.depth[:5] == np.float32(0.1)).all() and (posed.depth[frame.mask] == frame.depth[frame.mask]).all()
    assert not posed.depth[5:][~frame.mask[5:]].any()
    back = about_z(0.5) @ posed.camera.p_WC + [0.1, 0.2, 0.3]
    np.testing.assert_allclose(back, frame.camera.p_WC, atol=1e-12)
    with pytest.raises(FramesError, match="frame 0: no mask of the thing"):
        in_thing(replace(frame, mask=None), np.eye(3), np.zeros(3))


def test_what_stands_need_not_be_seen_from_below_but_all_around() -> None:
    (frame,) = shots([box(EDGES)], cameras(1, 0.015), masked=True).frames
    up, tilt = np.array([0.0, 0.0, 1.0, 0.0]), np.radians(5.0)
    oblique = np.array([np.sin(tilt), 0.0, np.cos(tilt), 0.0])
    mask = np.zeros(frame.depth.shape, dtype=bool)

    def turned(angle: float, *planes: np.ndarray) -> Growth:
        azimuth, height = np.linspace(0.0, angle, 15, endpoint=False), np.radians(50.0)
        each = [np.array([*(np.cos(height) * np.array([np.cos(a), np.sin(a)])), np.sin(height)]) for a in azimuth]
        supports = tuple(Support(plane, mask) for plane in planes) or (None,) * 15
        return Growth((frame,) * 15, tuple(each), supports)

    assert turned(2.0 * np.pi, *(up,) * 15).ready
    assert not turned(np.pi, *(up,) * 15).ready, "its far side is missing"
    assert 0.6 < turned(2.0 * np.pi).seen < TUNING.standing_share, "of what stands on nothing the underside counts"
    assert turned(2.0 * np.pi, *(up,) * 14, oblique).up is None, "it does not stand on what turns about it"
