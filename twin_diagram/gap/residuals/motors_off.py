"""Spans of a log in which the motors give nothing and brakes hold the arm: what the joints need there is no motor's.

A controller that stops amid a run, or that is not on yet when a log begins, leaves torques of zero beside a pose whose
weight some joint must bear. A fit would take that for an effect that comes and goes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter1d

from twin_diagram.gap.residuals.log_noise import roughness
from twin_diagram.logs import Log, fingerprint
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.stretches import stretches


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand: arms under control are far from them."""

    window: float = 0.1
    """Over which torques are averaged, and the shortest span that counts [s]."""

    nothing: float = 0.02
    """Share of a joint's torque in the log, root mean square, up to which its mean is nothing,"""

    noises: float = 3.0
    """or so many standard deviations that its noise leaves of a mean, whichever is more."""

    weight: float = 0.3
    """Share of the same that the description must need at the pose, on some joint,"""

    above: float = 5.0
    """and times what counts as nothing there."""

    still: float = 2e-3
    """Share of a joint's range in the log by which it moves at most while brakes hold it, beside its encoder's noise:
    where friction holds what a soft controller lets go, joints creep."""

    released: float = 0.5
    """For so long brakes may hold on while motors take the load over, and the arm stands still [s]."""


TUNING = Tuning()


def without_brakes(model: Model, log: Log) -> npt.NDArray[np.bool_]:
    """Return (N,) samples of a log that its motors tell of: all but those in which they are off and brakes hold.

    Args:
        model: the given one, with the log's joints in their order.
        log: checked.
    """
    torque, time = log.motor_torque, log.time
    kept = np.ones(len(time), dtype=bool)
    width = round(TUNING.window / log.period)
    if width < 1 or len(time) <= 4 * width:
        return kept
    size = np.sqrt(np.mean(torque**2, axis=0))
    noise = roughness(torque, log.period)

    def nothing(samples: int) -> Array:
        return np.asarray(np.maximum(TUNING.nothing * size, TUNING.noises * noise / np.sqrt(samples)))

    off = np.all(np.abs(uniform_filter1d(torque, width, axis=0)) <= nothing(width), axis=1)
    steps = TUNING.still * np.ptp(log.position, axis=0) + 2.0 * TUNING.noises * roughness(log.position, log.period)
    for begin, end in stretches(off):
        later = slice((begin + end) // 2, end)
        if end - begin < width or not np.all(np.ptp(log.position[later], axis=0) <= steps):
            continue
        if not np.all(np.abs(np.mean(torque[later], axis=0)) <= nothing((end - begin) // 2)):
            continue
        pose = log.position[end - 1 : end]
        rest = np.zeros_like(pose)
        needed = np.abs(model.for_run(fingerprint(log)).inverse_dynamics(pose, rest, rest)[0])
        if not np.any((needed > TUNING.weight * size) & (needed > TUNING.above * nothing(width))):
            continue
        held = np.all(np.abs(log.position - pose) <= steps, axis=1) & (time >= time[end - 1])
        last = end + int(np.argmin(np.append(held[end:], False)))
        last = min(last, int(np.searchsorted(time, time[end - 1] + TUNING.released)))
        kept[max(begin - width // 2, 0) : max(last, end)] = False
    return kept
