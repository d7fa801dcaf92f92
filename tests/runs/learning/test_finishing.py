"""From a shape and what was weighed of it to an asset: what stands where in its frame."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.planning.grasps.brute_force import box_triangles
from twin_diagram.assets import Asset
from twin_diagram.assets.building import backends
from twin_diagram.assets.building.backends import ColouredSurface
from twin_diagram.assets.building.measured import MeasuredInertia
from twin_diagram.assets.mesh import read_obj
from twin_diagram.planning.grasps.known_object import read_known
from twin_diagram.runs.learning import finishing, shape_worker
from twin_diagram.runs.learning.felt_weight import Centre
from twin_diagram.runs.learning.finishing import figures_of, write_learned
from twin_diagram.runs.learning.record import SWUNG, Learned, LearningRecord, plain
from twin_diagram.runs.learning.shape_worker import SHAPE, make_shape, read_shape
from twin_diagram.runs.learning.shown_object import ShownObject
from twin_diagram.scenario import Scenario

MIDDLE = np.array([0.02, -0.03, 0.15])
"""Of the box in S, the frame of its pictures [m]."""
R_WS = Rotation.from_euler("zx", [70, 90], degrees=True).as_matrix()


@pytest.mark.parametrize("off", [np.array([0.004, 0.002, -0.01]), None])
def test_an_assets_origin_is_the_centre_of_mass_its_axes_those_of_the_world(
    tmp_path: Path, off: np.ndarray | None
) -> None:
    corners = box_triangles(0.06, 0.04, 0.1) + MIDDLE
    texture = np.full((8, 8, 3), 200, dtype=np.uint8)
    shape = ColouredSurface(corners, np.full((len(corners), 3, 2), 0.5), texture, 0.05, 0.001)
    measured = None
    if off is not None:
        inertia, by = 0.5 / 12.0 * np.diag([0.0116, 0.0136, 0.0052]), {"mass": "measured"}
        by |= {"centre": "measured", "inertia": "measured"}
        measured = MeasuredInertia(0.5, MIDDLE + off, inertia, 1e-3, np.full(3, 1e-3), np.full(6, 1e-6), by)
    told = write_learned("box", tmp_path, shape, R_WS, measured)
    centre = MIDDLE if off is None else MIDDLE + off
    np.testing.assert_allclose(told["R_OS"] @ centre + told["p_OS"], 0.0, atol=1e-6)
    np.testing.assert_allclose(told["R_OS"], R_WS)
    np.testing.assert_allclose(told["centre"], -told["p_OS"] - R_WS @ MIDDLE, atol=2e-3)
    known = read_known(tmp_path / "box")
    assert known.mass == pytest.approx(0.5 if off is not None else 0.24, rel=1e-3)
    np.testing.assert_allclose(known.centre, 0.0, atol=1e-6)
    seen = read_obj(tmp_path / "box" / "visual.obj").vertices
    expected = (corners.reshape(-1, 3) - centre) @ R_WS.T
    np.testing.assert_allclose(seen.min(axis=0), expected.min(axis=0), atol=2e-5)
    np.testing.assert_allclose(seen.max(axis=0), expected.max(axis=0), atol=2e-5)


def test_what_was_not_swung_weighs_what_torques_at_rest_said(tmp_path: Path) -> None:
    corners = box_triangles(0.06, 0.04, 0.1) + MIDDLE
    shape = ColouredSurface(corners, np.full((len(corners), 3, 2), 0.5), np.full((8, 8, 3), 200, np.uint8), 0.05, 0.001)
    shown = ShownObject(mass_at_rest=1.2)
    told = write_learned("box", tmp_path, shape, R_WS, None, figures_of(shown))
    assert told["mass"] == pytest.approx(1.2) and told["mass_std"] == pytest.approx(0.05)
    assert told["by"] == {"mass": "partly", "centre": "from shape alone", "inertia": "from shape alone"}
    assert sorted(told["moments"]) == pytest.approx(1.2 / 12.0 * np.array([0.0052, 0.0116, 0.0136]), rel=1e-3)
    assert told["moments_std"] is None and read_known(tmp_path / "box").mass == pytest.approx(1.2)
    assert "mass_at_rest" not in figures_of(ShownObject())


@pytest.mark.parametrize(("slip", "mass_alone"), [((0.026, 0.2), False), ((0.036, 0.66), True), ((0.01, 0.66), True)])
def test_torques_of_what_slid_too_far_tell_its_mass_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, slip: tuple[float, float], mass_alone: bool
) -> None:
    """Of a bottle that slid by 36 mm and 38° a moment was told as 79 ± 23 % more than it is."""
    corners = box_triangles(0.06, 0.04, 0.1) + MIDDLE
    shape = ColouredSurface(corners, np.full((len(corners), 3, 2), 0.5), np.full((8, 8, 3), 200, np.uint8), 0.05, 0.001)
    by = dict.fromkeys(("mass", "centre", "inertia"), "measured")
    tensor = 0.7 / 12.0 * np.diag([0.0116, 0.0136, 0.0052])
    told = MeasuredInertia(0.7, MIDDLE + 0.01, tensor, 1e-3, np.full(3, 1e-3), np.full(6, 1e-6), by)
    for name, made in (
        ("read_shape", lambda folder: shape),
        ("read_swung", lambda file: SimpleNamespace(slip=slip)),
        ("inertia_of", lambda *rest: told),
    ):
        monkeypatch.setattr(finishing, name, made)
    record = LearningRecord(tmp_path, Scenario())
    one = Learned("box", figures={"mass_at_rest": 0.75, "not weighed": "of a first try"}, R_WS=R_WS.tolist())
    record.fresh("box")
    for file in (SHAPE, SWUNG):
        (record.of("box") / file).touch()
    model: Any = None
    finishing.finish(record, one, model)
    assert one.state == "finished" and one.figures["mass"] == pytest.approx(0.7)
    assert one.figures["mass_std"] == pytest.approx(1e-3) and one.figures["by"]["mass"] == "measured"
    assert one.figures["by"]["inertia"] == ("from shape alone" if mass_alone else "measured")
    assert ("slid by" in one.figures.get("not weighed", "")) == mass_alone
    assert (one.figures["moments_std"] is None) == mass_alone


def test_what_was_not_swung_has_its_centre_where_its_weight_was_felt(tmp_path: Path) -> None:
    """Felt along two axes of S; along the third one, where a wedge's own centre is beside its box's, shape tells."""
    triangles = box_triangles(0.06, 0.04, 0.1)
    triangles[:, :, 0] *= np.where(triangles[:, :, 2] > 0.0, 0.2, 1.0)  # narrow at one end: its centre is below
    corners = triangles + MIDDLE
    shape = ColouredSurface(corners, np.full((len(corners), 3, 2), 0.5), np.full((8, 8, 3), 200, np.uint8), 0.05, 0.001)
    even = write_learned("even", tmp_path, shape, R_WS, None, {})
    centre_S = -R_WS.T @ even["p_OS"]
    assert centre_S[2] < MIDDLE[2] - 0.008
    taken = Centre.within(corners.reshape(-1, 3))
    felt = Centre(MIDDLE + [0.009, -0.006, 0.0], np.diag([1e-6, 1e-6, taken.covariance[2, 2]]))
    shown = ShownObject(mass_at_rest=1.2, centre=felt)
    told = write_learned("felt", tmp_path, shape, R_WS, None, plain(figures_of(shown)))
    at = -R_WS.T @ told["p_OS"]
    assert at[:2] == pytest.approx(felt.mean[:2], abs=2e-4) and at[2] == pytest.approx(centre_S[2], abs=1e-4)
    assert told["by"]["centre"] == "partly" and sorted(told["centre_std"])[1] == pytest.approx(1e-3)


def test_what_no_picture_showed_is_marked_in_the_asset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Colours of what a finger hid are made up: they are marked from the atlas to `cloud.npz`, by way of the disk."""
    corners = box_triangles(0.06, 0.04, 0.1)
    hidden = (corners[:, :, 2] < 0.0).all(axis=1)
    uv = np.where(hidden[:, None, None], [0.25, 0.5], [0.75, 0.5]) * np.ones((1, 3, 1))
    blank = np.zeros((8, 8, 3), np.uint8)
    blank[:, :4] = 255
    found = SimpleNamespace(
        views=[],
        vertices=corners.reshape(-1, 3),
        faces=np.arange(3 * len(corners)).reshape(-1, 3),
        unseen=0.1,
        noise=0.0,
    )
    monkeypatch.setattr(backends, "reconstruct", lambda *told, **more: found)
    monkeypatch.setattr(backends, "lay_out", lambda count: SimpleNamespace(uv=uv))
    monkeypatch.setattr(backends, "textured", lambda *told: (np.full((8, 8, 3), 200, np.uint8), blank))
    monkeypatch.setattr(shape_worker, "TransformsFolder", lambda folder: SimpleNamespace(hands=()))
    make_shape(tmp_path)
    write_learned("box", tmp_path, read_shape(tmp_path), np.eye(3), None)
    asset = Asset.load(tmp_path / "box")
    assert asset.unpainted is not None
    bottom = asset.normals_O[:, 2] < -0.9
    assert asset.unpainted[bottom].mean() > 0.95 and asset.unpainted[~bottom].mean() < 0.05
