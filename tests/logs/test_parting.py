"""A log that goes silent is parted there; each stretch is of the same run."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.errors import LogError
from twin_diagram.logs import Log, fingerprint
from twin_diagram.logs.parting import longest, parted


def silent(*spans: tuple[float, float]) -> Log:
    """A log of twelve seconds at 125 Hz without what lies within some spans."""
    time = 0.008 * np.arange(1500)
    kept = ~np.any([(time > begin) & (time < end) for begin, end in spans], axis=0)
    position = np.sin(time[kept])[:, None]
    return Log(time[kept], ("a",), position, torque=2.0 * position)


def test_stretches_hold_all_samples_of_one_run_in_order() -> None:
    log = silent((3.0, 4.2))
    parts = parted(log, 2.6)
    assert [part.time[0] for part in parts] == pytest.approx([0.0, 4.2], abs=0.008)
    np.testing.assert_array_equal(np.concatenate([part.time for part in parts]), log.time)
    np.testing.assert_array_equal(np.concatenate([part.motor_torque for part in parts]), log.motor_torque)
    assert {fingerprint(part) for part in parts} == {fingerprint(log)}
    assert longest(parts) is parts[1]


def test_what_is_too_short_is_left_out() -> None:
    (part,) = parted(silent((1.0, 2.0)), 2.6)
    assert part.time[0] == pytest.approx(2.0, abs=0.008)


@pytest.mark.parametrize("spans", [((5.0, 5.05),), tuple((k, k + 0.5) for k in range(12))])
def test_a_few_lost_samples_or_nothing_but_gaps_leave_it_whole(spans: tuple[tuple[float, float], ...]) -> None:
    log = silent(*spans)
    assert parted(log, 2.6) == [log]


def test_two_short_stretches_of_a_pause_are_refused() -> None:
    """What a spline made of the pause was told as a push from outside."""
    log = silent((1.5, 10.5))
    with pytest.raises(LogError, match=r"silent for most of its time, as from 1\.\d* to 10\.\d* s, .* than 2\.6 s"):
        parted(log, 2.6)
    assert len(parted(log, 1.4)) == 2


def test_a_driver_that_repeats_itself_says_nothing_and_a_joint_at_rest_does() -> None:
    log = silent((20.0, 21.0))
    frozen, rests = log.position.copy(), log.position.copy()
    frozen[400:600] = frozen[400]
    rests[400:] = np.sin(np.maximum(log.time[400:] - 1.6, log.time[400]))[:, None]
    parts = parted(Log(log.time, log.joints, frozen, torque=frozen), 2.6)
    assert [len(part) for part in parts] == [401, 900]
    still = Log(log.time, log.joints, rests, torque=rests)
    assert np.all(np.diff(still.position[400:600], axis=0) == 0.0)
    assert parted(still, 2.6) == [still]
