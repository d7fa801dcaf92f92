"""How far a model and its corrected version are from measured runs, joint by joint: the gap before and after."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.search.bench import TUNING as BENCH
from twin_diagram.logs import Log
from twin_diagram.logs.differentiation import below_cutoff, inner, motion
from twin_diagram.model.model import Model
from twin_diagram.model.prediction import rollout_rms, torque_residual
from twin_diagram.signals import units
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    exercised: float = 0.02
    """A run whose predicted torques change by less than this share of the noise proves nothing for or against a
    model."""

    beyond: float = 1.25
    """A residual that is less than this many times the noise is no gap: noise itself differs from run to run."""

    apart: float = 5.0
    """Times what is left of the fitted runs from which on what is left of another run is no matter of its motion. Of
    real arms' short logs, friction's rough laws leave up to 2.8 times as much of other motion."""

    unexplained: float = 0.5
    """Share of a held-out residual that must be left, too, where a run is said not to be explained."""

    horizon: float = 0.2
    """Length of a rollout [s]."""

    rollouts: int = 600
    """Evenly spread over the held-out run: their error is that of all to a few hundredths, at a fraction of the time.
    On a run of 21 s that of 400, 800 and 1,500 differs by 4 % at the most."""


TUNING = Tuning()


@dataclass(frozen=True)
class Comparison:
    """One run, held against the given and the corrected model. Its M samples leave out the run's ends.

    Columns of prismatic joints are in m, m/s, m/s² and N.

    Attributes:
        source: what to call the run.
        held_out: whether nothing was fitted to it.
        joints: names of the n columns.
        time: (M,) on the run's own clock [s].
        position: (M, n) [rad].
        velocity: (M, n) [rad/s].
        acceleration: (M, n) [rad/s²].
        torque: (M, n) logged, low-passed [N·m].
        before: (M, n) logged less predicted torque of the given model, low-passed [N·m].
        after: (M, n) of the corrected model.
        rollout_before: (n,) root mean square of measured less rolled-out positions [rad]; None: not worked out.
        rollout_after: likewise.
    """

    source: str
    held_out: bool
    joints: tuple[str, ...]
    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    before: Array
    after: Array
    rollout_before: Array | None = None
    rollout_after: Array | None = None

    def uncorrected(self) -> Comparison:
        """Return the same, as if nothing had been corrected."""
        return replace(self, after=self.before, rollout_after=self.rollout_before)


@dataclass(frozen=True)
class Shown:
    """The gap over all runs.

    Attributes:
        joints: names of the n columns.
        fit: the runs that were fitted.
        holdout: the run that was not.
        noise_floor: (n,) torque noise below the residual's cutoff, as well as it is known [N·m].
        prismatic: which of the joints are; what is theirs is in m and N.
    """

    joints: tuple[str, ...]
    fit: tuple[Comparison, ...]
    holdout: Comparison
    noise_floor: Array
    prismatic: frozenset[str] = frozenset()

    def uncorrected(self) -> Shown:
        """Return the same, as if nothing had been corrected."""
        runs = tuple(run.uncorrected() for run in self.fit)
        return replace(self, fit=runs, holdout=self.holdout.uncorrected())

    def units(self, unit: str) -> tuple[str, ...]:
        """Return (n) of a quantity on each joint, from its unit on a revolute joint."""
        return tuple(units.on_joint(unit, joint in self.prismatic) for joint in self.joints)

    def fit_rms(self) -> tuple[Array, Array]:
        """Return (n,) residual torque before and after over all fitted runs [N·m]."""
        return rms([run.before for run in self.fit]), rms([run.after for run in self.fit])

    def holdout_rms(self) -> tuple[Array, Array]:
        """Return (n,) residual torque before and after over the held-out run [N·m]."""
        return rms([self.holdout.before]), rms([self.holdout.after])

    def has_gap(self) -> npt.NDArray[np.bool_]:
        """Return (n,) whether the given model's held-out residual is more than what noise does by chance."""
        return np.asarray(self.holdout_rms()[0] > TUNING.beyond * self.noise_floor)

    def left_over(self) -> float:
        """Return the share of the held-out gap above the noise that is left, all joints together.

        1 where there was none. Joints count in units of their noise, so that a wrist weighs as much as a shoulder, and
        where the corrected model makes a gap of what was none, it counts, too.
        """
        before, after = (above_noise(x, self.noise_floor) / self.noise_floor for x in self.holdout_rms())
        there = self.has_gap() | self.worse()
        before, after = before[there], after[there]
        whole = float(np.linalg.norm(before))
        return float(np.linalg.norm(after)) / whole if whole > 0.0 else 1.0

    def shrinks(self) -> bool:
        """Return whether the held-out residual falls, each joint in units of its noise."""
        before, after = (x / self.noise_floor for x in self.holdout_rms())
        return float(np.sum(after**2)) < float(np.sum(before**2))

    def worsens(self) -> bool:
        """Return whether any joint's held-out residual rises clearly: no truth mends one joint at another's cost."""
        return bool(np.any(self.worse()))

    def worse(self) -> npt.NDArray[np.bool_]:
        """Return (n,) whether a joint's held-out residual rises clearly."""
        before, after = self.holdout_rms()
        return np.asarray(after > TUNING.beyond * np.maximum(before, TUNING.beyond * self.noise_floor))

    def unexplained(self) -> tuple[str, ...]:
        """Return the joints whose held-out residual is left where the fitted runs' own is not.

        Something differs between the runs then, as where a load was taken up or put down.
        """
        fitted, (before, after) = self.fit_rms()[1], self.holdout_rms()
        much = after > TUNING.apart * np.maximum(fitted, TUNING.beyond * self.noise_floor)
        return self._some(much & (after > TUNING.unexplained * before))

    def further_off(self) -> tuple[str, ...]:
        """Return the joints whose held-out residual rises clearly."""
        return self._some(self.worse())

    def _some(self, which: npt.NDArray[np.bool_]) -> tuple[str, ...]:
        return tuple(joint for joint, one in zip(self.joints, which, strict=True) if one)

    def is_exercised(self) -> bool:
        """Return whether the held-out run does anything that tells the two models apart, beside its noise."""
        change = rms([self.holdout.after - self.holdout.before])
        return bool(np.any(change > TUNING.exercised * self.noise_floor))


def told_of_held_out(shown: Shown, unexplained: Sequence[str]) -> list[str]:
    """Return what is said where the held-out run is no other motion of the same robot, as it seems.

    Args:
        shown: the gap.
        unexplained: joints on which that run is left unexplained.
    """
    if unexplained:
        return [
            f"on the held-out run most of the residual is left on {', '.join(unexplained)}, though the fitted runs are "
            "explained: something differs there (a load that was taken up or put down, another tool), or the fitted "
            "motion tells too little; fit that run, too, to find out"
        ]
    if joints := shown.further_off():
        return [
            f"on the held-out run the corrected model is further off than the given one on {', '.join(joints)}: it is "
            "another robot's, or what was named holds of the fitted motion alone"
        ]
    return []


def show(
    given: Model,
    corrected: Model,
    fit: Sequence[Log],
    holdout: Log,
    noise_floor: Array,
    horizon: float = TUNING.horizon,
    say: Callable[[str], None] | None = None,
) -> Shown:
    """Work out the gap of both models on all runs; rollouts on the held-out run alone.

    Args:
        given: with the logs' joints in the logs' order.
        corrected: likewise; the same object where nothing was corrected.
        fit: checked logs.
        holdout: a checked log.
        noise_floor: (n,) torque noise after the residual's low-pass [N·m], known without any of the two models
            (`noise_below`); where logs were smoothed and show none, what a search takes for noise at least, counts.
        horizon: of the rollouts [s].
        say: told what is being done.
    """
    say = say or (lambda text: None)
    say("residual torque before and after")
    runs = tuple(compare(given, corrected, log) for log in fit)
    say("rollouts of the held-out run before and after")
    held = compare(given, corrected, holdout, held_out=True, horizon=horizon)
    least = np.maximum(BENCH.finest * rms([run.torque for run in runs]), 1e-12)
    return Shown(given.joints, runs, held, np.maximum(noise_floor, least), given.prismatic)


def compare(
    given: Model, corrected: Model, log: Log, *, held_out: bool = False, horizon: float | None = None
) -> Comparison:
    """Return one run against both models; rollouts where a horizon is given [s]."""
    smooth = motion(log)
    regular = smooth.log
    kept = inner(regular.time)
    changed = corrected is not given

    def rolled(model: Model) -> Array:
        assert horizon is not None
        return rollout_rms(model, log, horizon, smooth, TUNING.rollouts)

    before = torque_residual(given, log, smooth)
    rollout = None if horizon is None else rolled(given)
    return Comparison(
        source=log.source,
        held_out=held_out,
        joints=given.joints,
        time=regular.time[kept],
        position=smooth.position[kept],
        velocity=smooth.velocity[kept],
        acceleration=smooth.acceleration[kept],
        torque=below_cutoff(regular.motor_torque, regular),
        before=before,
        after=torque_residual(corrected, log, smooth) if changed else before,
        rollout_before=rollout,
        rollout_after=rolled(corrected) if changed and horizon is not None else rollout,
    )


def rms(parts: Sequence[Array]) -> Array:
    """Return (n,) root mean square over all samples of several (M, n)."""
    squares = sum(np.sum(part**2, axis=0) for part in parts)
    return np.asarray(np.sqrt(squares / sum(len(part) for part in parts)))


def above_noise(value: Array, noise: Array) -> Array:
    """Return what is left of a root mean square (n,) when independent noise (n,) is taken out."""
    return np.sqrt(np.maximum(value**2 - noise**2, 0.0))
