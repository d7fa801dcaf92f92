"""Ways in which mass may lie, and what torques make of them."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.estimation.weighing import Shape, ShapePrior, WeighingError
from twin_diagram.estimation.weighing.posterior import posterior
from twin_diagram.model.rigid_body.mass_properties import about_centre, inertia_of, is_physical, second_of, six_of


def only(shape: Shape, load: float, size: float = 0.1, wall: float = 0.0) -> ShapePrior:
    return ShapePrior(
        shape, loads=((load, 1.0),), load_sizes=((size, 1.0),), walls=((wall, 1.0),), plain=(0.0, 0.02), ends=(0.0, 0.3)
    )


def test_without_a_load_the_middle_is_even_mass(box: Shape) -> None:
    found = only(box, 0.0).hypotheses.parameters(np.array([[np.log(0.7), *np.zeros(9)]]))
    np.testing.assert_allclose(found[0], box.even(0.7), atol=1e-15)
    wall = only(box, 0.0, wall=1.0).hypotheses.parameters(np.zeros((1, 10)))
    np.testing.assert_allclose(six_of(second_of(about_centre(wall[0])[2])), six_of(box.shell_second), atol=1e-15)


def test_a_point_load_gives_the_exact_body(box: Shape, off_centre: np.ndarray) -> None:
    """40 % of 0.8 kg in one point, as `off_centre` is made."""
    u = np.array([[np.log(0.8), *(0.4 * np.array([0.01, -0.02, 0.05])), *np.zeros(6)]])
    np.testing.assert_allclose(only(box, 0.4, size=0.0).hypotheses.parameters(u)[0], off_centre, rtol=1e-12, atol=1e-15)


def test_a_load_of_some_size_adds_its_own_moments(box: Shape) -> None:
    found = only(box, 0.5, size=0.4).hypotheses.parameters(np.zeros((1, 10)))[0]
    np.testing.assert_allclose(
        about_centre(found)[2], inertia_of((0.5 + 0.5 * 0.16) * box.second), rtol=1e-12, atol=1e-15
    )


def test_small_parts_of_a_load_are_as_likely_anywhere(box: Shape) -> None:
    """Its middle and its own size together have the moments of the object."""
    prior = only(box, 0.5, size=0.6)
    loose = 0.25 * 0.64 * box.second + prior.centre_spread**2 * np.eye(3)
    np.testing.assert_allclose(prior.hypotheses.offset[0], loose, rtol=1e-12)


def test_any_coordinates_are_a_body(box: Shape) -> None:
    hypotheses = ShapePrior(box).hypotheses
    u = 3.0 * np.random.default_rng(0).normal(size=(20, len(hypotheses), 10))
    assert all(is_physical(p) for p in hypotheses.parameters(u).reshape(-1, 10))


def test_e_scales_second_moments_along_the_axes(box: Shape) -> None:
    u = np.zeros((1, 10))
    u[0, 5] = np.log(2.0)
    found = only(box, 0.0).hypotheses.parameters(u)[0]
    expected = box.second * np.array([1.0, 2.0, 1.0])[:, None] ** 0.5 * np.array([1.0, 2.0, 1.0]) ** 0.5
    np.testing.assert_allclose(second_of(about_centre(found)[2]), expected, atol=1e-15)


def test_half_a_box_filled_is_found_among_denser_ends(box: Shape) -> None:
    """The lower half alone, d = edge / 4: Σ about the middle stays, so a quarter of it is left along that axis."""
    ends = ShapePrior(box, ends=(1.0, 0.3), walls=((0.0, 1.0),)).hypotheses
    assert len(ends) == 1
    assert ends.by_load[0] < 0.0
    u = np.zeros((len(ends), 10))
    u[:, 3] = -0.175 / 8.0  # as with three times the density there: exact but for r²
    second = second_of(about_centre(ends.parameters(u))[2])[ends.by_load < 0.0][0]
    exact = np.diag(box.second).copy()
    exact[2] -= (0.175 / 8.0) ** 2
    np.testing.assert_allclose(np.diag(second), exact, rtol=0.01)
    np.testing.assert_allclose(np.diag(ends.offset[ends.by_load < 0.0][0]), 0.09 * np.diag(box.second) + 1.5e-3**2)
    np.testing.assert_allclose(ends.information[0, 4, 4], 1.0 / (2.5 * 0.06) ** 2)
    np.testing.assert_allclose(ends.information[0, 9, 9], 2.0 / (2.5 * 0.06) ** 2)
    far = u.copy()
    far[:, 3] = 10.0
    assert all(is_physical(p) for p in ends.parameters(far)[ends.by_load < 0.0])


def test_no_load_leaves_the_box(box: Shape) -> None:
    prior = only(box, 0.4, size=0.25)
    hypotheses = prior.hypotheses
    reach = 0.4 * 0.75 * 0.0875 + 2.0 * prior.centre_spread
    np.testing.assert_allclose(hypotheses.most[0, 2], reach)
    u = np.zeros((3, 1, 10))
    u[:, 0, 3] = np.array([0.99, 1.1, 1.2]) * reach
    np.testing.assert_allclose(hypotheses.outside(u)[:, 0], [0.0, 0.5, 2.0], atol=1e-9)


def test_drawn_bodies_lie_where_the_prior_says(box: Shape) -> None:
    prior = only(box, 0.4)
    mass, centre, _ = about_centre(prior.hypotheses.drawn(0.9, 20000, np.random.default_rng(0)))
    np.testing.assert_allclose(mass, 0.9)
    expected = 0.16 * (1.0 - 0.01) * np.diag(box.second) + prior.centre_spread**2
    np.testing.assert_allclose(np.var(centre, axis=0), expected, rtol=0.05)
    even = only(box, 0.0).hypotheses.drawn(1.0, 20000, np.random.default_rng(1))
    second = second_of(about_centre(even)[2])
    L = np.sqrt(np.diag(box.second))
    relative = second / np.outer(L, L)
    np.testing.assert_allclose(np.std(relative[:, 0, 0]), 0.06, rtol=0.06)
    np.testing.assert_allclose(np.std(relative[:, 0, 1]), 0.06 / np.sqrt(2.0), rtol=0.06)


def test_sharp_torques_decide_alone(box: Shape, off_centre: np.ndarray) -> None:
    matrix = np.diag(1.0 / np.maximum(1e-5 * np.abs(off_centre), 1e-9) ** 2)
    for prior in (ShapePrior(box), ShapePrior.none(box)):
        found = posterior(matrix, matrix @ off_centre, prior.hypotheses, 0.5)
        np.testing.assert_allclose(found.mean, off_centre, rtol=2e-4, atol=2e-8)


def test_mass_and_centre_alone_find_a_load(box: Shape, off_centre: np.ndarray) -> None:
    """Torques that tell mass and centre but no inertia: what is off the centre says of the inertia what a load does."""
    matrix = np.diag([1e8, *3 * [1e9], *6 * [1e-3]])
    prior = ShapePrior(box, plain=(0.0, 0.02), ends=(0.0, 0.3))
    found = posterior(matrix, matrix @ off_centre, prior.hypotheses, 0.5)
    np.testing.assert_allclose(found.mean[:4], off_centre[:4], atol=2e-4)
    even = prior.hypotheses.by_load == 0.0
    assert found.weights[even].sum() < 1e-6
    assert found.weights.sum() == pytest.approx(1.0)

    def worst(parameters: np.ndarray) -> float:
        true, told = (np.linalg.eigvalsh(about_centre(p)[2]) for p in (off_centre, parameters))
        return float(np.max(np.abs(told / true - 1.0)))

    assert worst(found.mean) < 0.85 * worst(box.even(0.8))
    assert found.covariance[9, 9] > 0.0


def test_torques_that_say_nothing_leave_the_prior(box: Shape) -> None:
    matrix = np.diag([1e8, *9 * [1e-9]])
    found = posterior(matrix, matrix @ box.even(0.6), only(box, 0.3).hypotheses, 0.5)
    drawn = only(box, 0.3).hypotheses.drawn(0.6, 20000, np.random.default_rng(0))
    np.testing.assert_allclose(found.mean[0], 0.6, rtol=1e-3)
    np.testing.assert_allclose(np.std(found.bodies[:, 1:4], axis=0), np.std(drawn[:, 1:4], axis=0), rtol=0.1)


def test_where_torques_do_not_tell_the_wall_it_is_not_half_of_one(box: Shape) -> None:
    """Mass and centre alone: of what is even the moments are those of even mass, not those between it and a shell's."""
    even = box.even(0.2)
    matrix = np.diag([1e8, *3 * [1e10], *6 * [1e-3]])
    prior = ShapePrior(box, walls=((0.0, 0.6), (0.35, 0.2), (1.0, 0.2)))
    found = posterior(matrix, matrix @ even, prior.hypotheses, 0.5)
    expected = np.linalg.eigvalsh(about_centre(even)[2])
    np.testing.assert_allclose(np.linalg.eigvalsh(about_centre(found.mean)[2]), expected, rtol=0.05)
    # That it may be a shell after all is in what is told of the errors.
    all_alike = np.linalg.eigvalsh(about_centre(found.bodies.mean(axis=0))[2])
    assert (np.sqrt(np.diag(found.covariance)[[4, 5, 6]]) > 0.15 * expected.min()).all()
    assert (all_alike > 1.05 * expected).all()


def test_one_material_is_a_way_of_its_own(box: Shape) -> None:
    """Half of what is even without a load: its E is that of a reconstruction's errors."""
    prior = ShapePrior(box, ends=(0.0, 0.3), plain=(0.4, 0.01))
    plain, without = prior.hypotheses, ShapePrior(box, ends=(0.0, 0.3), plain=(0.0, 0.01)).hypotheses
    assert len(plain) == len(without) + 1
    weights, narrow = np.exp(plain.log_weight), plain.spread == 0.01
    even = (plain.by_load == 0.0) & (plain.wall == 0.0)
    assert narrow.sum() == 1 and even[narrow].all()
    assert weights[narrow].sum() == pytest.approx(0.4 * weights[even].sum())
    assert weights[even].sum() == pytest.approx(
        np.exp(without.log_weight)[(without.by_load == 0) & (without.wall == 0)]
    )


def test_torques_tell_a_shell(box: Shape) -> None:
    shell = only(box, 0.0, wall=1.0).hypotheses.parameters(np.array([[np.log(0.4), *np.zeros(9)]]))[0]
    matrix = np.diag(1.0 / np.maximum(0.02 * np.abs(shell), 1e-6) ** 2)
    found = posterior(matrix, matrix @ shell, ShapePrior(box).hypotheses, 0.5)
    moments, expected = (np.linalg.eigvalsh(about_centre(p)[2]) for p in (found.mean, shell))
    np.testing.assert_allclose(moments, expected, rtol=0.05)


def test_what_is_no_prior_is_refused(box: Shape) -> None:
    with pytest.raises(WeighingError, match="spreads must be positive"):
        ShapePrior(box, spread=0.0)
    with pytest.raises(WeighingError, match="load's share"):
        ShapePrior(box, loads=((1.0, 1.0),))


def test_a_small_load_does_not_account_for_a_centre_that_it_cannot_reach(box: Shape) -> None:
    """18 mm above the middle: 13 % of the mass would have to lie above the lid for that, 60 % need not."""
    hypotheses = ShapePrior(
        box, loads=((0.13, 0.5), (0.6, 0.5)), load_sizes=((0.1, 1.0),), walls=((0.0, 1.0),), plain=(0.0, 0.02),
        ends=(0.0, 0.3),
    ).hypotheses  # fmt: skip
    told = hypotheses.parameters(np.tile([np.log(0.8), 0.0, 0.0, 0.018, *np.zeros(6)], (2, 1)))[1]
    matrix = np.diag([1e8, *[1e10] * 3, *[0.0] * 6])  # mass and centre alone are measured
    assert hypotheses.most[0, 2] < 0.015
    assert posterior(matrix, matrix @ told, hypotheses, 0.5).weights[0] < 0.01
