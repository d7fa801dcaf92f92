"""A gain stands on what the rest of its own hypothesis transmits, not on what an earlier one did."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tests.gap.search.test_evidence import JOINTS, ROWS, candidate, white
from tests.gap.test_naming import GIVEN, log_of
from twin_diagram.gap import naming
from twin_diagram.gap.naming import name
from twin_diagram.gap.search.bench import Bench
from twin_diagram.gap.search.borrowed_load import borrowing
from twin_diagram.gap.verdict.posterior import most_probable
from twin_diagram.scenario import EffectSpec

RNG = np.random.default_rng(0)
GRAVITY, ROTOR = RNG.normal(size=(2, 400))


def borrowed(supposed: float, transmitted: float) -> frozenset[int]:
    """Of a gain and a rotor on joint 1, what is borrowed where so much rotor was supposed and so much is there."""
    names = ("torque_constant", "reflected_inertia")
    bench = cast(Any, SimpleNamespace(candidates=[candidate(n, 1, ROTOR) for n in names]))
    fit = cast(Any, SimpleNamespace(members=frozenset({0, 1})))
    other = np.zeros(400)
    loads = (np.stack([other, GRAVITY + share * ROTOR], axis=1) for share in (supposed, transmitted))
    return borrowing(bench, fit, *loads)


def test_a_gain_is_borrowed_where_most_of_its_load_is_gone() -> None:
    assert borrowed(3.0, 0.0) == {0}
    assert not borrowed(3.0, 3.0)
    assert not borrowed(3.0, 2.5)  # gains of much gravity do not hang on a little friction
    assert not borrowed(0.3, 0.0)


@pytest.mark.slow
def test_the_rotor_of_a_light_wrist_is_no_gain() -> None:
    joints = ["shoulder_lift_joint", "wrist_3_joint"]
    verdict = name(GIVEN, [log_of([EffectSpec("reflected_inertia", joints, [], {"inertia": [0.9, 0.17]})])])
    assert [(f.name, f.joints) for f in verdict.findings] == [("reflected_inertia", tuple(joints))]
    assert not verdict.remainder


def test_what_leant_on_a_borrowed_gain_goes_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the gain the friction beside it would be negative; another joint's stands."""
    rng = np.random.default_rng(1)
    friction, other, apart = rng.normal(size=(3, ROWS))
    gain = candidate("torque_constant", 0, 0.3 * apart - friction)
    rubs = [replace(candidate("coulomb_friction", j, x), lower=np.zeros(1)) for j, x in ((0, friction), (1, other))]
    y = 0.1 * rng.normal(size=(ROWS, JOINTS))
    y[:, 0] += 2.5 * gain.columns[:, 0, 0] + friction
    y[:, 1] += 2.0 * other
    bench = Bench(y, white(0.1), [gain, *rubs], [])
    every = bench.solve(frozenset({0, 1, 2}))
    assert np.isfinite(every.evidence)
    assert not np.isfinite(bench.solve(frozenset({1, 2})).evidence)

    terms, nothing = SimpleNamespace(reduce=lambda x: x, load=y), cast(Any, None)
    monkeypatch.setattr(naming, "given_load", lambda records: y)
    monkeypatch.setattr(naming, "contribution_of", lambda *given, **named: np.zeros_like(y))
    monkeypatch.setattr(naming, "search_again", lambda *given: (terms, bench, every))
    monkeypatch.setattr(naming, "borrowing", lambda *given: frozenset({0}))
    fit = naming.searched_again(nothing, nothing, bench, every, nothing, nothing)[2]
    assert fit.members == {2}
    assert most_probable(bench, fit) is every  # which the verdict then says
