"""A gain stands on what the rest of its own hypothesis transmits, not on what an earlier one did."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tests.gap.search.test_evidence import candidate
from tests.gap.test_naming import GIVEN, log_of
from twin_diagram.gap.naming import name
from twin_diagram.gap.search.borrowed_load import borrowing
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
