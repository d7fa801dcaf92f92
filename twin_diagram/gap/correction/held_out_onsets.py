"""When an effect that starts or ends within a fitted run does so in the held-out one, too.

What started is taken to be there from then on, so that later runs have it throughout. A held-out run may yet have an
onset of its own, as a fault that is switched on at some time of every run has. That time, and nothing else, is then
taken from the held-out run, and only where both other readings of it (there throughout, or not at all) are refuted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from twin_diagram.logs import Log, fingerprint
from twin_diagram.logs.differentiation import TUNING as DIFFERENTIATION
from twin_diagram.logs.differentiation import Motion, inner, motion
from twin_diagram.model.effects import Effect
from twin_diagram.model.effects.timing import told
from twin_diagram.model.model import Model
from twin_diagram.model.prediction import torque_residual
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    refuted: float = 60.0
    """Squared errors, in noises of independent samples, by which both other readings must be worse."""

    clearly: float = 0.2
    """... and by this share of what is left: laws that are not exact leave more than noise."""

    together: float = 0.5
    """Effects that start within this time start together [s]."""


TUNING = Tuning()


def with_held_onsets(corrected: Model, held: Log, noise_floor: Array) -> tuple[Model, list[str]]:
    """Return the corrected model, told of onsets and ends within the held-out run; and what was told.

    Args:
        corrected: with effects whose onset or end is about a fitted run.
        held: the held-out run, checked.
        noise_floor: (n,) torque noise below the residual's cutoff [N·m].
    """
    mark, notes = fingerprint(held), []
    smooth = motion(held)
    for group in _groups(corrected.effects, mark):
        model = _switched(corrected, group, {mark: -math.inf})
        moment = _moment(_switched(model, group, {mark: math.inf}), model, smooth, noise_floor)
        if moment is not None:
            corrected = _switched(corrected, group, {mark: moment})
            names = " and ".join(dict.fromkeys(corrected.effects[k].name for k in group))
            notes.append(
                f"{names}: the change comes in the held-out run, too, at {moment:.2f} s of its clock; "
                "this time was taken from that run itself"
            )
    return corrected, notes


def _groups(effects: tuple[Effect, ...], mark: str) -> list[list[int]]:
    """Return the indices of effects that start or end together in some other run."""
    timed = [
        (effect.when.log, when, k)
        for k, effect in enumerate(effects)
        if effect.when.log not in ("", mark) and (effect.when.onset is None) != (effect.when.end is None)
        for when in (effect.when.onset, effect.when.end)
        if when is not None
    ]
    result: list[list[int]] = []
    last = ("", -math.inf)
    for log, when, k in sorted(timed):
        if log != last[0] or when - last[1] > TUNING.together:
            result.append([])
        result[-1].append(k)
        last = (log, when)
    return result


def _switched(model: Model, group: list[int], moments: dict[str, float]) -> Model:
    """Return the model with other times of a group of effects in some runs."""
    changed = (told(e, moments) if k in group else e for k, e in enumerate(model.effects))
    return model.with_effects(list(changed))


def _moment(before: Model, after: Model, smooth: Motion, noise: Array) -> float | None:
    """Return when one model takes over from the other [s]; None where one of them explains the whole run."""
    regular = smooth.log
    rate = 1.0 / regular.period
    kept = inner(regular.time)

    def squares(model: Model) -> Array:
        left = torque_residual(model, regular, smooth) / noise
        return np.asarray(np.sum(left**2, axis=1)) * min(1.0, 2.0 * DIFFERENTIATION.residual_cutoff / rate)

    first, second = squares(before), squares(after)
    # What the first model leaves until sample k, and the second from then on.
    left = float(np.sum(second)) + np.concatenate([[0.0], np.cumsum(first - second)])
    k = int(np.argmin(left))
    least = float(left[k])
    enough = max(TUNING.refuted, TUNING.clearly * least)
    if min(left[0] - least, left[-1] - least) < enough:
        return None
    return float(regular.time[kept][k])
