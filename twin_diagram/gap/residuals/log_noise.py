"""Noise of a log's positions and torques, told from itself, and up to where positions may be trusted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.special import erfinv

from twin_diagram.logs import Log
from twin_diagram.logs.differentiation import TUNING as DIFFERENTIATION
from twin_diagram.logs.differentiation import inner, lowpass
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    least_band: float = 8.0
    """Motion of arms and the edges of dry friction need at least this [Hz]."""

    slow_band: float = 4.0
    """Logs of slow motion need at least this [Hz]."""

    slow: float = 1.5
    """Times its noise that a position may have above that band where it moves slowly."""

    noise_share: float = 0.3
    """Inertial torque of position noise, over the torque's own, at the band's edge."""

    spell: float = 0.1
    """A joint whose encoder says the same for so long rests [s]."""

    outlying: float = 0.01
    """Share of samples that may be outliers."""


TUNING = Tuning()


def trusted_band(model: Model, log: Log) -> float:
    """Return the frequency [Hz] up to which position noise, as inertial torque, stays well below the torque's noise.

    White position noise of density S becomes inertial torque of I² (2π f)⁴ S. Regressors that hold a good part of it
    would be biased towards zero.
    """
    crawls = slow(log)
    if 1.0 / log.period < 8.0 * TUNING.least_band and not crawls:  # noise is hard to tell from motion there
        return np.inf
    least = TUNING.slow_band if crawls else TUNING.least_band
    density = []
    for signal in (log.position, log.motor_torque):
        rough = np.diff(signal, 4, axis=0) / np.sqrt(70.0)  # of white noise, the same variance
        density.append(np.median(np.abs(rough), axis=0) / 0.6745)
    inertia = mean_inertia(model, log)
    logged = np.ptp(log.motor_torque, axis=0) > 0.0  # a torque that never changes tells of no noise
    noisy = logged & (density[0] > 0.0)
    if not np.any(noisy):
        return np.inf
    square = TUNING.noise_share * density[1][noisy] / (inertia[noisy] * density[0][noisy])
    return float(max(least, np.min(np.sqrt(square)) / (2.0 * np.pi)))


def slow(log: Log) -> bool:
    """Return whether there is nothing but noise in a log's positions above `TUNING.slow_band`."""
    rate = 1.0 / log.period
    left = (log.position - lowpass(log.position, rate, TUNING.slow_band))[inner(log.time)]
    above = np.sqrt(np.mean(left**2, axis=0)) if len(left) else np.inf
    return bool(np.all(above <= TUNING.slow * roughness(log.position, log.period)))


def noise_above(model: Model, log: Log, band: float, cutoff: float = DIFFERENTIATION.residual_cutoff) -> Array:
    """Return (n,) noise of torques, and of positions as inertial torque, from a band's edge to the residual's cutoff.

    Regressions below the band do not see it; residuals hold it.

    Args:
        model: the given one.
        log: of regular times.
        band: edge of the low-pass [Hz].
        cutoff: of the residual [Hz].
    """
    position, own = (roughness(signal, log.period) for signal in (log.position, log.motor_torque))
    inertial = mean_inertia(model, log) * position * (2.0 * np.pi) ** 2
    edge = min(band, cutoff)
    square = own**2 * (cutoff - edge) + inertial**2 * (cutoff**5 - edge**5) / 5.0
    return np.asarray(np.sqrt(2.0 * log.period * square))


def shaken(model: Model, log: Log, band: float) -> Array:
    """Return (n,) what `Record.shaken` holds: position noise as inertial torque, over the torque's own noise."""
    noise, own = (roughness(signal, log.period) for signal in (log.position, log.motor_torque))
    return np.asarray(mean_inertia(model, log) * noise * (2.0 * np.pi * band) ** 2 / np.maximum(own, 1e-12))


def mean_inertia(model: Model, log: Log) -> Array:
    """Return (n,) of what each joint moves, along a log [kg·m²]."""
    coarse = log.position[:: max(1, len(log) // 50)]
    return np.asarray(np.mean(np.diagonal(model.tree.mass_matrix(coarse), axis1=1, axis2=2), axis=0))


def roughness(signal: Array, period: float) -> Array:
    """Return (n,) standard deviation of the white noise in smooth signals (N, n), sampled every `period` seconds.

    Rests, in which an encoder says nothing, and the largest differences do not count.
    """
    rough = np.abs(np.diff(signal, 4, axis=0)) / np.sqrt(70.0)  # of white noise, the same variance
    told = (rough > 1e-9 * np.ptp(signal, axis=0)).astype(float)
    heard = uniform_filter1d(told, round(TUNING.spell / period) + 1, axis=0) > 0.0
    kept = 1.0 - TUNING.outlying
    edge = np.sqrt(2.0) * erfinv(kept)  # normal noise without what lies beyond has this share of its deviation:
    less = np.sqrt(1.0 - 2.0 * edge * np.exp(-0.5 * edge**2) / np.sqrt(2.0 * np.pi) / kept)
    result = np.zeros(signal.shape[1])
    for j in range(signal.shape[1]):
        part = rough[heard[:, j], j]
        if len(part):
            usual = part[part <= np.quantile(part, kept)]
            result[j] = np.sqrt(np.mean(usual**2)) / less
    return result
