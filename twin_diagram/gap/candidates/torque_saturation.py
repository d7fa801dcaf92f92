"""A motor that does not give more than a limit: its candidates and its record."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate, transformed
from twin_diagram.gap.candidates.joint_candidate import single, those_there
from twin_diagram.gap.candidates.merging import least
from twin_diagram.gap.candidates.records import EffectRecord, Wakes, register
from twin_diagram.gap.candidates.wording import effort, values_on_joints
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.model.effects import Effect
from twin_diagram.model.effects.actuation import TorqueSaturation
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    saturation_shares: tuple[float, ...] = (
        *(0.99, 0.97, 0.95, 0.92, 0.88, 0.83, 0.77, 0.7, 0.62, 0.53),
        *(0.44, 0.35, 0.27, 0.2, 0.14, 0.09, 0.05),
    )
    """Limits that are tried, as quantiles of the absolute torque."""

    of_the_peak: tuple[float, ...] = (0.95, 0.9, 0.84, 0.78, 0.72, 0.66, 0.6, 0.54)
    """And as shares of the largest: where torque peaks seldom, quantiles leave gaps."""

    most_saturated: float = 0.96
    """Share of the time that a torque may be beyond its limit."""

    least_limit: float = 0.06
    """A limit is at least this share of the largest torque that is logged."""

    clear: float = 3.0
    """Torque must exceed a limit by this many times its noise to show that it is one."""

    unneeded: float = 0.5
    """Share of the torque beyond a limit that the motion must not have needed: what moved the arm was no limit."""

    plain: float = 6.0
    """Beyond a limit by so many times the noise, torque is plainly beyond it; see `selected`."""

    selected: float = 40.0
    """Below `plain` times the noise, picking the samples beyond a limit picks their noise too: worth this much
    [nats]."""

    asked_time: float = 0.1
    """What a motor is asked for is one number more per this time [s]: twice the band of most motions."""


TUNING = Tuning()


def on_joints(terms: Terms) -> list[list[Candidate]]:
    """Return the limits that are tried on each joint."""
    return [
        those_there(saturation(terms, j, float(limit)) for limit in _limits(terms, j)) for j in range(terms.records.n)
    ]


def _limits(terms: Terms, j: int) -> list[float]:
    everything = np.abs(np.concatenate([tau[:, j] for tau in terms.asked_torque]))
    return [
        *np.quantile(everything, TUNING.saturation_shares),
        *(float(np.max(everything)) * np.array(TUNING.of_the_peak)),
    ]


def saturation(terms: Terms, j: int, limit: float) -> Candidate | None:
    """Return the torque logged beyond a limit."""
    asked = [tau[:, j] for tau in terms.asked_torque]
    beyond = np.concatenate([np.abs(tau) - limit for tau in asked])
    share = float(np.mean(beyond > 0.0))
    if not 0.0 < share < TUNING.most_saturated or limit < TUNING.least_limit * (limit + float(np.max(beyond))):
        return None
    # Where a torque is mostly beyond its limit, what is left without the limit is no noise.
    noise = max(terms.torque_noise[j], min(terms.unexplained(j), terms.unexplained(j, limit)), 1e-12)
    clear = float(np.sqrt(np.mean(beyond[beyond > 0.0] ** 2)) / noise)
    if clear < TUNING.clear:
        return None
    over = terms.reduce(tuple(tau - np.clip(tau, -limit, limit) for tau in asked))
    if float(over @ terms.unneeded[:, j]) < TUNING.unneeded * float(over @ over):
        return None
    unheard = terms.reduce(tuple((np.abs(tau) > limit).astype(float) for tau in asked))

    # Of what was asked for beyond the limit the motion knows nothing, so that it must be told by itself. Of a joint
    # that carries nothing, friction is all there is: a motor that gave nothing, whatever was asked, explains it, too.
    size = float(np.sqrt(np.mean(beyond[beyond > 0.0] ** 2))) / max(float(terms.torque_noise[j]), 1e-12)
    duration = sum(len(r.time) / r.rate for r in terms.records.records)
    told = 0.5 * share * duration / TUNING.asked_time * float(np.log1p(size**2))

    def values(c: Array) -> dict[str, Array]:
        return {"limit": np.array([limit])}

    return single(
        terms,
        TorqueSaturation.name,
        j,
        [over],
        transformed(values),
        [0.75],
        [1.25],
        shape={"limit": limit},
        cost=told + float(np.log(5.0)) + (TUNING.selected if clear < TUNING.plain else 0.0),
        unheard=np.clip(unheard, 0.0, 1.0),
    )


def shapes(terms: Terms, candidate: Candidate) -> list[tuple[str, float, float]]:
    """Return the limit."""
    del terms, candidate
    return [("limit", 0.9, 1.1)]


def rebuilt(terms: Terms, candidate: Candidate, key: str, value: float) -> Candidate | None:
    """Return the candidate of another limit."""
    del key
    return saturation(terms, candidate.joints[0], value)


def sentence(effect: Effect) -> str:
    """Return its limit on each joint."""
    return f"the {effort(effect)} that reaches the joints is bounded by {values_on_joints(effect, 'limit')}"


register(
    EffectRecord(
        effect=TorqueSaturation,
        title="Saturated torque",
        explanation="The motor does not give more than a limit, whatever was asked of it.",
        sentence=sentence,
        on_joints=on_joints,
        smooth=False,
        shapes=shapes,
        rebuilt=rebuilt,
        merge=least,
        joint_by_joint=True,
        motor=True,
        wakes=frozenset({Wakes.LOAD}),
    )
)
