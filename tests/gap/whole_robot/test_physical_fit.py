"""Links' coordinates, and least squares over them that keep to bounds."""

from __future__ import annotations

import numpy as np

from tests.gap.made import ARM
from twin_diagram.gap.candidates.given_link import link_inertia
from twin_diagram.gap.whole_robot.physical_fit import bounded, independent
from twin_diagram.gap.whole_robot.physical_links import Links, parameters, slopes
from twin_diagram.model.effects.link_inertia import about_origin


def test_links_come_back_from_their_coordinates() -> None:
    links = Links.of(ARM)
    told = [about_origin(*link_inertia(ARM, link)) for link in ARM.tree.link]
    np.testing.assert_allclose(parameters(links.mean), told, atol=1e-9)
    assert np.all(links.heavy)


def test_any_coordinates_are_a_physical_link() -> None:
    rng = np.random.default_rng(1)
    for m, hx, hy, hz, xx, yy, zz, xy, xz, yz in parameters(rng.normal(size=(20, 10))):
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        pseudo = np.zeros((4, 4))
        pseudo[:3, :3], pseudo[3, 3] = 0.5 * np.trace(tensor) * np.eye(3) - tensor, m
        pseudo[:3, 3] = pseudo[3, :3] = hx, hy, hz
        assert np.linalg.eigvalsh(pseudo)[0] > 0.0


def test_slopes_are_those_of_the_parameters() -> None:
    z = np.random.default_rng(2).normal(size=(3, 10))
    for k in range(10):
        step = 1e-6 * np.eye(10)[k]
        difference = (parameters(z + step) - parameters(z - step)) / 2e-6
        np.testing.assert_allclose(slopes(z)[:, :, k], difference, atol=1e-7)


def test_steps_keep_to_bounds_and_the_rest_settles_anew() -> None:
    H, gradient = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([3.0, 0.0])
    free = np.ones(2, dtype=bool)
    np.testing.assert_allclose(bounded(H, gradient, np.full(2, -np.inf), free), [-2.0, 1.0])
    np.testing.assert_allclose(bounded(H, gradient, np.array([-1.0, -np.inf]), free), [-1.0, 0.5])
    np.testing.assert_allclose(bounded(H, gradient, np.full(2, -np.inf), np.array([True, False])), [-1.5, 0.0])


def test_samples_that_hang_together_count_less() -> None:
    noise = np.random.default_rng(3).normal(size=(4000, 1))
    gaps = np.arange(4000) == 0
    held = np.repeat(noise[:400], 10, axis=0)
    share = independent(np.hstack([noise, held]), gaps)
    assert 0.7 < share[0] <= 1.0
    assert 0.06 < share[1] < 0.15
