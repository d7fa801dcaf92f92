"""Links' coordinates, and least squares over them that keep to bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.gap.made import ARM, ELBOW
from tests.gap.whole_robot.test_unusual import problem
from twin_diagram.gap.candidates.given_link import link_inertia
from twin_diagram.gap.whole_robot.bounded_step import bounded, solved
from twin_diagram.gap.whole_robot.independent_samples import independent
from twin_diagram.gap.whole_robot.physical_fit import solve
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


def test_what_is_held_is_in_the_residual_and_the_rest_is_as_if_all_were_worked_out() -> None:
    """Least squares over what moves alone: no gradient is left there, and the cost is that of joints' squares."""
    start = problem()
    some = replace(start, links_free=np.arange(6) == ELBOW)
    total = some.sums.whole - some.sums.of_kinds[0]
    z = solve(some, total)
    assert np.all(z[~some.free] == some.mean[~some.free]) and np.any(z[some.free] != some.mean[some.free])
    H, gradient = some.system(z, total)
    inside = some.free & (z > some.lower)
    assert np.max(np.abs(gradient[inside]) / np.sqrt(np.diag(H)[inside])) < 1e-2
    off = z - some.mean
    squares = float(np.sum(some.share / some.variance * some.squares(z, total)))
    np.testing.assert_allclose(some.cost(z, total), 0.5 * (squares + off @ some.precision @ off), rtol=1e-9)
    np.testing.assert_allclose(some.forms_without[0], some.form(total), atol=1e-9 * np.max(some.form(total)))


def test_stretches_pull_as_all_motion_does() -> None:
    start = problem()
    z = start.mean + 0.1 * start.deviation * np.cos(np.arange(len(start.mean)))
    _, gradient = start.system(z, start.sums.whole)
    prior = start.precision @ (z - start.mean)
    np.testing.assert_allclose(np.sum(start.pulls(z), axis=0), gradient - prior, atol=1e-9 * np.max(np.abs(gradient)))


def test_a_matrix_that_rounding_leaves_no_square_is_solved_all_the_same() -> None:
    nearly = np.array([[1.0, 1.0], [1.0, 1.0 - 1e-15]])
    np.testing.assert_allclose(nearly @ solved(nearly, np.ones(2)), np.ones(2), atol=1e-9)
