"""An asset whose inertia was measured: O at the centre that was, errors beside, the same body in three readers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twin_diagram.assets.asset import Asset
from twin_diagram.assets.building.from_mesh import AssetPlace, build_from_triangles
from twin_diagram.assets.building.inertia import solid_of
from twin_diagram.assets.building.measured import MeasuredInertia, from_shape_alone
from twin_diagram.assets.building.surface import weld
from twin_diagram.assets.description import read_spec
from twin_diagram.assets.shapes import angle
from twin_diagram.errors import AssetError

CENTRE = np.array([0.03, 0.004, 0.05])
INERTIA = np.array([[4e-4, 2e-5, -1e-5], [2e-5, 6e-4, 3e-5], [-1e-5, 3e-5, 5e-4]])
BY = {"mass": "measured", "centre": "partly", "inertia": "from shape alone"}


def measured() -> MeasuredInertia:
    return MeasuredInertia(0.62, CENTRE, INERTIA, 0.003, np.array([1e-3, 2e-3, 3e-3]), np.arange(1, 7) * 1e-6, BY)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    mesh = angle((0.08, 0.11), 0.045, 0.03).mesh
    place = AssetPlace("thing", tmp_path_factory.mktemp("library"), measured=measured())
    texture = np.full((8, 8, 3), 128, np.uint8)
    return build_from_triangles(mesh.vertices[mesh.faces], mesh.uv[mesh.faces], texture, place, "frames").folder


def test_the_origin_is_the_centre_that_was_measured(folder: Path) -> None:
    spec, asset = read_spec(folder), Asset.load(folder)
    assert spec.origin == pytest.approx(CENTRE.tolist()) and asset.mass == 0.62
    # The L reaches from the origin of its own frame to 8 × 11 cm.
    assert asset.points_O.min(axis=0) == pytest.approx(np.array([0.0, -0.0225, 0.0]) - CENTRE, abs=2e-3)
    assert spec.inertial_by == BY and spec.mass_std == 0.003 and spec.centre_std == [1e-3, 2e-3, 3e-3]


def test_drake_and_mujoco_read_the_same_body(folder: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant

    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(folder / "model.sdf"))
    plant.Finalize()
    body = plant.GetBodyByName("object")
    inertia = body.default_spatial_inertia()
    assert inertia.get_mass() == pytest.approx(0.62) and inertia.get_com() == pytest.approx(np.zeros(3), abs=1e-9)
    assert inertia.CalcRotationalInertia().CopyToFullMatrix3() == pytest.approx(INERTIA, abs=1e-9)
    model = mujoco.MjModel.from_xml_path(str(folder / "model.xml"))
    assert model.body_mass[1] == pytest.approx(0.62) and model.body_ipos[1] == pytest.approx(np.zeros(3), abs=1e-9)
    assert np.sort(model.body_inertia[1]) == pytest.approx(np.linalg.eigvalsh(INERTIA), rel=1e-6)
    # Two legs: two pieces at least, and the surface is only seen.
    assert model.ngeom >= 3 and model.geom_contype.sum() == model.ngeom - 1


def test_a_measurement_turns_with_its_frame() -> None:
    a = 0.7
    R = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    turned = measured().turned(R)
    assert turned.centre == pytest.approx(R @ CENTRE) and turned.inertia == pytest.approx(R @ INERTIA @ R.T)
    quarter = measured().turned(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]))
    # x and y change places: so do their errors.
    assert quarter.centre_std == pytest.approx([2e-3, 1e-3, 3e-3])
    assert quarter.inertia_std == pytest.approx(np.array([2, 1, 3, 4, 6, 5]) * 1e-6)


def test_errors_of_a_turned_inertia_are_those_of_many_that_are_turned() -> None:
    R = Rotation.from_rotvec([0.5, -0.8, 0.4]).as_matrix()
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((200_000, 6)) * measured().inertia_std
    errors = noise[:, [0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(-1, 3, 3)  # xx yy zz xy xz yz
    turned = (R @ errors @ R.T)[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    assert measured().turned(R).inertia_std == pytest.approx(turned.std(axis=0), rel=0.01)
    known = replace(measured(), inertia_std=np.array([1e-6, 1e-6, np.inf, 1e-6, np.inf, np.inf]))
    about_z = known.turned(Rotation.from_rotvec([0, 0, 0.3]).as_matrix()).inertia_std
    assert np.isfinite(about_z).tolist() == [True, True, False, True, False, False]


def test_errors_that_know_of_each_other_do_so_in_other_axes() -> None:
    R, R_back = Rotation.from_rotvec([0.0, 0.0, 0.8]).as_matrix(), Rotation.from_rotvec([0.0, 0.0, -0.8]).as_matrix()
    # A mass that is off by a share takes all of the inertia along.
    six = np.array([INERTIA[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))])
    std, shared = 0.1 * np.abs(six), 0.01 * np.outer(six, six)
    known = replace(measured(), inertia_std=std, inertia_covariance=shared)
    turned = known.turned(R)
    want = np.array([turned.inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))])
    assert turned.inertia_std == pytest.approx(0.1 * np.abs(want))
    assert known.turned(R).turned(R_back).inertia_std == pytest.approx(std)
    assert measured().turned(R).turned(R_back).inertia_std == pytest.approx(measured().inertia_std)
    assert measured().turned(R).turned(R_back).centre_std == pytest.approx(measured().centre_std)


@pytest.mark.parametrize("inertia", [np.diag([1e-4, 1e-4, 3e-4]), np.diag([-1e-4, 1e-4, 1e-4])])
def test_what_no_body_has_is_refused(inertia: np.ndarray) -> None:
    with pytest.raises(AssetError, match="no body"):
        MeasuredInertia(0.5, CENTRE, inertia, 0.1, np.ones(3), np.ones(6), BY)


def test_from_shape_alone_is_an_even_body_of_unknown_error() -> None:
    mesh = angle((0.08, 0.11), 0.045, 0.03).mesh
    found = from_shape_alone(solid_of(weld(mesh.vertices[mesh.faces])), 1000.0)
    # Two boxes: 8 × 4.5 × 3 and 3 × 4.5 × 8 cm.
    assert found.mass == pytest.approx(0.216) and not np.isfinite(found.mass_std)
    assert found.centre == pytest.approx([0.0275, 0.0, 0.0425])
    assert set(found.by.values()) == {"from shape alone"}
