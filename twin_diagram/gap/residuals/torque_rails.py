"""Torques that stay at the end of a range: what a sensor or a log cuts off is missing, and no name stands for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.logs import Log, LogWarning
from twin_diagram.signals.stretches import stretches


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand."""

    stay: int = 3
    """Samples one after another at exactly the most that is logged from which on it stays there: noise does not."""

    share: float = 0.01
    """Of the samples, that must be there: less bends no fit."""

    values: int = 50
    """Different values from which on a torque is finer than its range, whose ends a coarse one meets by chance."""


TUNING = Tuning()


def told_of_rails(log: Log) -> list[LogWarning]:
    """Return what is said of joints whose logged torque stays at the end of a range."""
    torque = log.motor_torque
    result = []
    for k, joint in enumerate(log.joints):
        own = torque[:, k]
        if len(np.unique(own)) < TUNING.values:
            continue
        for end in (float(np.max(own)), float(np.min(own))):
            held = sum(b - a for a, b in stretches(own == end) if b - a >= TUNING.stay)
            if end and held >= TUNING.share * len(own):  # 0 is where nothing is done
                message = (
                    f"{log.source}: the torque of {joint} stays at {end:.4g} for {100 * held / len(own):.0f} % of the "
                    "samples, and never goes beyond: if that is the range of a sensor or a log, and no limit of the "
                    "motor, the rest is missing there, and names may stand for it"
                )
                result.append(LogWarning("rail", message))
    return result
