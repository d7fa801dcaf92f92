"""Which effects act together when."""

from __future__ import annotations

import numpy as np

from twin_diagram.model.dynamics.onsets import epochs
from twin_diagram.model.effects import make
from twin_diagram.scenario import EffectSpec


def test_sets_of_effects_are_told_once_each_at_all_of_their_times() -> None:
    """A push that is over leaves the set of before: one set, at two spans."""
    time = np.arange(0.0, 10.0, 0.5)
    always = make(EffectSpec("viscous_friction", ["elbow_joint"], [], {"damping": [1.0]}))
    push = make(EffectSpec("external_force", [], ["forearm_link"], {"wrench": [1.0] * 6}, onset=3.0, end=5.0, log="a"))
    found = dict(epochs([always, push], time))
    assert set(found) == {(True, False), (True, True)}
    np.testing.assert_array_equal(found[True, True], push.when.active(time))
    np.testing.assert_array_equal(found[True, False], ~push.when.active(time))
    ((none, mask),) = epochs([], time)
    assert none == ()
    assert np.all(mask)
    assert epochs([always, push], time[:0]) == []
