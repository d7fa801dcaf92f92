"""Coordinates of effects, their priors and bounds; what effects of one law at one place are together."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tests.gap.made import ARM, effect
from twin_diagram.errors import ModelError
from twin_diagram.gap.candidates.given_link import link_inertia
from twin_diagram.gap.correction.merge_effects import is_less, merged
from twin_diagram.gap.correction.physical_coordinates import Coordinates, _physical, from_log_cholesky, log_cholesky
from twin_diagram.model.effects import Effect
from twin_diagram.scenario import EffectSpec

Array = npt.NDArray[np.float64]

A, B = ARM.joints[:2]
LINK = ARM.tree.link[2]


def spec(name: str, joints: list[str] | None = None, links: list[str] | None = None, **values: Any) -> EffectSpec:
    parameters = {key: np.atleast_1d(np.array(value, dtype=float)).tolist() for key, value in values.items()}
    return EffectSpec(name, joints if joints is not None else [A], links or [], parameters)


def of(what: EffectSpec) -> Coordinates:
    return Coordinates.of(ARM, what)


def test_a_links_inertia_goes_to_free_coordinates_and_back() -> None:
    mass, centre, inertia = link_inertia(ARM, LINK)
    vector = log_cholesky(mass, centre, inertia)
    again = from_log_cholesky(vector)
    assert again[0] == pytest.approx(mass)
    np.testing.assert_allclose(again[1], centre, atol=1e-9)
    np.testing.assert_allclose(again[2], inertia, atol=1e-8)
    assert np.exp(2.0 * vector[3]) == pytest.approx(mass), "the mass is one coordinate's alone"
    for seed in range(20):
        m, c, i = from_log_cholesky(np.random.default_rng(seed).normal(size=10))
        xx, yy, zz, xy, xz, yz = i
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        assert m > 0.0 and moments[0] > 0.0 and moments[0] + moments[1] > moments[2]
        np.testing.assert_allclose(from_log_cholesky(log_cholesky(m, c, i))[2], i, rtol=1e-3, atol=1e-6)


def test_a_point_mass_has_coordinates_too() -> None:
    m, c, i = from_log_cholesky(log_cholesky(2.0, np.array([0.1, 0.2, -0.1]), np.zeros(6)))
    assert m == pytest.approx(2.0, rel=1e-3)
    np.testing.assert_allclose(c, [0.1, 0.2, -0.1], rtol=1e-3)
    assert np.max(np.abs(i)) < 1e-4
    wild = from_log_cholesky(np.concatenate([[99.0, -99.0, 0.0, 0.0], np.zeros(6)]))
    assert np.all(np.isfinite(wild[2]))


@pytest.mark.parametrize(("point", "moment", "still"), [([0.1, 0.0, -0.2], 0.0, "moment"), ([0.0] * 3, 2.0, "point")])
def test_a_force_is_refined_with_its_point_or_with_a_moment(point: list[float], moment: float, still: str) -> None:
    """Not with both: about another point the same force has another moment."""
    push = of(spec("external_force", [], [LINK], wrench=[5.0, 0.0, 3.0, 0.0, moment, 0.0], point=point))
    moved = push.effect(push.start() + 1.0).parameters
    np.testing.assert_allclose(moved["wrench"][:3], [6.0, 1.0, 4.0])
    np.testing.assert_allclose(moved["wrench"][3:], np.array([0.0, moment, 0.0]) + (still != "moment"))
    np.testing.assert_allclose(moved["point"], np.array(point) + (still != "point"))


def test_an_inertia_that_cannot_be_goes_as_far_as_it_can() -> None:
    present = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    fine = np.array([1.0, 1.5, 2.0, 0.1, 0.0, 0.0])
    np.testing.assert_array_equal(_physical(fine, present), fine)
    found = _physical(np.array([1.0, 1.0, 4.0, 0.0, 0.0, 0.0]), present)
    np.testing.assert_allclose(found, [1.0, 1.0, 1.0 + 3.0 * 0.3, 0.0, 0.0, 0.0])
    negative = _physical(np.array([-1.0, 1.0, 1.0, 0.0, 0.0, 0.0]), present)
    np.testing.assert_allclose(negative, [0.1, 1.0, 1.0, 0.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_array_equal(_physical(-present, np.zeros(6)), np.zeros(6))


def test_a_link_is_refined_about_the_given_one() -> None:
    mass, centre, inertia = link_inertia(ARM, LINK)
    more = {"mass": 0.3, "com": [0.01, 0.0, -0.02], "inertia": [0.01, 0.01, 0.01, 0.0, 0.0, 0.0]}
    part = of(spec("inertial_parameters", [], [LINK], **more))
    back = part.effect(part.start()).parameters
    for key, value in more.items():
        np.testing.assert_allclose(back[key], np.atleast_1d(value), atol=1e-8)
    mean, spread = part.prior()
    np.testing.assert_allclose(mean, log_cholesky(mass, centre, inertia))
    np.testing.assert_allclose(spread, [0.5] * 4 + [0.5 * np.exp(np.mean(mean[:4]))] * 6)
    lost = of(spec("inertial_parameters", [], [LINK], mass=-2.0 * mass, com=[0.0] * 3, inertia=[0.0] * 6))
    assert lost.effect(lost.start()).parameters["mass"][0] == pytest.approx(-0.95 * mass)
    plain = of(spec("inertial_parameters", [], [LINK], mass=0.1))
    np.testing.assert_allclose(plain.effect(plain.start()).parameters["com"], np.zeros(3), atol=1e-8)


def test_logarithms_where_size_matters_and_wide_priors() -> None:
    """Ten times the rough value, a tenth at least; a factor of e where a logarithm is known, more where it is not."""
    part = of(spec("stribeck_friction", coulomb=3.0, static=4.0, stribeck_velocity=0.1))
    np.testing.assert_allclose(part.start(), [3.0, 4.0, np.log(0.1)])
    mean, spread = part.prior()
    np.testing.assert_array_equal(mean, part.start())
    np.testing.assert_allclose(spread, [30.0, 40.0, 1.0])
    small = of(spec("coulomb_friction", [A, B], torque=[0.03, 0.04]))
    np.testing.assert_allclose(small.prior()[1], [1.0, 1.0])
    two = of(spec("coulomb_friction", [A, B], torque=[0.3, 0.4]))
    np.testing.assert_allclose(two.prior()[1], [5.0, 5.0])
    spring = of(spec("joint_elasticity", stiffness=4000.0, rotor_inertia=0.2))
    assert set(spring.spec.parameters) == {"stiffness", "rotor_inertia", "loss"}
    mean, spread = spring.prior()
    where = list(spring.spec.parameters).index("loss")
    default = spring.spec.parameters["loss"][0]
    assert mean[where] == pytest.approx(np.log(default)) and spread[where] == 1.5
    nothing = of(spec("stribeck_friction", coulomb=3.0, static=4.0, stribeck_velocity=1e-12))
    assert nothing.start()[2] == pytest.approx(np.log(1e-9))


def test_a_curves_angles_stay() -> None:
    part = of(spec("joint_spring", curve=[-1.0, 0.0, 1.0, 5.0, 6.0, 7.0]))
    np.testing.assert_array_equal(part.start(), [5.0, 6.0, 7.0])
    moved = part.effect(np.array([1.0, 2.0, 3.0])).parameters["curve"]
    assert moved == [-1.0, 0.0, 1.0, 1.0, 2.0, 3.0]


def test_the_point_that_a_wrench_is_told_about_stays() -> None:
    wrench = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    spec = EffectSpec("external_force", [], ["hand"], {"wrench": wrench, "point": [0.0, 0.1, 0.0]}, onset=1.0, end=2.0)
    part = Coordinates.of(ARM, spec)
    np.testing.assert_array_equal(part.start(), wrench)
    assert all(len(x) == 6 for x in part.prior())
    moved = part.effect(part.start() + 1.0).parameters
    assert moved["point"] == [0.0, 0.1, 0.0] and moved["wrench"][0] == 2.0


@pytest.mark.parametrize(
    ("part", "vector", "values"),
    [
        (spec("torque_constant", gain=0.8), [0.1], {"gain": [0.4]}),
        (spec("torque_constant", gain=0.8), [0.41], {"gain": [0.41]}),
        (spec("coulomb_friction", torque=2.0), [-1.0], {"torque": [-1.0]}),
        (spec("time_delay", [], delay=0.01), [-0.5], {"delay": [0.0]}),
        (spec("backlash", gap=0.02, rotor_inertia=0.1), [-1.0, -0.2], {"gap": [0.0], "rotor_inertia": [-0.2]}),
    ],
)
def test_values_stay_within_bounds_where_they_are_no_differences(
    part: EffectSpec, vector: list[float], values: dict[str, list[float]]
) -> None:
    found = of(part).effect(np.array(vector)).parameters
    for key, value in values.items():
        assert found[key] == pytest.approx(value), key


def test_times_go_along() -> None:
    timed = replace(spec("torque_bias", torque=1.0), onset=2.0, end=3.0, log="x")
    part = of(timed)
    assert (part.when.onset, part.when.end) == (2.0, 3.0)
    again = part.started(spec("torque_bias", torque=9.0))
    assert again.spec.parameters["torque"] == [9.0] and (again.spec.onset, again.spec.end, again.spec.log) == (
        2.0,
        3.0,
        "x",
    )
    later = part.at(replace(part.when, onset=2.5))
    assert later.spec.onset == 2.5 and later.spec.end == 3.0 and later.when.onset == 2.5


def values(effects: list[Effect]) -> list[tuple[str, tuple[str, ...], dict[str, list[float]]]]:
    return [(e.name, e.joints, {key: x.value.tolist() for key, x in e.parameters.items()}) for e in effects]


def test_what_is_on_one_joint_adds_up_there_alone() -> None:
    there = effect("viscous_friction", [A, B], damping=[2.0, 3.0])
    found = values(merged([there], [spec("viscous_friction", [B], damping=0.5)]))
    wanted = [("viscous_friction", (A,), {"damping": [2.0]}), ("viscous_friction", (B,), {"damping": [3.5]})]
    assert sorted(found, key=lambda one: one[2]["damping"]) == wanted
    both = merged([there], [spec("viscous_friction", [A, B], damping=[-1.0, -3.0])])
    assert values(both) == [("viscous_friction", (A,), {"damping": [1.0]})], "what is nothing is left out"
    apart = merged([there], [spec("coulomb_friction", [A], torque=1.0)])
    assert len(apart) == 2
    with pytest.raises(ModelError):
        ARM.with_effects(merged([there], [spec("viscous_friction", [A], damping=-2.5)]))


def test_a_loss_from_a_time_on_ends_what_was_and_starts_what_is_left() -> None:
    there = effect("viscous_friction", [A], damping=2.0)
    worn = replace(spec("viscous_friction", [A], damping=-0.5), onset=3.0, log="x")
    before, after = merged([there], [worn])
    assert (before.when.onset, before.when.end, before.value("damping")[0]) == (None, 3.0, 2.0)
    assert (after.when.onset, after.when.end, after.value("damping")[0]) == (3.0, None, 1.5)
    assert before.when.log == after.when.log == "x"
    gone = merged([there], [replace(worn, parameters={"damping": [-2.0]})])
    assert [e.when.end for e in gone] == [3.0]
    with pytest.raises(ModelError, match="for a while"):
        merged([there], [replace(worn, end=4.0)])
    more = merged([there], [replace(worn, parameters={"damping": [0.5]})])
    assert len(more) == 2 and more[0].value("damping")[0] == 2.0, "what came later stands beside it"
    later = merged(more, [spec("viscous_friction", [A], damping=0.25)])
    assert sorted(e.value("damping")[0] for e in later) == [0.5, 2.25]


def test_a_payload_on_the_last_link_is_one_wherever_it_is_said_to_be() -> None:
    there = effect("payload", mass=2.0, com=[0.1, 0.0, 0.0])
    less = spec("payload", [], [ARM.last_link], mass=-0.5, com=[0.1, 0.0, 0.0])
    (left,) = merged([there], [less])
    assert left.value("mass")[0] == 1.5 and left.links == (ARM.last_link,)
    assert merged([there], [spec("payload", [], [ARM.last_link], mass=-2.0, com=[0.1, 0.0, 0.0])]) == []


def test_dry_friction_that_wears_is_taken_off_a_dip() -> None:
    dip = effect("stribeck_friction", [A], coulomb=3.0, static=5.0, stribeck_velocity=0.1)
    (left,) = merged([dip], [spec("coulomb_friction", [A], torque=-1.0)])
    assert left.name == "stribeck_friction"
    assert left.value("coulomb")[0] == 2.0 and left.value("static")[0] == 4.0
    plain = effect("coulomb_friction", [A], torque=1.5)
    found = {e.name: e for e in merged([dip, plain], [spec("coulomb_friction", [A], torque=-1.0)])}
    assert found["coulomb_friction"].value("torque")[0] == 0.5 and found["stribeck_friction"].value("static")[0] == 5.0
    assert len(merged([dip], [spec("coulomb_friction", [A], torque=1.0)])) == 2
    assert len(merged([dip], [spec("coulomb_friction", [B], torque=-1.0)])) == 2, "another joint's"


def test_an_effect_is_gone_only_where_all_of_its_sizes_are_nothing() -> None:
    there = effect("coulomb_friction", [A], torque_positive=2.0, torque_negative=3.0)
    (left,) = merged([there], [spec("coulomb_friction", [A], torque_positive=-2.0, torque_negative=-1.0)])
    assert (left.value("torque_positive")[0], left.value("torque_negative")[0]) == (0.0, 2.0)
    assert merged([there], [spec("coulomb_friction", [A], torque_positive=-2.0, torque_negative=-3.0)]) == []
    coupled = effect("coupled_friction", [A, B], damping=0.0, torque=3.0)
    (both,) = merged([coupled], [spec("coupled_friction", [A, B], damping=0.0, torque=0.5)])
    assert both.value("torque")[0] == 3.5


def test_what_is_less() -> None:
    assert is_less(spec("viscous_friction", damping=-1e-9)) and not is_less(spec("viscous_friction", damping=0.0))
    assert is_less(spec("viscous_friction", [A, B], damping=[1.0, -1.0]))
    assert not is_less(spec("torque_bias", torque=-1.0)), "it can be below nothing"
    assert is_less(spec("joint_spring", stiffness=-1.0, rest_angle=0.0))
