"""What sticks out of an object's image is drawn into it, and nothing else is."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.registration_bench import frame, model, poses
from tests.registration_kernels import inward
from twin_diagram.perception.registration.data_association import Poses, look
from twin_diagram.perception.registration.point_kernels import FINE
from twin_diagram.perception.registration.silhouette import Silhouette


def seen_as(past: Any, depth: float = 1.0) -> Any:
    """Return the made-up image with another outline, all of it at one depth."""
    return replace(frame(), past=past, depth=np.full_like(frame().depth, depth))


def outline() -> Any:
    """A thing in columns 35 to 44, rows 25 to 34, of 80 × 60 cells."""
    past = np.ones((60, 80), dtype=bool)
    past[25:35, 35:45] = False
    return past


def at(u: float, v: float, deeper: float = 0.05) -> Any:
    """One point looked up at a pixel, 2 cm beside the origin."""
    one = {"u": u, "v": v, "z": 0.6, "deeper": deeper, "facing": 0.8}
    arrays = {name: np.full((1, 1), value) for name, value in one.items()}
    return SimpleNamespace(**arrays, r=np.array([[[0.02, 0.0, 0.0]]]), counted=np.ones((1, 1), bool))


def near() -> Poses:
    return poses()[np.array([0])]


@pytest.mark.parametrize(
    ("u", "v", "du", "dv"), [(60.0, 60.0, 10.0, 0.0), (80.0, 80.0, 0.0, -12.0), (80.0, 60.0, 0, 0)]
)
def test_points_outside_go_to_the_nearest_pixel_inside(u: float, v: float, du: float, dv: float) -> None:
    camera = frame().camera
    found = Silhouette.of(model(), seen_as(outline()), near())
    assert found is not None
    normal = inward(found, at(u, v), camera)
    if du == dv == 0.0:
        assert not normal.H.any() and not normal.b.any()
        return
    # 250 px focal length at 0.6 m; the first 1.2 cells of two pixels do not count.
    way = (du * camera.R_WC[:, 0] + dv * camera.R_WC[:, 1]) / np.hypot(du, dv)
    beyond = (np.hypot(du, dv) - 2.4) * 0.6 / 250.0
    w = 0.8 * (1.0 - (beyond / 0.04) ** 2) ** 2 / 0.003**2
    J = np.concatenate([np.cross([0.02, 0.0, 0.0], way), way])
    np.testing.assert_allclose(normal.H[0], w * np.outer(J, J), rtol=1e-6)
    np.testing.assert_allclose(normal.b[0], w * J * beyond, rtol=1e-6)


def test_what_is_hidden_or_near_the_rim_stays() -> None:
    found = Silhouette.of(model(), seen_as(outline()), near())
    assert found is not None
    for looked in (at(60.0, 60.0, 0.007), at(60.0, 60.0, -0.05), at(67.7, 60.0), at(500.0, 60.0)):
        assert not inward(found, looked, frame().camera).H.any()
    repeated = at(60.0, 60.0)
    repeated.counted[:] = False
    assert not inward(found, repeated, frame().camera).H.any()


def test_what_stands_before_an_object_may_hide_it() -> None:
    """Background nearer than the object is something in front of it: the object may be behind."""
    found = Silhouette.of(model(), seen_as(outline(), 0.3), near())
    assert found is not None and not found.away.any()
    assert not inward(found, at(60.0, 60.0), frame().camera).H.any()


def test_out_of_view_there_is_none() -> None:
    behind = Poses(near().R, near().p + [2.0, 0.5, 2.5])
    aside = Poses(near().R, near().p + [0.0, 3.0, 0.0])
    assert Silhouette.of(model(), frame(), behind) is None and Silhouette.of(model(), frame(), aside) is None
    assert Silhouette.of(model(), seen_as(np.ones((60, 80), dtype=bool)), near()) is None
    nothing = inward(None, look(model(), frame(), poses(), 40, FINE), frame().camera)
    assert nothing.H.shape == (4, 6, 6) and not nothing.H.any() and not nothing.b.any()


def test_each_pose_is_drawn_in_by_its_own_points() -> None:
    """Of three poses the middle one sticks out nowhere; together they are as each alone."""
    found = Silhouette.of(model(), seen_as(outline()), near())
    assert found is not None
    one, none, other = at(60.0, 60.0), at(80.0, 60.0), at(80.0, 80.0)
    arrays = {k: np.concatenate([getattr(x, k) for x in (one, none, other)]) for k in vars(one)}
    together = inward(found, SimpleNamespace(**arrays), frame().camera)
    for k, alone in enumerate((one, none, other)):
        apart = inward(found, alone, frame().camera)
        np.testing.assert_allclose(together.H[k], apart.H[0], rtol=1e-12)
        np.testing.assert_allclose(together.b[k], apart.b[0], rtol=1e-12)
    assert together.H[0].any() and not together.H[1].any() and together.H[2].any()
