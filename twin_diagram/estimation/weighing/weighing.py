"""An object's mass, centre and inertia, from the torques of an arm that moved it and from its shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin_diagram.assets.building.measured import MeasuredInertia
from twin_diagram.estimation.weighing.held import WeighingError
from twin_diagram.estimation.weighing.posterior import Posterior, posterior
from twin_diagram.estimation.weighing.shape import Shape
from twin_diagram.estimation.weighing.shape_prior import ShapePrior
from twin_diagram.estimation.weighing.torque_data import EmptyRun, LoadedRun, read_run
from twin_diagram.estimation.weighing.torque_fit import ArmDoubt, TorqueFit, fit_torques
from twin_diagram.model.model import Model
from twin_diagram.model.rigid_body.mass_properties import about_centre, six_of
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    rounds: int = 4
    """Of fit and posterior in turn: gain times object is linearised anew in each; three change nothing any more."""

    first_mass: float = 0.5
    """With which the first round begins [kg]; the result does not depend on it."""

    prompt: float = 1e-5
    """A delay below this is none [s]: a torque that turns by 100 N·m/s is off by 1 mN·m."""

    measured: float = 0.9
    """Share of the variance before the torques that they take away, from which a parameter counts as measured."""

    partly: float = 0.3
    """The same, from which it is partly measured; below, it is from the shape alone."""

    prior_draws: int = 3000
    """Bodies drawn for the variance beforehand."""

    half: float = 1.96
    """Half of a 95 % interval, in standard errors."""


TUNING = Tuning()
PARAMETERS = ("mass", "hx", "hy", "hz", "ixx", "iyy", "izz", "ixy", "ixz", "iyz")
"""Names of the ten: mass [kg], mass × centre [kg·m], inertia about O's origin [kg·m²], in O."""
VERDICTS = ("measured", "partly", "from shape alone")
"""Words of `verdict`: by torques; by both; by the surface and what is likely within it."""


@dataclass(frozen=True)
class Weighing:
    """What an object weighs, in its frame O.

    Attributes:
        parameters: (10,) in the order of `PARAMETERS`; physical.
        covariance: (10, 10) of them, with what is left of gains, offsets, frictions, hand and grasp in it.
        mass: [kg]
        centre: (3,) of mass [m].
        inertia: (3, 3) about the centre [kg·m²].
        moments: (3,) principal moments about the centre, smallest first [kg·m²].
        axes: (3, 3) their axes, as columns.
        errors: standard errors of `mass`, `centre`, `moments`, `inertia` (six: xx, yy, zz, xy, xz, yz).
        verdicts: for each of `PARAMETERS`, and for `moment_1` to `moment_3`: one of `VERDICTS`.
        gain, gain_std: (m,) relative errors of the torques' gains, measured over true less one.
        delay: by which torques were logged later than the motion that they belong to [s].
        noise: (m,) standard deviation of the residual torque below 8 Hz [N·m].
        fit: what the torques alone say.
        posterior: bodies drawn, for whoever wants other intervals.
    """

    parameters: Array
    covariance: Array
    mass: float
    centre: Array
    inertia: Array
    moments: Array
    axes: Array
    errors: dict[str, Array]
    verdicts: dict[str, str]
    gain: Array
    gain_std: Array
    delay: float
    noise: Array
    fit: TorqueFit
    posterior: Posterior

    def interval(self) -> tuple[Array, Array]:
        """Return lower and upper ends (10,) of the 95 % intervals of the ten parameters."""
        std = np.sqrt(np.diag(self.covariance))
        return self.parameters - TUNING.half * std, self.parameters + TUNING.half * std

    def measured(self) -> MeasuredInertia:
        """Return what an asset takes (`AssetPlace.measured`): centre and inertia are worth their worst verdict."""
        groups = {"mass": ("mass",), "centre": ("hx", "hy", "hz"), "inertia": ("moment_1", "moment_2", "moment_3")}
        by = {name: max((self.verdicts[one] for one in group), key=VERDICTS.index) for name, group in groups.items()}
        std = self.errors
        _, centre, inertia = about_centre(self.posterior.bodies)
        spreads = together(centre, self.centre), together(six_of(inertia), six_of(self.inertia))
        return MeasuredInertia(
            self.mass, self.centre, self.inertia, float(std["mass"]), std["centre"], std["inertia"], by, *spreads
        )

    def as_dict(self) -> dict[str, Any]:
        """Return what a file should hold, in plain lists."""
        return {
            "mass": {"value": self.mass, "std": float(self.errors["mass"]), "unit": "kg"},
            "centre": {"value": self.centre.tolist(), "std": self.errors["centre"].tolist(), "unit": "m"},
            "inertia": {"value": self.inertia.tolist(), "std": self.errors["inertia"].tolist(), "unit": "kg·m²"},
            "moments": {"value": self.moments.tolist(), "std": self.errors["moments"].tolist(), "unit": "kg·m²"},
            "parameters": dict(zip(PARAMETERS, self.parameters.tolist(), strict=True)),
            "covariance": self.covariance.tolist(),
            "verdicts": self.verdicts,
            "gain": {"value": self.gain.tolist(), "std": self.gain_std.tolist()},
        }


def weigh(
    model: Model,
    loaded: LoadedRun | Sequence[LoadedRun],
    empty: EmptyRun | Sequence[EmptyRun],
    prior: ShapePrior | Shape,
    torque_side: str | None = None,
    doubt: ArmDoubt | None = None,
    seed: int = 0,
) -> Weighing:
    """Return the ten inertial parameters of an object, its shape's word included.

    The joints' gains, offsets and frictions, small errors of the hand and of where the object sits in it are found
    along, from runs with and without the object; what is left unknown of them is in the covariance. The arm's own
    inertia, which the model knows, is what gains are calibrated by. The estimate is the posterior's mean under
    the most probable wall.

    Args:
        model: the arm, loaded for the side that torques are measured on.
        loaded: runs with the object in the hand; one at least. Its frame O must be the same body frame in all.
        empty: runs without it, at the same finger opening; none: gains are then known by `doubt` and gravity alone.
        prior: the object's shape and what it is trusted for; a bare shape: for what is usual.
        torque_side: `motor` or `link`, of the logs; None: the model's. Logs that do not say are motor-side.
        doubt: how far the arm may be from its model; None: `ArmDoubt.of_side`.
        seed: of the bodies drawn.

    Raises:
        WeighingError: no run with the object, logs where runs should be, a model of the other side, logs too short, too
            slow or not finite.
        LogError: a log that lacks joints or torques.
    """
    side = "link" if model.arm.link_side else "motor"
    if torque_side is not None and torque_side != side:
        raise WeighingError(
            f"torque_side {torque_side!r}: the model was loaded for torques at the {side}; load it anew"
        )
    told = _runs(loaded, empty)
    prior = ShapePrior(prior) if isinstance(prior, Shape) else prior
    doubt = ArmDoubt.of_side(side) if doubt is None else doubt
    delay = 0.0
    runs = [read_run(model, run) for run in told]
    guess = prior.shape.even(TUNING.first_mass)
    start: float | Array = TUNING.first_mass
    fit: TorqueFit | None = None
    for round_ in range(TUNING.rounds):
        fit = fit_torques(runs, doubt, guess, fit)
        found = posterior(fit.matrix, fit.vector, prior.hypotheses, start, seed)
        guess, start = found.mean, found.modes
        if abs(fit.delay) > TUNING.prompt and round_ + 1 < TUNING.rounds:
            delay += fit.delay
            runs = [read_run(model, run, delay) for run in told]
    assert fit is not None
    return _summary(fit, found, prior, delay + fit.delay, seed)


def _runs(loaded: LoadedRun | Sequence[LoadedRun], empty: EmptyRun | Sequence[EmptyRun]) -> list[LoadedRun | EmptyRun]:
    """Return all runs, those with the object first; raises as `weigh`."""
    with_it = [loaded] if isinstance(loaded, LoadedRun) else list(loaded)
    without = [empty] if isinstance(empty, EmptyRun) else list(empty)
    if not with_it:
        raise WeighingError("no run with the object in the hand; at least one is needed")
    for name, kind, runs in (("loaded", LoadedRun, with_it), ("empty", EmptyRun, without)):
        for run in runs:
            if not isinstance(run, kind):
                raise WeighingError(f"{name}: {type(run).__name__} is no {kind.__name__}; make one of each log")
    return [*with_it, *without]


def _summary(fit: TorqueFit, found: Posterior, prior: ShapePrior, delay: float, seed: int) -> Weighing:
    parameters, covariance = found.mean, found.covariance
    mass, centre, inertia = about_centre(parameters)
    moments, axes = np.linalg.eigh(inertia)
    each_mass, each_centre, each_inertia = about_centre(found.bodies)
    # Along the estimate's own axes: sorted moments of drawn bodies push each other apart where two are alike.
    along = np.einsum("ik,nij,jk->nk", axes, each_inertia, axes)
    order = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    errors: dict[str, Array] = {
        "mass": about(each_mass, mass),
        "centre": about(each_centre, centre),
        "moments": about(along, moments),
        "inertia": np.array([about(each_inertia[:, i, j], inertia[i, j]) for i, j in order]),
    }
    before = prior.hypotheses.drawn(float(mass), TUNING.prior_draws, np.random.default_rng(seed))
    by_axis = np.einsum("ik,nij,jk->nk", axes, about_centre(before)[2], axes)
    known = np.concatenate([np.var(before, axis=0), np.var(by_axis, axis=0)])
    known[0] = mass**2  # of the mass the shape says nothing
    left = np.concatenate([np.diag(covariance), errors["moments"] ** 2])
    names = (*PARAMETERS, "moment_1", "moment_2", "moment_3")
    verdicts = {name: verdict(1.0 - a / b) for name, a, b in zip(names, left, known, strict=True)}
    return Weighing(
        parameters, covariance, float(mass), centre, inertia, moments, axes, errors, verdicts,
        fit.gain, fit.gain_std, delay, fit.noise, fit, found,
    )  # fmt: skip


def about(draws: Array, told: Array) -> Array:
    """Return the standard errors (…) of what is told (…), by draws (S, …) of what it may be."""
    return np.asarray(np.sqrt(np.mean((draws - told) ** 2, axis=0)))


def together(draws: Array, told: Array) -> Array:
    """Return the covariance (k, k) of what is told (k,), by draws (S, k): `about` squared is its diagonal."""
    off = draws - told
    return np.asarray(off.T @ off / len(off))


def verdict(share: float) -> str:
    """Return the word for a share of the variance that torques took away."""
    if share >= TUNING.measured:
        return VERDICTS[0]
    return VERDICTS[1] if share >= TUNING.partly else VERDICTS[2]
