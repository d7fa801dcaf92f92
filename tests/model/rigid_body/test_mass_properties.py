"""Mass, centre and second moments against closed forms and Drake's spatial inertia."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.multibody.tree import SpatialInertia

from twin_diagram.model.rigid_body.mass_properties import (
    about_centre,
    inertia_of,
    is_physical,
    parameters_of,
    second_of,
    six_of,
    tensors,
)
from twin_diagram.model.rigid_body.rigid_tree import inertia_vector, transform_inertia


def test_a_box_has_the_inertia_of_textbooks() -> None:
    edges = np.array([0.1, 0.2, 0.3])
    inertia = inertia_of(2.0 * np.diag(edges**2) / 12.0)
    expected = 2.0 / 12.0 * np.array([0.2**2 + 0.3**2, 0.1**2 + 0.3**2, 0.1**2 + 0.2**2])
    np.testing.assert_allclose(np.diag(inertia), expected, rtol=1e-12)
    np.testing.assert_allclose(second_of(inertia), 2.0 * np.diag(edges**2) / 12.0, atol=1e-15)


def test_parameters_are_those_of_drake() -> None:
    random = np.random.default_rng(0)
    root = random.normal(size=(3, 3))
    mass, centre, second = 1.3, np.array([0.1, -0.2, 0.05]), 0.01 * (root @ root.T)
    I = inertia_of(second)  # noqa: E741
    unit = SpatialInertia.MakeFromCentralInertia(mass, centre, _rotational(I))
    np.testing.assert_allclose(
        parameters_of(np.array(mass), centre, second), inertia_vector(unit, RigidTransform()), atol=1e-14
    )


def _rotational(tensor: np.ndarray) -> object:
    from pydrake.multibody.tree import RotationalInertia

    xx, yy, zz, xy, xz, yz = six_of(tensor)
    return RotationalInertia(Ixx=xx, Iyy=yy, Izz=zz, Ixy=xy, Ixz=xz, Iyz=yz)


def test_about_centre_undoes_parameters_and_does_not_see_where_the_origin_is() -> None:
    random = np.random.default_rng(1)
    root = random.normal(size=(4, 3, 3))
    second = root @ root.transpose(0, 2, 1)
    mass, centre = random.uniform(0.5, 2.0, 4), random.normal(size=(4, 3))
    many = parameters_of(mass, centre, second)
    found = about_centre(many)
    np.testing.assert_allclose(found[0], mass)
    np.testing.assert_allclose(found[1], centre)
    np.testing.assert_allclose(found[2], inertia_of(second), atol=1e-12)
    shifted = transform_inertia(RigidTransform([0.3, -0.1, 0.2])) @ many[0]
    np.testing.assert_allclose(about_centre(shifted)[2], found[2][0], atol=1e-12)
    np.testing.assert_allclose(about_centre(shifted)[1], centre[0] + [0.3, -0.1, 0.2])


def test_six_numbers_stand_for_a_symmetric_matrix() -> None:
    six = np.arange(12.0).reshape(2, 6)
    np.testing.assert_array_equal(six_of(tensors(six)), six)
    assert tensors(six[0])[0, 1] == 3.0 == tensors(six[0])[1, 0]
    assert tensors(six[0])[1, 2] == 5.0


@pytest.mark.parametrize("spoil", [(0, -1.0), (0, np.nan), (4, -0.01), (6, 1.0)])
def test_what_no_mass_gives_is_not_physical(spoil: tuple[int, float]) -> None:
    body = parameters_of(np.array(1.0), np.array([0.1, 0.0, 0.0]), 0.001 * np.eye(3))
    assert is_physical(body)
    body[spoil[0]] = spoil[1]
    assert not is_physical(body)
