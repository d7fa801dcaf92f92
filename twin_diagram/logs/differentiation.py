"""Smooth motion out of a measured log: velocities and accelerations without phase or raw double differences."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import scipy

from twin_diagram.logs import Log, uniform
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand."""

    residual_cutoff: float = 10.0
    """Torque residuals are looked at below this [Hz]; what `gap.json` states is defined by it."""

    residual_cut: float = 0.3
    """Left out at each end of a log, where filters settle: three periods of the cutoff [s]."""

    motion_cutoff: float = 25.0
    """Positions are smoothed above this before they are differentiated: arms move slower, noise is white [Hz]."""


TUNING = Tuning()


@dataclass(frozen=True)
class Motion:
    """A log on regular times, with what its positions do.

    Attributes:
        log: resampled to its median rate where its own times are irregular.
        position, velocity, acceleration: (N, n), smoothed [rad], [rad/s], [rad/s²].
    """

    log: Log
    position: Array
    velocity: Array
    acceleration: Array


def lowpass(signal: Array, rate: float, cutoff: float = TUNING.residual_cutoff) -> Array:
    """Filter by a 4th-order Butterworth low-pass, forward and backward, so without phase.

    Args:
        signal: (N, …) at a constant rate; a signal slower than twice the cutoff is answered as it is.
        rate: samples per second [1/s].
        cutoff: [Hz].
    """
    if cutoff >= 0.5 * rate:
        return np.array(signal, dtype=float)
    padding = min(len(signal) - 1, int(np.ceil(rate / cutoff)))  # by then the filter has died away
    extended = _turned_about_its_ends(np.asarray(signal), padding)
    sections, settled = _design(float(cutoff), float(rate))
    settled = settled.reshape(settled.shape + (1,) * (extended.ndim - 1))
    for _ in range(2):  # forward, then backward
        extended = scipy.signal.sosfilt(sections, extended, axis=0, zi=settled * extended[:1])[0][::-1]
    return extended[padding:-padding] if padding > 0 else extended


@lru_cache(maxsize=64)
def _design(cutoff: float, rate: float) -> tuple[Array, Array]:
    """Return second-order sections (2, 6) and their state (2, 2) when settled at 1; `gap` asks thousands of times."""
    sections = scipy.signal.butter(4, cutoff, fs=rate, output="sos")
    return sections, scipy.signal.sosfilt_zi(sections)


def _turned_about_its_ends(signal: Array, count: int) -> Array:
    """Return a signal (N, …) gone on with at each end by `count` < N samples, turned about its last one by 180°."""
    if count <= 0:
        return signal
    before, after = signal[count:0:-1], signal[-2 : -(count + 2) : -1]
    return np.concatenate([2 * signal[:1] - before, signal, 2 * signal[-1:] - after])


def smooth(signal: Array, rate: float, cutoff: float = TUNING.motion_cutoff) -> Array:
    """Filter as `lowpass` does, but faithful to slopes and curvatures at the ends.

    A filter must be told what lies beyond the ends. Turning the signal about its last sample, as is usual, breaks its
    curvature there; this goes on along a cubic fitted to the last one and a half periods of the cutoff.
    """
    window = int(np.ceil(1.5 * rate / cutoff))
    if len(signal) < window:
        return lowpass(signal, rate, cutoff)
    beyond = int(np.ceil(2.0 * rate / cutoff))
    inside = np.arange(window) / window
    outside = -np.arange(beyond, 0, -1) / window
    extend = np.vander(outside, 4) @ np.linalg.pinv(np.vander(inside, 4))
    ends = [extend @ signal[:window], (extend @ signal[::-1][:window])[::-1]]
    return lowpass(np.concatenate([ends[0], signal, ends[1]]), rate, cutoff)[beyond:-beyond]


def differentiate(signal: Array, time: Array, order: int) -> Array:
    """Return the derivative (N, …) of a smooth signal, by a quintic spline through its samples."""
    degree = min(5, len(time) - 1)
    derivative: Array = scipy.interpolate.make_interp_spline(time, signal, k=degree).derivative(order)(time)
    return derivative


def motion(log: Log, cutoff: float = TUNING.motion_cutoff) -> Motion:
    """Return the position, velocity and acceleration of a log.

    The drives' velocity, where it is logged, is weighed against the derivative of the positions by their noise: white
    noise of density σ_q on positions becomes ω²σ_q on accelerations, σ_v on velocities becomes ω σ_v. It is left out
    where it lags, or is scaled: filters in drives do that, and a velocity that is off by 1 % is worse than noise.
    """
    log = uniform(log)
    time, rate = log.time, 1.0 / log.period
    position = smooth(log.position, rate, cutoff)
    velocity = differentiate(position, time, 1)
    acceleration = differentiate(position, time, 2)
    if log.velocity is not None:
        weight = _velocity_weight(log, rate, velocity, acceleration)
        used = np.flatnonzero(weight)  # so none of a joint whose velocity is not logged
        drive, w = smooth(log.velocity[:, used], rate, cutoff), weight[used]
        velocity[:, used] = w * drive + (1.0 - w) * velocity[:, used]
        acceleration[:, used] = w * differentiate(drive, time, 1) + (1.0 - w) * acceleration[:, used]
    return Motion(log, position, velocity, acceleration)


def _velocity_weight(log: Log, rate: float, velocity: Array, acceleration: Array) -> Array:
    """Return (n,) weight in [0, 1] of the drives' velocity."""
    assert log.velocity is not None
    weight = np.zeros(len(log.joints))
    if rate < 8.0 * TUNING.residual_cutoff:
        return weight
    v_low, a_low, drive_low = (lowpass(x, rate) for x in (velocity, acceleration, log.velocity))
    noise_q, noise_v = (np.std(x - lowpass(x, rate, 0.35 * rate), axis=0) for x in (log.position, log.velocity))
    w = 2.0 * np.pi * TUNING.residual_cutoff
    for k in np.flatnonzero(~np.any(np.isnan(log.velocity), axis=0)):
        basis = np.stack([v_low[:, k], a_low[:, k]], axis=1)
        scale, lag = np.linalg.lstsq(basis, drive_low[:, k], rcond=None)[0]  # zeros for a joint at rest
        if abs(scale - 1.0) < 0.005 and abs(lag) * rate < 0.25:
            noise = (w * noise_q[k]) ** 2 + noise_v[k] ** 2
            weight[k] = (w * noise_q[k]) ** 2 / noise if noise > 0.0 else 0.0
    return weight


def below_cutoff(signal: Array, regular: Log) -> Array:
    """Filter and cut a signal as the contract of torque residuals says.

    Low-passed at `residual_cutoff`, `residual_cut` left out at each end: nothing else compares torques by other means.

    Args:
        signal: (N, …) at the log's times, of any unit.
        regular: a log with regular times.

    Returns:
        (M, …) at the times that `inner` keeps.
    """
    return lowpass(signal, 1.0 / regular.period)[inner(regular.time)]


def inner(time: Array, cut: float = TUNING.residual_cut) -> npt.NDArray[np.bool_]:
    """Return which samples lie at least `cut` [s] from both ends."""
    edge = cut * (1.0 - 1e-9)
    return (time >= time[0] + edge) & (time <= time[-1] - edge)
