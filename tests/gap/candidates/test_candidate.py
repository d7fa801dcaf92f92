"""What a candidate may be, when it acts, and how errors of coefficients become those of parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin_diagram.gap.candidates.candidate import Candidate, linear, transformed
from twin_diagram.gap.candidates.merging import beside, least, multiplied, summed


def of(lower: list[float], upper: list[float]) -> Candidate:
    columns = np.arange(12.0).reshape(3, 2, 2)
    bounds = np.array(lower), np.array(upper)
    return Candidate("torque_bias", (0,), (), (0, 1), columns, np.ones(2), *bounds, linear("torque", "other"))


def test_bounds_are_held_by_every_coefficient_and_by_what_else_is_asked() -> None:
    candidate = of([-1.0, 0.0], [2.0, 3.0])
    for c, inside in (([-1, 0], True), ([2, 3], True), ([-1.1, 1], False), ([0, 3.1], False), ([0, -0.1], False)):
        assert candidate.allows(np.array(c, dtype=float)) == inside
    picky = replace(candidate, admits=lambda c: bool(c[0] > c[1]))
    assert picky.allows(np.array([2.0, 1.0]))
    assert not picky.allows(np.array([1.0, 2.0])) and not picky.allows(np.array([2.5, 1.0]))
    assert candidate.size == 2 and candidate.place == ("torque_bias", (0,), ())


def test_what_acts_for_a_while_has_no_torque_before_and_after() -> None:
    candidate = of([0.0, 0.0], [1.0, 1.0])
    during = candidate.during(np.array([0.0, 1.0, 0.5]), (0, 1.5), (1, 2.5))
    np.testing.assert_array_equal(during.columns, candidate.columns * np.array([0.0, 1.0, 0.5])[:, None, None])
    assert during.onset == (0, 1.5) and during.end == (1, 2.5)


def test_scaled_coefficients_have_scaled_errors() -> None:
    values = linear("a", "b", scale=-2.0)(np.array([1.0, -3.0]), np.array([[4.0, 1.0], [1.0, 9.0]]))
    assert values["a"] == (pytest.approx([-2.0]), pytest.approx([4.0]))
    assert values["b"] == (pytest.approx([6.0]), pytest.approx([6.0]))
    nothing = linear("a")(np.array([1.0]), np.array([[-1e-9]]))
    assert nothing["a"][1] == [0.0]


def test_errors_go_through_a_law_by_its_slopes() -> None:
    c = np.array([2.0, 3.0])
    covariance = np.array([[0.04, 0.01], [0.01, 0.09]])
    values = transformed(lambda x: {"product": np.array([x[0] * x[1], x[0] ** 2]), "sum": x[0:1] + x[1:2]})(
        c, covariance
    )
    slopes = np.array([[3.0, 2.0], [4.0, 0.0]])
    np.testing.assert_allclose(values["product"][0], [6.0, 4.0])
    np.testing.assert_allclose(values["product"][1], np.sqrt(np.diag(slopes @ covariance @ slopes.T)), rtol=1e-6)
    np.testing.assert_allclose(values["sum"][1], [np.sqrt(0.04 + 0.09 + 0.02)], rtol=1e-6)


def test_claimed_errors_of_a_law_cover_what_is_drawn() -> None:
    """Of a law that bends little within its error."""
    rng = np.random.default_rng(2)
    root = np.array([[0.02, 0.0], [0.03, 0.01]])
    law = transformed(lambda x: {"stiffness": 1.0 / x[0:1], "angle": x[1:2] / x[0:1]})
    _, claimed = zip(*law(np.array([2.0, 1.0]), root @ root.T).values(), strict=True)
    drawn = np.array([2.0, 1.0]) + rng.normal(size=(4000, 2)) @ root.T
    np.testing.assert_allclose(np.std(1.0 / drawn[:, 0]), claimed[0][0], rtol=0.05)
    np.testing.assert_allclose(np.std(drawn[:, 1] / drawn[:, 0]), claimed[1][0], rtol=0.05)


def test_differences_are_small_beside_the_error_that_they_are_for() -> None:
    """A law that turns sharply a tenth of its error away is differentiated on this side of it, about its middle."""
    law = transformed(lambda x: {"bent": np.where(np.abs(x) > 0.1, 100.0, 3.0) * x + x**2})
    values = law(np.array([0.0]), np.array([[1.0]]))
    assert values["bent"][1] == pytest.approx([3.0])
    known = transformed(lambda x: {"same": 5.0 * x})(np.array([1.0]), np.array([[0.0]]))
    assert known["same"][1] == pytest.approx([0.0])


def test_two_of_one_law_are_one() -> None:
    one, two = {"a": [3.0, 4.0], "b": [0.5]}, {"a": [1.0, 8.0], "b": [0.25]}
    assert summed(one, two) == {"a": [4.0, 12.0], "b": [0.75]}
    assert multiplied(one, two) == {"a": [3.0, 32.0], "b": [0.125]}
    assert least(one, two) == {"a": [1.0, 4.0], "b": [0.25]}
    assert beside(one, two) is None
