"""What a model says of a measured log: the torque that its motion takes, and the motion that its torque makes.

The gap between model and measurement is computed from these alone.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pydrake.multibody.tree import PrismaticJoint, RevoluteJoint

from twin_diagram.errors import LogError
from twin_diagram.logs import Log, LogWarning, check, fingerprint, read_log, unwrapped, write_columns
from twin_diagram.logs.dejittering import dejittered
from twin_diagram.logs.differentiation import TUNING as DIFFERENTIATION
from twin_diagram.logs.differentiation import Motion, below_cutoff, inner, lowpass, motion
from twin_diagram.logs.downsampling import downsampled
from twin_diagram.logs.parting import longest, parted
from twin_diagram.logs.prefixes import under_names_of
from twin_diagram.logs.torque_constants import TorqueConstants
from twin_diagram.logs.writing import check_kind
from twin_diagram.model.description import add_arm as description
from twin_diagram.model.description import held_joints
from twin_diagram.model.model import Model
from twin_diagram.model.rollout import rollout, trajectory
from twin_diagram.runtime.output_place import why_not
from twin_diagram.runtime.threads import one_thread
from twin_diagram.signals.arrays import Array

__all__ = [
    "load_model_for",
    "lowpass",
    "position_predicted",
    "predict",
    "rollout_rms",
    "torque_predicted",
    "torque_residual",
    "torque_residual_rms",
]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand: results do not depend on them."""

    long_rate: float = 200.0
    """Of long and fast logs, samples per second that are rolled out to: ten minutes are 600 000 rollouts else [1/s]."""

    starts_at_once: int = 4096
    """Rollouts that run side by side: they share the work per step, but their arrays must stay in memory."""


TUNING = Tuning()


def torque_predicted(model: Model, log: Log, smooth: Motion | None = None) -> Array:
    """Return the torque (N, n) that the motors must have given for the measured motion, at the log's own times [N·m].

    Args:
        model: with the log's joints, in the log's order.
        log: checked.
        smooth: `motion(log)`, where the caller has it.
    """
    smooth = motion(log) if smooth is None else smooth
    regular = smooth.log
    model = model.for_run(fingerprint(log))
    tau = model.inverse_dynamics(
        smooth.position, smooth.velocity, smooth.acceleration, time=regular.time, seen=_torque_or_none(regular)
    )
    return _at(log.time, regular.time, tau)


def _torque_or_none(log: Log) -> Array | None:
    return None if log.torque is None and log.torque_commanded is None else log.motor_torque


@np.errstate(over="ignore", invalid="ignore")  # torques that no arm could answer send it far away
def position_predicted(
    model: Model, log: Log, horizon: float = 0.2, smooth: Motion | None = None, every: int = 1
) -> Array:
    """Return the positions (N, n), each rolled out open loop from the measured state `horizon` seconds earlier [rad].

    The rollout starts at the measured position and the smoothed velocity, and applies the measured torques. Samples
    earlier than `horizon` after the log's begin are rolled out from its first sample. Where `every` is more than one,
    only each so many-th sample is rolled out to, and how far it is from the motion goes evenly in between.

    Raises:
        LogError: the horizon is not positive, or longer than the log.
    """
    smooth = motion(log) if smooth is None else smooth
    regular = smooth.log
    if not 0.0 < horizon < regular.time[-1] - regular.time[0]:
        span = f"the log's {regular.time[-1] - regular.time[0]:.3g} s"
        raise LogError(f"{log.source}: horizon {horizon:g} s: must be positive and shorter than {span}")
    rolled = _Rolled(model.for_run(fingerprint(log)), smooth, horizon)
    steps = rolled.steps
    result = np.empty_like(regular.position)
    result[0] = regular.position[0]
    if steps > 1:
        early = trajectory(*rolled.arguments(np.zeros(1, dtype=np.int64), steps - 1), arrived=True)
        result[1:steps] = [position[0] for position in early]
    starts = np.arange(0, len(regular) - steps, every)
    for first in range(0, len(starts), TUNING.starts_at_once):
        chosen = starts[first : first + TUNING.starts_at_once]
        result[chosen + steps] = rollout(*rolled.arguments(chosen, steps), arrived=True)
    if every > 1:
        known = np.concatenate([np.arange(steps), starts + steps])
        away = _at(regular.time, regular.time[known], result[known] - smooth.position[known])
        result = smooth.position + away
    return _at(log.time, regular.time, result)


class _Rolled:
    """What rollouts of one log start from and are driven by."""

    def __init__(self, model: Model, smooth: Motion, horizon: float) -> None:
        self.model, self.smooth = model, smooth
        regular = smooth.log
        self.steps = max(1, round(horizon / regular.period))
        self.period = (regular.time[-1] - regular.time[0]) / (len(regular) - 1)
        self.tau = model.applied(regular.motor_torque, regular.time)
        self.angles, self.rates = twists(model, smooth)

    def arguments(self, chosen: npt.NDArray[np.int64], count: int) -> tuple[Any, ...]:
        """Of `rollout`, from the chosen samples over `count` periods."""
        regular = self.smooth.log
        torques = np.stack([self.tau[chosen + k] for k in range(count + 1)])
        begin = (regular.position[chosen], self.smooth.velocity[chosen])
        twist = (self.angles[chosen], self.rates[chosen])
        return (self.model, *begin, torques, self.period, regular.time[chosen], twist)


def twists(model: Model, smooth: Motion) -> tuple[Array, Array]:
    """Return the angles and rates, each (N, s), of the gears that yield, for a measured motion [rad], [rad/s]."""
    count = len(model.law.yielding)
    if count == 0:
        return np.zeros((len(smooth.log), 0)), np.zeros((len(smooth.log), 0))
    time = smooth.log.time
    period = (time[-1] - time[0]) / (len(time) - 1)
    q, torque = model.true_position(smooth.position), _torque_or_none(smooth.log)
    beyond = None
    if torque is not None:
        beyond = model.applied(torque, time) - model.law.joint_load(q, smooth.velocity, smooth.acceleration)
    found = model.law.twist((q, smooth.velocity, smooth.acceleration), period, beyond)
    return found.angle, found.rate


def _at(times: Array, regular: Array, values: Array) -> Array:
    """Bring values at regular times to a log's own."""
    if len(times) == len(regular) and np.array_equal(times, regular):
        return values
    return np.stack([np.interp(times, regular, values[:, k]) for k in range(values.shape[1])], axis=1)


def torque_residual(model: Model, log: Log, smooth: Motion | None = None) -> Array:
    """Return the measured less predicted torque, low-passed, without the log's ends (M, n) [N·m].

    This is the residual of gap.json's `torque_rms` and of the report.

    Args:
        model: with the log's joints, in the log's order.
        log: checked.
        smooth: `motion(log)`, where the caller has it.
    """
    smooth = motion(log) if smooth is None else smooth
    regular = smooth.log
    return below_cutoff(regular.motor_torque - torque_predicted(model, regular, smooth), regular)


def torque_residual_rms(model: Model, log: Log, smooth: Motion | None = None) -> Array:
    """Return the root mean square of `torque_residual` per joint (n,) [N·m].

    Args:
        model: as of `torque_residual`.
        log: likewise.
        smooth: likewise.
    """
    return np.asarray(np.sqrt(np.mean(torque_residual(model, log, smooth) ** 2, axis=0)))


@np.errstate(over="ignore", invalid="ignore")  # torques that no arm could answer send it far away
def rollout_rms(
    model: Model, log: Log, horizon: float = 0.2, smooth: Motion | None = None, most: int | None = None
) -> Array:
    """Return the root mean square per joint (n,) of measured less rolled-out positions, without the log's ends [rad].

    Args:
        model: as of `position_predicted`.
        log: likewise.
        horizon: likewise [s].
        smooth: likewise.
        most: evenly spread samples that are enough; None: all.
    """
    smooth = motion(log) if smooth is None else smooth
    regular = smooth.log
    if most is None or np.sum(inner(log.time)) <= most:
        error = (log.position - position_predicted(model, log, horizon, smooth))[inner(log.time)]
        return np.asarray(np.sqrt(np.mean(error**2, axis=0)))
    rolled = _Rolled(model.for_run(fingerprint(log)), smooth, horizon)
    ends = np.flatnonzero(inner(regular.time) & (np.arange(len(regular)) >= rolled.steps))
    ends = ends[np.linspace(0, len(ends) - 1, most).astype(int)]
    error = regular.position[ends] - rollout(*rolled.arguments(ends - rolled.steps, rolled.steps), arrived=True)
    return np.asarray(np.sqrt(np.mean(error**2, axis=0)))


def load_model_for(
    log: Log,
    model: str | Path,
    packages: Mapping[str, str | Path] | None = None,
    torque_side: str | None = None,
    constants: TorqueConstants | None = None,
    joints: Sequence[str] = (),
) -> tuple[Model, Log, list[LogWarning]]:
    """Return a model and a log that go together.

    The model with the log's joints, the log in the model's order, checked.

    Joints of the description that are driven by default must be in the log, but for those that the logged ones do not
    feel: another arm's, which are held. Prismatic joints become the arm's where the log has them. A prefix before all
    names, of the model's or the log's alone, makes no difference (`under_names_of`). `torque_side` as of
    `Model.load`, `constants` as of `as_explained`; `joints` names those of one arm of a robot that has more.

    Raises:
        ModelError: see `Model.load`.
        LogError: see `logs.check`.
    """
    spec = description.resolve(model, packages)
    if joints:
        named = Model.load(replace(spec, joints=list(joints)), packages, torque_side=torque_side)
        return (named, *as_explained(named, log, constants))
    loaded = Model.load(spec, packages, torque_side=torque_side)
    log = under_names_of(loaded.joints, log)
    held = []
    if apart := _of_another_arm(loaded, log):
        rest = [joint for joint in loaded.joints if joint not in apart]
        loaded = Model.load(replace(spec, joints=rest), packages, torque_side=torque_side)
        said = f"{log.source}: lacks {', '.join(apart)}, which the arm in it does not feel: they are held"
        held = [LogWarning("held_joints", said)]
    movable = [
        joint.name()
        for joint in map(loaded.plant.get_joint, loaded.plant.GetJointIndices())
        if isinstance(joint, (RevoluteJoint, PrismaticJoint))
    ]
    logged = [joint for joint in movable if joint in loaded.joints or joint in log.joints]
    if len(logged) > len(loaded.joints):
        loaded = Model.load(replace(spec, joints=logged), packages, torque_side=torque_side)
    own, warnings = as_explained(loaded, log, constants)
    return loaded, own, [*held, *warnings]


def _of_another_arm(model: Model, log: Log) -> list[str]:
    """Return the model's joints that a log lacks, where none of them carries a logged one or is carried by one."""
    every = [model.plant.get_joint(index) for index in model.plant.GetJointIndices()]
    missing = [joint for joint in model.joints if joint not in log.joints]
    logged = [joint for joint in every if joint.name() in model.joints and joint.name() in log.joints]
    felt = {*model.joints} - {joint.name() for joint in held_joints.elsewhere(logged, every)}
    return missing if logged and felt.isdisjoint(missing) else []


def as_explained(model: Model, log: Log, constants: TorqueConstants | None = None) -> tuple[Log, list[LogWarning]]:
    """Return a log as a model explains it: checked, with the model's joints in its order.

    Angles that go on past a turn; torques where `constants` say what its currents are worth.

    Raises:
        LogError: see `logs.check`.
    """
    log = under_names_of(model.joints, log)
    log = log if constants is None else constants.applied(log, model.joints)
    warnings = check(log, model.limits)
    if log.link_side and not model.arm.link_side:
        message = f"{log.source}: its torques are measured behind the gears, where no rotor shows: --torque-side link"
        warnings.append(LogWarning("torque_side", message))
    own, wrapped = unwrapped(log.select(model.joints), model.limits.revolute)
    return own, warnings + wrapped


@one_thread()
def predict(
    model: str | Path,
    log: str | Path,
    out: str | Path,
    horizon: float = 0.2,
    packages: Mapping[str, str | Path] | None = None,
    columns: str | Path | None = None,
    say: Callable[[str], None] | None = None,
    torque_side: str | None = None,
    constants: TorqueConstants | None = None,
    joints: Sequence[str] = (),
) -> list[LogWarning]:
    """Read a log, and write `torque_predicted.<joint>` and `position_predicted.<joint>` for each of its samples.

    Args:
        model: a description, or the folder of a corrected model.
        log: .csv or .npz.
        out: .csv or .npz; appears once it is whole.
        horizon: length of the rollouts [s].
        packages: local folders for `package://` names.
        columns: what a foreign log's columns mean, see `read_log`.
        say: told each joint's root mean square of measured less predicted torque and position, without the log's ends;
            of the longest stretch, where the log is silent in between.
        torque_side: of the gears that the torque was measured on, `motor` or `link`; None: as the model says.
        constants: of the motors, where the log holds currents.
        joints: of one arm, in order, of a robot that has more; the others are held. Empty: all.

    Raises:
        TwinError: the model or the log cannot be used; nothing is written.
    """
    check_kind(Path(out))
    if why := why_not(out, folder=False):
        raise LogError(f"--out {out}: {why}")
    raw = read_log(log, columns)
    loaded, measured, warnings = load_model_for(raw, model, packages, torque_side, constants, joints)
    turned = measured.position - under_names_of(loaded.joints, raw).select(loaded.joints).position
    for warning in warnings:
        logging.getLogger("twin_diagram").warning("%s (%s)", warning.message, warning.code)
    even = dejittered(measured)
    used = downsampled(even)
    predicted = {"time": measured.time}
    every = 1 if used is even else max(1, round(1.0 / (TUNING.long_rate * used.period)))
    stretches = [_Stretch.of(loaded, part, horizon, every) for part in _parts(used, horizon)]
    torque, position = _joined(used, stretches)
    for name, values in (
        ("torque_predicted", _at(even.time, used.time, torque)),
        ("position_predicted", _at(even.time, used.time, position) - turned),
    ):
        predicted |= {f"{name}.{joint}": values[:, k] for k, joint in enumerate(loaded.joints)}
    write_columns(predicted, out)
    if say is not None:
        shown = longest([one.log for one in stretches[len(stretches) > 1 :]])
        if len(shown) < len(used):  # nobody knows the motion of a silence: what a spline makes of it is no misfit
            say(f"of {shown.time[0]:.2f} to {shown.time[-1]:.2f} s, the longest stretch without a gap:")
        for line in next(one for one in stretches if one.log is shown).misfit(loaded, horizon):
            say(line)
    return warnings


def _parts(log: Log, horizon: float) -> list[Log]:
    """Return the stretches of a log without silence; before them all of it, for samples that are in none of them."""
    parts = parted(log, horizon + 2.0 * DIFFERENTIATION.residual_cut)
    return parts if len(parts[0]) == len(log) else [log, *parts]


@dataclass(frozen=True)
class _Stretch:
    """What is predicted of a stretch of a log by its own motion alone; arrays (N, n) at its own times."""

    log: Log
    smooth: Motion
    torque: Array
    position: Array

    @staticmethod
    def of(model: Model, log: Log, horizon: float, every: int) -> _Stretch:
        """Predict."""
        smooth = motion(log)
        position = position_predicted(model, log, horizon, smooth, every)
        return _Stretch(log, smooth, torque_predicted(model, log, smooth), position)

    def misfit(self, model: Model, horizon: float) -> list[str]:
        """Return `_misfit` of it."""
        return _misfit(model, self.log, self.smooth, self.position, horizon)


def _joined(log: Log, stretches: Sequence[_Stretch]) -> tuple[Array, Array]:
    """Return torques and positions (N, n) at a log's times, of the last stretch that each sample is in."""
    torque, position = (np.empty_like(log.position) for _ in range(2))
    for one in stretches:
        inside = (log.time >= one.log.time[0]) & (log.time <= one.log.time[-1])
        torque[inside] = _at(log.time[inside], one.log.time, one.torque)
        position[inside] = _at(log.time[inside], one.log.time, one.position)
    return torque, position


def _misfit(model: Model, log: Log, smooth: Motion, arrived: Array, horizon: float) -> list[str]:
    """Return a table of each joint's root mean square of measured less predicted, as lines of text."""
    kept = inner(log.time)
    if not kept.any():
        return ["RMS, measured less predicted: none, the log is too short (0.3 s are left out at each end)"]
    position = np.sqrt(np.mean((log.position - arrived)[kept] ** 2, axis=0))
    torque = torque_residual_rms(model, log, smooth)
    wide = max(len(joint) for joint in model.joints)
    lines = [f"{'RMS, measured less predicted':<{wide}}  torque (to 10 Hz)  position ({horizon:g} s ahead)"]
    for k, joint in enumerate(model.joints):
        force, length = ("N·m", "mrad") if model.limits.revolute[k] else ("N", "mm")
        lines.append(f"{joint:<{wide}}  {torque[k]:12.4g} {force:<4}  {1e3 * position[k]:12.4g} {length}")
    return lines
