"""What a held-out run says: when a change comes in it, too, and whether a correction makes it likelier."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tests.gap.residuals.test_prepared_logs import log_of
from twin_diagram.gap.correction import held_out_evidence, held_out_onsets
from twin_diagram.gap.correction.held_out_evidence import confirmed
from twin_diagram.gap.correction.held_out_onsets import _groups, _moment
from twin_diagram.model.effects.timing import Interval

Array = npt.NDArray[np.float64]

RATE = 100.0


def moment(
    monkeypatch: pytest.MonkeyPatch, before: Array, after: Array, noise: Array | None = None, rate: float = RATE
) -> float | None:
    """Of models that leave such torques of a run whose inner samples begin at 0.3 s."""
    count = len(before) + 2 * round(0.3 * rate)
    regular = SimpleNamespace(time=np.arange(count) / rate, period=1.0 / rate)
    left: Any = {"before": before, "after": after}
    monkeypatch.setattr(held_out_onsets, "torque_residual", lambda model, *arguments: left[model])
    models: Any = "before", "after"
    smooth: Any = SimpleNamespace(log=regular)
    return _moment(*models, smooth, np.ones(before.shape[1]) if noise is None else noise)


def shifted(at: int, size: float, count: int = 1000, level: float = 0.0) -> tuple[Array, Array]:
    """What two models leave of a change at a sample: the one is right before it, the other from it on."""
    before, after = np.full((count, 2), level), np.full((count, 2), level)
    before[at:, 1] += size
    after[:at, 1] += size
    return before, after


@pytest.mark.parametrize("at", [200, 613])
def test_a_change_comes_where_one_model_takes_over(at: int, monkeypatch: pytest.MonkeyPatch) -> None:
    assert moment(monkeypatch, *shifted(at, 3.0)) == pytest.approx(0.3 + at / RATE)
    assert moment(monkeypatch, *shifted(at, 3.0), noise=np.array([1.0, 1e3])) is None


@pytest.mark.parametrize(("squares", "there"), [(59.0, False), (61.0, True)])
@pytest.mark.parametrize("side", ["early", "late"])
@pytest.mark.parametrize("rate", [100.0, 10.0])
def test_both_other_readings_are_refuted_by_sixty_squared_noises_of_independent_samples(
    squares: float, there: bool, side: str, rate: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Below 10 Hz there are twenty independent samples a second, and never more than were taken."""
    share = min(1.0, 20.0 / rate)
    at = 400 if side == "early" else 600
    before, after = shifted(at, 9.0)
    shorter = slice(at, None) if side == "early" else slice(0, at)
    which = before if side == "early" else after
    which[shorter, 1] = np.sqrt(squares / share / len(which[shorter]))
    assert (moment(monkeypatch, before, after, rate=rate) is not None) == there


@pytest.mark.parametrize(("share", "there"), [(0.19, False), (0.21, True)])
def test_where_laws_are_not_exact_a_change_must_be_clearer(
    share: float, there: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a fifth of what is left in either case."""
    before, after = shifted(500, 0.0, level=10.0)
    least = 2 * 1000 * 100.0
    for which, part in ((before, slice(500, None)), (after, slice(0, 500))):
        which[part, 1] = np.sqrt(100.0 + share * least / 500.0)
    assert (moment(monkeypatch, before, after) is not None) == there


def timed(log: str, onset: float | None = None, end: float | None = None) -> Any:
    return SimpleNamespace(when=Interval(onset, end, log))


def test_effects_that_start_or_end_within_half_a_second_of_another_run_do_so_together() -> None:
    effects = (
        timed("a", 3.0),
        timed("b", 3.1),
        timed("a", None, 3.49),
        timed("a", 3.98),
        timed("a", 4.49),
        timed("here", 3.0),
        timed("", 3.0),
        timed("a", 3.0, 5.0),
        timed("a"),
    )
    assert _groups(effects, "here") == [[0, 2, 3], [4], [1]]


def confirm(monkeypatch: pytest.MonkeyPatch, given: Array, corrected: Array, seconds: float = 4.0) -> bool:
    records: Any = SimpleNamespace(lengths=(len(given),))
    monkeypatch.setattr(held_out_evidence, "prepare", lambda *arguments: records)
    left: Any = {"given": given, "corrected": corrected}
    monkeypatch.setattr(held_out_evidence, "left_by", lambda model, records: left[model])
    models: Any = "given", "corrected"
    return confirmed(*models, log_of(seconds))


@pytest.mark.parametrize(("gain", "says"), [(9.7, False), (10.3, True)])
@pytest.mark.parametrize("joints", [1, 3])
def test_a_run_speaks_for_a_correction_by_ten_nats(
    gain: float, says: bool, joints: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the innovations' likelihood, half of as many samples as there are, all joints together."""
    y = np.random.default_rng(4).normal(size=(508, joints))
    smaller = np.exp(-gain / (0.5 * 500 * joints) / 2.0)
    assert confirm(monkeypatch, y, smaller * y) == says
    assert not confirm(monkeypatch, smaller * y, y)


def test_a_run_that_is_too_short_says_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    y = np.random.default_rng(5).normal(size=(508, 1))
    assert not confirm(monkeypatch, y, 0.1 * y, seconds=2.58) and confirm(monkeypatch, y, 0.1 * y, seconds=2.63)
