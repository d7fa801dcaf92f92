"""How far what is unusual about an arm stands out from all that is usual, in units of what its log's noise does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from gap_truth.chain import Chain, Link
from gap_truth.phenomena import spring_torque, tilted_gravity
from gap_truth.world import Nominal
from real_references.regression import equations
from scipy.signal.windows import tukey

from twin_diagram.logs import read_log
from twin_diagram.logs.differentiation import below_cutoff, motion
from twin_diagram.model.effects import make
from twin_diagram.model.model import Model
from twin_diagram.model.prediction import load_model_for
from twin_diagram.scenario import EffectSpec
from whole_robots.arms import SHAPES, other_link
from whole_robots.runs import Robot

Array = npt.NDArray[np.float64]

DRAWN = 400
"""Links, for how much they may be off."""

BAND = 10.0
"""Residuals are compared below this [Hz]."""

TAPER = 1.0
"""A log is faded in and out over half of this, as what is no whole period would pass for high frequencies [s]."""

GAINS = 0.02
"""By which motors' torque constants are off: of three joints in ten, by 2 to 5 %, root mean square."""


def separation(robot: Robot, folder: Path, *, plain: bool = False) -> float:
    """Distance in units of the log's noise from what is unusual to the nearest combination of what is usual.

    Links are off by what this arm's are off by, or a last link that may be anything would be any payload. Usual are
    also motors' gains, and friction that is only roughly its law's. Noise has its colour, and what encoders and clocks
    read wrongly counts: torque for accelerations that there are not. A delay below a log's sample is no effect, as the
    catalogue has it: it stands out by nothing.

    Args:
        robot: the arm and its runs.
        folder: of its description and logs.
        plain: count links, joints' own terms and white noise alone, as once was done.
    """
    if not plain and any(x.name == "time_delay" and x.values["delay"][0] < robot.period for x in robot.truth.unusual):
        return 0.0
    eqs = equations(folder / "model.urdf", folder / "fit.csv", "motor")
    _, log, _ = load_model_for(read_log(folder / "fit.csv"), folder / "model.urdf")
    regular = motion(replace(log, velocity=None), cutoff=BAND).log
    seen = unusual_torque(robot, folder)[None]
    usual, spread = roughly(robot)
    if plain:
        usual, spread = usual[:0], spread[:0]
    at = [np.interp(regular.time, robot.fit.time, x) for each in (*seen, *usual) for x in each.T]
    filtered = below_cutoff(np.stack(at, axis=1), regular).T.reshape(1 + len(usual), eqs.n, -1)
    columns = np.concatenate([eqs.columns.transpose(2, 0, 1), filtered])  # (P + 1 + R, n, M)
    white = whitened(columns, robot) if not plain else in_white(columns, robot)
    unusual = white[eqs.columns.shape[2]]
    X = np.delete(white, eqs.columns.shape[2], axis=0).T
    links = 10 * eqs.n
    prior = np.diag(np.concatenate([np.zeros(links), np.full(4 * eqs.n, 1e-9), np.maximum(spread, 1e-9) ** -2.0]))
    for k, link in enumerate(robot.truth.described.links):
        prior[10 * k : 10 * k + 10, 10 * k : 10 * k + 10] = np.linalg.inv(spread_of(link, robot.truth.setting["links"]))
    left = unusual - X @ np.linalg.solve(X.T @ X + prior, X.T @ unusual)
    return float(np.sqrt(max(unusual @ left, 0.0)))


def in_white(signals: Array, robot: Robot) -> Array:
    """Signals (P, n, M) over noise that is taken to be white (P, M')."""
    every = max(1, int(0.01 / robot.period))
    scale = np.hypot(robot.noise.white, robot.noise.coloured)[:, None] / np.sqrt(every)
    return np.asarray((signals / scale)[:, :, ::every].reshape(len(signals), -1))


def whitened(signals: Array, robot: Robot) -> Array:
    """Signals (P, n, M) as numbers of variance one where they are the log's noise (P, M')."""
    count, period = signals.shape[2], robot.period
    f = np.fft.rfftfreq(count, period)
    bins = f <= min(BAND, 0.2 / period)
    reading = robot.control.resolution**2 / 12.0 + np.mean(robot.fit.v**2, axis=0) * robot.noise.jitter**2
    M = Nominal(robot.truth.real).inertia(np.mean(robot.fit.q, axis=0))
    density = robot.noise.density(f[bins], period) + (2.0 * np.pi * f[bins, None]) ** 4 * (M**2 @ reading)
    scale = np.sqrt(2.0 / count / density)
    scale[0] /= np.sqrt(2.0)
    taper = tukey(count, min(1.0, TAPER / (count * period)))
    spectrum = np.fft.rfft(signals * taper, axis=2)[:, :, bins] * scale.T
    return np.concatenate([spectrum.real, spectrum.imag], axis=2).reshape(len(signals), -1)


def roughly(robot: Robot) -> tuple[Array, Array]:
    """What gains and friction are usually off by along the fitted run: torque (R, N, n), and (R,) deviations of it.

    Of friction, each shape that arms are drawn with, as likely as it is drawn and as large as its joint's level.
    """
    run, laws, n = robot.fit, robot.truth.friction, robot.truth.real.n
    v, side, share = run.v, np.sign(run.v), np.linspace(-1.0, 1.0, len(run.v))[:, None]
    drawn = 1.0 / np.sqrt(len(SHAPES))
    kinds = [
        (run.torque, np.full(n, GAINS)),
        (side * (1.0 - np.tanh(np.abs(v) / 0.03)), laws.level * drawn),  # sigmoids, and about reversals hysteresis
        (side * np.abs(v) ** 0.7, 0.38 * laws.level * drawn),
        (0.05 * np.abs(run.torque) * side, 0.38 * drawn * np.ones(n)),
        (side * share, 0.5 * 0.1 * np.sqrt(0.3 / 3.0) * laws.level),
    ]
    columns = np.zeros((len(kinds) * n, len(v), n))
    for k, (signal, _) in enumerate(kinds):
        for j in range(n):
            columns[k * n + j, :, j] = signal[:, j]
    return columns, np.concatenate([spread for _, spread in kinds])


def with_payload(robot: Robot) -> Chain:
    """The real arm, with the payload that it carries."""
    chain = robot.truth.real
    for thing in robot.truth.unusual:
        if thing.name == "payload":
            last = chain.links[-1].with_lump(thing.values["mass"][0], np.array(thing.values["com"]))
            chain = replace(chain, links=(*chain.links[:-1], last))
    return chain


def spread_of(link: Link, size: float | str) -> Array:
    """(10, 10) covariance of a link's inertial parameters, drawn as arms' are."""
    rng = np.random.default_rng(0)
    drawn = np.stack([parameters(other_link(link, float(size), rng)) for _ in range(DRAWN)])
    off = drawn - parameters(link)
    return np.asarray(off.T @ off / DRAWN) + 1e-9 * np.eye(10)


def parameters(link: Link) -> Array:
    """(10,) mass, mass times centre, and moments about the link's origin."""
    about = link.inertia + link.mass * (link.com @ link.com * np.eye(3) - np.outer(link.com, link.com))
    moments = [about[0, 0], about[1, 1], about[2, 2], about[0, 1], about[0, 2], about[1, 2]]
    return np.array([link.mass, *(link.mass * link.com), *moments])


def unusual_torque(robot: Robot, folder: Path) -> Array:
    """Torque (N, n) that what is unusual takes along the fitted run [N·m]."""
    run, truth = robot.fit, robot.truth
    (thing,) = truth.unusual
    q, v, a = run.q, run.v, run.a
    plain = Nominal(truth.real)
    if thing.name == "external_force":
        link = truth.described.link_names[thing.link or 0]
        spec = EffectSpec(thing.name, [], [link], {"wrench": list(thing.values["wrench"])})
        described = Model.load(folder / "model.urdf")
        pushed = described.with_effects([make(spec)]).inverse_dynamics(q, v, a) - described.inverse_dynamics(q, v, a)
        return np.asarray(pushed * np.array([[thing.acts(t)] for t in run.time]))
    if thing.name == "payload":
        return Nominal(with_payload(robot)).inverse(q, v, a) - plain.inverse(q, v, a)
    if thing.name == "gravity_tilt":
        gravity = tilted_gravity(thing.values["roll"][0], thing.values["pitch"][0])
        return Nominal(truth.real, gravity).inverse(q, v, a) - plain.inverse(q, v, a)
    if thing.name == "encoder_offset":
        off = np.zeros(q.shape[1])
        off[list(thing.joints)] = thing.values["offset"]
        return plain.inverse(q, v, a) - plain.inverse(q - off, v, a)
    if thing.name == "time_delay":
        return np.asarray(thing.values["delay"][0] * np.gradient(run.torque, robot.period, axis=0))
    more = np.zeros_like(q)
    for k, j in enumerate(thing.joints):
        more[:, j] = spring_torque(thing, k, q[:, j])
    return more
