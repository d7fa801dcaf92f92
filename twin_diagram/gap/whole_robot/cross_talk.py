"""Torque sensors that read a part of each other's torque: taken out of the logs before anything is named.

A joint's sensor is bent a little by what its neighbours bear. One percent of a shoulder's torque is as much as all that
a wrist's friction does, and links, frictions and pushes bend to it; the catalogue has no name for it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.whole_robot.colour_of_noise import quietest
from twin_diagram.gap.whole_robot.explain import begun, settled
from twin_diagram.gap.whole_robot.held_loads import held_loads
from twin_diagram.gap.whole_robot.left_out import LeftOut, likelihood
from twin_diagram.gap.whole_robot.mended_logs import Mend
from twin_diagram.gap.whole_robot.torque_equations import TorqueEquations, equations, low_passed
from twin_diagram.gap.whole_robot.unusual import terms_of
from twin_diagram.logs import Log, fingerprint
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand.

    Beside 2 % of cross-talk left-out motion leaves a hundredth to a fifth of what it left, and is likelier by 5,300
    nats. Of 17 made logs without, with loads, pushes, contacts, late torques and friction of many kinds, it leaves 0.65
    to 1.5 of it, 0.9 and more on most joints; of an LWR4+, a Panda and a KR300 0.5 to 1.5, with up to 103 nats.
    """

    share: float = 0.02
    """Of another joint's torque that a sensor reads, one standard deviation."""

    left: float = 0.5
    """Share of what a joint leaves of left-out motion that it may leave beside cross-talk,"""

    joints: float = 0.5
    """if cross-talk is to be there: on more joints than this share of all."""

    each: float = 1.0
    """What each share must bring left-out motion [nats], all joints together: Akaike's criterion."""


TUNING = Tuning()


def cross_talk(records: Records) -> Array | None:
    """Return (n, n) shares of each joint's logged torque that others' sensors read; None where they read none.

    Row i is of joint i's sensor, its own share 0. Where left-out motion is no likelier on most joints, there is none.

    Args:
        records: prepared with the given model.
    """
    n = records.n
    try:
        plain, z = settled(begun(records, equations(records)))
        loads = held_loads(plain, z, terms_of(plain.sums, records.model))
        if loads:  # which hides what sensors read, and is told roughly beside that
            plain, z = settled(replace(plain, sums=plain.sums.with_further(loads)))
        beside = replace(plain, sums=plain.sums.with_further([*loads, *_shares(plain.sums)]))
        beside, there = settled(beside, np.concatenate([z, np.zeros(n * (n - 1))]))
        before, after = LeftOut.of(plain, z).rms, LeftOut.of(beside, there).rms
    except np.linalg.LinAlgError:  # a log in which next to nothing moves
        return None
    judge = quietest(plain, beside)
    rise = float(np.sum(likelihood(judge, after) - likelihood(judge, before)))
    if np.mean(after < TUNING.left * before) <= TUNING.joints or rise < TUNING.each * n * (n - 1):
        return None
    result = np.zeros((n, n))
    result[~np.eye(n, dtype=bool)] = there[-n * (n - 1) :]
    return result


def _shares(sums: TorqueEquations) -> list[Candidate]:
    """Return what all other joints' logged torque would add to each joint's, without a name: a candidate per joint."""
    torque = np.concatenate([low_passed(r.torque, r)[r.kept] for r in sums.records.records])
    wide, spread = np.full(sums.n - 1, np.inf), np.full(sums.n - 1, TUNING.share)
    others = (torque[:, None, np.arange(sums.n) != j] for j in range(sums.n))
    return [
        Candidate("", (), (), (j,), columns, spread, -wide, wide, lambda c, covariance: {})
        for j, columns in enumerate(others)
    ]


def without_cross_talk(records: Records) -> Mend | None:
    """Return how logs are without what sensors read of other joints; None where they read nothing."""
    shares = cross_talk(records) if records.n > 1 else None
    if shares is None:
        return None
    usual = float(np.sqrt(np.mean(shares[~np.eye(records.n, dtype=bool)] ** 2)))
    note = (
        f"the logged torques read some {usual:.1%} of each other (cross-talk of the sensors, up to "
        f"{np.max(np.abs(shares)):.1%}): that was taken out before all else, also where the gap is shown; "
        "calibrate the sensors together"
    )
    return Mend(note, partial(_apart, shares=shares))


def _apart(log: Log, shares: Array) -> Log:
    """Return a log without shares (n, n) of other joints' torques, as of the same run."""
    torque, mark = log.motor_torque - log.motor_torque @ shares.T, fingerprint(log)
    if log.torque is None:
        return replace(log, torque_commanded=torque, identity=mark)
    return replace(log, torque=torque, identity=mark)
