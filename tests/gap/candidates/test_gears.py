"""Candidates of gears are the torque of the model with such a gear; what they cost, and what is searched of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.gap.made import ARM, ELBOW, PAN, law, swinging, terms_of, told, torque, worn
from twin_diagram.gap.candidates.gears import GearShape, gear, rattled, rebuilt
from twin_diagram.gap.candidates.records import record_of
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.residuals.regressors import Terms

SPRING = (("stiffness", 4000.0), ("loss", 5e-3))
PLAY = (("gap", 0.02),)


@pytest.mark.parametrize(("name", "values"), [("joint_elasticity", SPRING), ("backlash", PLAY)])
def test_the_torque_of_a_shape_is_the_laws(name: str, values: tuple[tuple[str, float], ...]) -> None:
    terms = swinging()
    candidate = gear(terms, GearShape(name, PAN, values))
    assert candidate is not None and candidate.variant == "swinging" and candidate.rows == tuple(range(6))
    wanted = law(terms, candidate, {key: np.array([x]) for key, x in (*values, ("rotor_inertia", 0.0))})
    found = torque(terms, candidate, np.array([1.0, 0.0]))
    assert np.linalg.norm(found - wanted) < 1e-6 * np.linalg.norm(wanted)
    rate = terms.records.reduce(lambda r: r.a)
    rotor = torque(terms, candidate, np.array([0.0, 1.0]))
    np.testing.assert_allclose(rotor[:, PAN], rate[:, PAN])
    assert not np.any(rotor[:, 1:])
    size = np.sqrt(np.mean(rate[:, PAN] ** 2))
    np.testing.assert_allclose(candidate.spread, [1.0, terms.torque_size[PAN] / size])
    values_told = told(candidate, np.array([1.0, 0.3]))
    assert set(values_told) == {values[0][0], "rotor_inertia"} and values_told["rotor_inertia"] == [0.3]
    assert told(candidate, np.array([1.0, -0.3]))["rotor_inertia"] == [0.0]
    assert candidate.shape == dict(values)


def test_a_shape_fits_as_it_stands_or_is_wrong() -> None:
    candidate = gear(swinging(), GearShape("backlash", PAN, PLAY))
    assert candidate is not None
    for share, inside in ((0.59, False), (0.61, True), (1.49, True), (1.51, False)):
        assert candidate.allows(np.array([share, 0.0])) == inside
    there = gear(worn(), GearShape("backlash", PAN, PLAY))
    assert there is not None
    for rotor, inside in ((-0.524, True), (-0.526, False)):
        assert there.allows(np.array([1.0, rotor])) == inside


def test_what_cannot_be_is_no_candidate() -> None:
    terms = swinging()
    kinds = record_of("joint_elasticity").effect.kinds
    low = kinds["stiffness"].lower
    assert gear(terms, GearShape("joint_elasticity", PAN, (("stiffness", low - 1.0), ("loss", 0.0)))) is None
    assert gear(terms, GearShape("backlash", PAN, (("gap", -1e-3),))) is None


def test_the_search_for_a_shape_has_its_price() -> None:
    terms = swinging()
    spring, play = (gear(terms, GearShape(*x)) for x in (("joint_elasticity", PAN, SPRING), ("backlash", PAN, PLAY)))
    assert spring is not None and spring.cost == 8.0
    assert play is not None and play.cost == 3.0


def shaken(share: float, count: int = 1) -> Terms:
    record = replace(swinging().records.records[0], shaken=np.full(6, share))
    return terms_of(Records(ARM, (record,) * count))


@pytest.mark.parametrize("share", [0.4, 1.0, 3.0])
def test_an_encoders_noise_may_bring_a_gear_its_share_of_the_band(share: float) -> None:
    """x/(1 + x) of half the samples; x grows with the frequency's fourth power, up to 1.25 times the band."""
    excess = share**2 - 0.3**2
    mean = float(np.mean([excess * u**4 / (1.0 + excess * u**4) for u in np.linspace(0.0, 1.25, 40)]))
    samples = len(swinging().records.residual)
    assert rattled(shaken(share), PAN) == pytest.approx(0.5 * samples * mean)
    assert rattled(shaken(share, 2), PAN) == pytest.approx(2.0 * rattled(shaken(share), PAN))
    assert rattled(shaken(0.2), PAN) == 0.0
    candidate = gear(shaken(share), GearShape("backlash", PAN, PLAY))
    assert candidate is not None and candidate.cost == pytest.approx(3.0 + rattled(shaken(share), PAN))


def test_shapes_are_searched_about_what_was_found() -> None:
    terms = swinging()
    play, spring = (
        gear(terms, GearShape("backlash", PAN, PLAY)),
        gear(terms, GearShape("joint_elasticity", ELBOW, SPRING)),
    )
    assert play is not None and spring is not None
    of_play, of_spring = record_of("backlash").shapes, record_of("joint_elasticity").shapes
    assert of_play is not None and of_spring is not None
    assert of_play(terms, play) == [("gap", 0.6, 1.7)]
    ratios = [("stiffness", 0.75, 1.33), ("loss", 0.25, 4.0), ("stiffness", 0.93, 1.07)]
    assert of_spring(terms, spring) == ratios
    assert of_spring(terms, replace(spring, variant="")) == []
    again = rebuilt(terms, spring, "stiffness", 3000.0)
    assert again is not None and again.shape == {"stiffness": 3000.0, "loss": 5e-3} and again.joints == (ELBOW,)
