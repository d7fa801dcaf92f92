"""Draws a case from its kind and seed, lets the arm run, and writes what the workflow under test may see."""

from __future__ import annotations

import json
import shutil
import tempfile
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from gap_truth import excitation, hidden, several_joints
from gap_truth.chain import Chain, random_chain, read_urdf, write_urdf
from gap_truth.hidden import Hidden, Scale
from gap_truth.phenomena import install
from gap_truth.world import CONTROL_PERIOD, Controller, DivergedError, Nominal, Truth, World, simulate

Array = npt.NDArray[np.float64]

KINDS = ("clean", "single", "several", "pair", "triple", "onset", "dirty", "outside", "joints", "resting")
ARMS = Path(__file__).resolve().parents[3] / "models" / "arms"
HOMES = {
    "ur5e": (5.0, [0.0, -1.3, 1.4, -1.6, -1.4, 0.0]),
    "panda": (3.0, [0.0, -0.5, 0.0, -1.9, 0.0, 1.7, 0.6]),
    "iiwa7": (7.0, [0.0, 0.6, 0.0, -1.3, 0.0, 0.9, 0.0]),
}
"""Payload [kg] and home [rad]."""

RESTING_PERIODS = (0.01, 0.005, 0.002, 0.001)
"""Of the logs of `resting`, in turn [s]."""

RESTING = (
    *("time_delay", "torque_saturation", "coulomb_friction", "time_delay", "payload"),
    *("backlash", "time_delay", "stribeck_friction", "torque_saturation", "viscous_friction"),
    *("joint_elasticity", "time_delay", "reflected_inertia", "torque_constant", "torque_saturation"),
)
"""What `resting` hides, in turn."""

DURATION = 25.0
CLEAN_DURATION = 12.0
RESTING_DURATION = 15.0
ATTEMPTS = 12


@dataclass(frozen=True)
class Noise:
    """Of the torque sensors and the clock.

    Attributes:
        white: standard deviation (n,) [N·m].
        coloured: of the first-order autoregressive part (n,) [N·m].
        corner: of that part (n,) [Hz].
        jitter: of the time stamps [s].
    """

    white: Array
    coloured: Array
    corner: Array
    jitter: float

    def memory(self, period: float) -> Array:
        """(n,) coefficient of the autoregression."""
        return np.exp(-2.0 * np.pi * self.corner * period)

    def density(self, frequency: Array, period: float) -> Array:
        """Power per sample (F, n) of the torque noise at frequencies (F,) [(N·m)²]: white noise of 1 has 1."""
        phi = self.memory(period)
        z = np.exp(-2j * np.pi * frequency * period)[:, None]
        return np.asarray(self.white**2 + self.coloured**2 * (1.0 - phi**2) / np.abs(1.0 - phi * z) ** 2)

    def draw(self, count: int, period: float, rng: np.random.Generator) -> Array:
        """(count, n) [N·m]."""
        phi = self.memory(period)
        n = len(phi)
        result = rng.normal(size=(count, n)) * self.white
        for j in range(n):
            drive = rng.normal(size=count) * self.coloured[j] * np.sqrt(1.0 - phi[j] ** 2)
            drive[0] = rng.normal() * self.coloured[j]
            result[:, j] += lfilter([1.0], [1.0, -phi[j]], drive)
        return result


@dataclass
class Case:
    """One case, with everything that is true of it.

    Attributes:
        kind: of `KINDS`.
        seed: that drew it.
        chain: the arm as described.
        baseline: effects that the given model already has.
        hidden: effects that it lacks.
        period: of the log [s].
        noise: of the log.
        control: of the arm.
        fit, holdout: what happened, without noise.
        clocks: the logs' time at the runs' begin [s].
        extras: optional signals that the logs have.
        setting: for the truth file.
    """

    kind: str
    seed: int
    chain: Chain
    baseline: list[Hidden]
    hidden: list[Hidden]
    period: float
    noise: Noise
    control: Controller
    fit: Truth
    holdout: Truth
    clocks: tuple[float, float]
    extras: tuple[str, ...]
    setting: dict[str, Any] = field(default_factory=dict)


def draw_arm(rng: np.random.Generator) -> Chain:
    """Six joints, seven joints, or a random chain."""
    which = rng.choice(["ur5e", "panda", "iiwa7", "random"], p=[0.3, 0.2, 0.2, 0.3])
    if which == "random":
        chain = random_chain(rng)
    else:
        capacity, home = HOMES[which]
        chain = read_urdf(ARMS / f"{which}.urdf", str(which), capacity, np.array(home))
    if which != "iiwa7" and rng.random() < 0.85:
        size = np.exp(rng.uniform(np.log(0.005), np.log(0.03), chain.n))
        chain = replace(
            chain,
            links=tuple(
                replace(link, rotor=float(np.round(s * link.effort, 5)))
                for link, s in zip(chain.links, size, strict=True)
            ),
        )
    return chain


def make_case(kind: str, seed: int, effect: str | None = None, duration: float | None = None) -> Case:
    """Draws and simulates a case; where the arm does not get through, another is drawn.

    Args:
        kind: of `KINDS`.
        seed: with the kind it says everything.
        effect: to be hidden; None: the seed says which.
        duration: of each run [s]; None: the kind's own.

    Raises:
        DivergedError: no arm got through.
    """
    for attempt in range(ATTEMPTS):
        try:
            return _make(kind, seed, effect, duration, np.random.default_rng([seed, KINDS.index(kind), attempt]))
        except DivergedError:
            if attempt == ATTEMPTS - 1:
                raise
    raise AssertionError


def _make(kind: str, seed: int, effect: str | None, duration: float | None, rng: np.random.Generator) -> Case:
    chain = draw_arm(rng)
    nominal = Nominal(chain)
    clean = kind == "clean"
    length = duration or (CLEAN_DURATION if clean else DURATION)
    period = float(rng.choice([0.001, 0.002, 0.004], p=[0.05, 0.45, 0.5] if clean else [0.15, 0.6, 0.25]))
    kinds = rng.choice(excitation.KINDS, 2, p=[0.4, 0.2, 0.1, 0.3])
    if kind == "resting":
        length, period = duration or RESTING_DURATION, RESTING_PERIODS[seed % len(RESTING_PERIODS)]
        kinds = np.array([excitation.PICKING] * 2)
    speed = rng.uniform(0.25, 0.8)
    fit_motion, fit_torque = _feasible(nominal, str(kinds[0]), length, speed, rng)
    held_motion, held_torque = _feasible(nominal, str(kinds[1]), length, speed, rng)
    scale = _scale(nominal, fit_motion, fit_torque)
    dirty = kind == "dirty" or (clean and rng.random() < 0.3)
    baseline = _baseline(chain, scale, rng) if dirty else []
    things = _draw_hidden(kind, seed, effect, chain, scale, length, rng)
    control, feed = _controller(nominal, scale, fit_motion, things, rng)
    if kind == "resting":
        control = _stiff(control, scale, things, rng)
    integrator = str(rng.choice(["implicitfast", "implicit", "Euler"]))
    noise = _noise(chain, period, rng)
    every = round(period / CONTROL_PERIOD)
    offset = np.zeros(chain.n)
    for thing in things:
        if thing.name == "encoder_offset":
            offset[list(thing.joints)] = thing.values["offset"]
    runs = []
    for motion, torque, ended in ((fit_motion, fit_torque, False), (held_motion, held_torque, True)):
        world = World(chain)
        for thing in [*baseline, *(_afterwards(things) if ended else things)]:
            install(world, thing)
        runs.append(simulate(world, control, motion, feed * torque, every, integrator))
    lasts = float(runs[0].time[-1])
    setting = {
        "excitation": [str(k) for k in kinds],
        "speed": speed,
        "integrator": integrator,
        "arm": chain.kind,
        "duration": lasts,
    }
    clocks = tuple(float(np.round(x, 3)) for x in rng.choice([0.0, 1.0]) * rng.uniform(0.0, 60.0, 2))
    extras = tuple(s for s in ("velocity_estimated", "position_commanded") if rng.random() < 0.5)
    return Case(
        kind, seed, chain, baseline, things, period, noise, control, *runs, (clocks[0], clocks[1]), extras, setting
    )


def _feasible(
    nominal: Nominal, kind: str, duration: float, speed: float, rng: np.random.Generator
) -> tuple[excitation.Motion, Array]:
    """A motion that asks for no more than three quarters of the motors' torque, and that torque."""
    state = rng.bit_generator.state
    for _ in range(8):
        rng.bit_generator.state = state
        motion = excitation.draw(nominal.chain, kind, duration, CONTROL_PERIOD, speed, rng)
        torque = nominal.inverse(motion.q[::25], motion.v[::25], motion.a[::25])
        if np.all(np.abs(torque).max(axis=0) < 0.75 * nominal.chain.column("effort")):
            break
        speed *= 0.75
    else:
        raise DivergedError(f"{kind}: asks for too much torque at any speed")
    return motion, nominal.inverse(motion.q, motion.v, motion.a)


def _scale(nominal: Nominal, motion: excitation.Motion, torque: Array) -> Scale:
    inertia = np.mean([np.diag(nominal.inertia(q)) for q in motion.q[:: len(motion.q) // 10]], axis=0)
    return Scale(
        np.sqrt(np.mean(torque**2, axis=0)),
        np.abs(torque).max(axis=0),
        np.sqrt(np.mean(motion.v**2, axis=0)),
        np.sqrt(np.mean(motion.a**2, axis=0)),
        np.std(motion.q, axis=0),
        np.mean(motion.q, axis=0),
        inertia,
    )


def _baseline(chain: Chain, scale: Scale, rng: np.random.Generator) -> list[Hidden]:
    """Friction on every joint, and at times a payload."""
    joints, effort = tuple(range(chain.n)), chain.column("effort")
    dry = (effort * np.exp(rng.uniform(np.log(0.01), np.log(0.06), chain.n))).round(4)
    viscous = (effort * np.exp(rng.uniform(np.log(0.005), np.log(0.05), chain.n)) / 0.7).round(4)
    result = [
        Hidden("coulomb_friction", joints, None, {"torque": dry.tolist()}),
        Hidden("viscous_friction", joints, None, {"damping": viscous.tolist()}),
    ]
    return result


def _draw_hidden(
    kind: str, seed: int, effect: str | None, chain: Chain, scale: Scale, length: float, rng: np.random.Generator
) -> list[Hidden]:
    if kind == "clean":
        return []
    if kind in ("single", "dirty"):
        name = effect or hidden.NAMES[seed % len(hidden.NAMES)]
        return [_timed(hidden.draw(name, chain, scale, rng), length, rng, kind)]
    if kind == "onset":
        name = effect or hidden.STARTING[seed % len(hidden.STARTING)]
        return [_timed(hidden.draw(name, chain, scale, rng), length, rng, kind)]
    if kind == "several":
        name = effect or hidden.SEVERAL[seed % len(hidden.SEVERAL)]
        return [hidden.draw(name, chain, scale, rng, int(rng.integers(2, 5)))]
    if kind == "resting":
        return [hidden.draw(effect or RESTING[seed % len(RESTING)], chain, scale, rng)]
    if kind == "outside":
        name = effect or hidden.OUTSIDE[seed % len(hidden.OUTSIDE)]
        return [hidden.draw(name, chain, scale, rng)]
    if kind == "joints":
        return several_joints.draw(seed, chain, scale, rng)
    wanted = 2 if kind == "pair" else 3
    while True:
        names = rng.choice(hidden.NAMES, wanted, replace=False)
        things = [_timed(hidden.draw(str(name), chain, scale, rng), length, rng, kind) for name in names]
        if _together(things):
            return sorted(things, key=lambda thing: thing.name)


CLASHING = (
    {"coulomb_friction", "stribeck_friction"},
    {"torque_constant", "actuator_fault"},
    {"joint_elasticity", "backlash"},
    {"reflected_inertia", "joint_elasticity"},
    {"reflected_inertia", "backlash"},
    {"torque_bias", "joint_spring"},
    {"payload", "inertial_parameters"},
)
"""Pairs that are one name, or none, on the same joint."""


def _together(things: list[Hidden]) -> bool:
    for k, one in enumerate(things):
        for other in things[:k]:
            shared = not one.joints or not other.joints or set(one.joints) & set(other.joints)
            if {one.name, other.name} in CLASHING and shared:
                return False
    return True


def _timed(thing: Hidden, length: float, rng: np.random.Generator, kind: str) -> Hidden:
    """With an onset where it has one, and an end where that is in its nature."""
    onset, lasting = rng.uniform(0.2, 0.7) * length, rng.uniform(0.1, 0.25) * length
    onset, lasting = round(onset, 3), round(lasting, 3)
    if thing.name == "external_force":
        return replace(thing, onset=onset, end=onset + lasting)
    if thing.name == "actuator_fault" or kind == "onset":
        return replace(thing, onset=onset)
    return thing


def _afterwards(things: list[Hidden]) -> list[Hidden]:
    """What is left of the effects in a later run: those that started go on, those that ended are gone."""
    return [replace(thing, onset=None) for thing in things if thing.end is None]


def _controller(
    nominal: Nominal, scale: Scale, motion: excitation.Motion, things: list[Hidden], rng: np.random.Generator
) -> tuple[Controller, float]:
    """Gains that a commissioning engineer would leave: stable, and never perfect."""
    effort = nominal.chain.column("effort")
    delay = sum(thing.values["delay"][0] for thing in things if thing.name == "time_delay")
    bandwidth = 2.0 * np.pi * rng.uniform(2.5, 6.0)
    stiffness = np.maximum(scale.inertia * bandwidth**2, rng.uniform(0.8, 2.0) * effort)
    fastest = min(2.0 * np.pi * 30.0, 0.3 / max(delay, 1e-3))
    stiffness = np.minimum(stiffness, scale.inertia * fastest**2)
    rate = np.sqrt(stiffness / scale.inertia)
    bits = rng.integers(16, 21)
    control = Controller(
        stiffness,
        rng.uniform(1.0, 1.6) * scale.inertia * rate,
        np.clip(8.0 * rate, 2.0 * np.pi * 40.0, 2.0 * np.pi * 250.0),
        effort,
        np.full(len(effort), 2.0 * np.pi / 2.0 ** float(bits)),
    )
    return control, float(rng.choice([1.0, rng.uniform(0.7, 0.98)]))


def _stiff(control: Controller, scale: Scale, things: list[Hidden], rng: np.random.Generator) -> Controller:
    """A stiffer one on coarser encoders: what it reads of its own noise comes back as motion."""
    delay = sum(thing.values["delay"][0] for thing in things if thing.name == "time_delay")
    rate = np.full(len(scale.inertia), min(2.0 * np.pi * rng.uniform(6.0, 14.0), 0.4 / max(delay, 1e-3)))
    damping, corner = rng.uniform(1.0, 1.6) * scale.inertia * rate, np.clip(8.0 * rate, 250.0, 1500.0)
    jump = hidden.log_uniform(rng, 0.005, 0.15) * control.limit  # of the torque, where an encoder counts one on
    finest = np.min(jump * CONTROL_PERIOD / (damping * (1.0 - np.exp(-corner * CONTROL_PERIOD))))
    lsb = np.full(len(rate), 2.0 * np.pi / 2.0 ** np.ceil(np.log2(2.0 * np.pi / finest)))
    return replace(control, stiffness=scale.inertia * rate**2, damping=damping, corner=corner, resolution=lsb)


def _noise(chain: Chain, period: float, rng: np.random.Generator) -> Noise:
    level = np.exp(rng.uniform(np.log(0.003), np.log(0.02))) * rng.uniform(0.7, 1.4, chain.n) * chain.column("effort")
    share = rng.uniform(0.0, 0.6, chain.n)
    return Noise(
        level * np.sqrt(1.0 - share),
        level * np.sqrt(share),
        rng.uniform(4.0, 40.0, chain.n),
        float(rng.choice([0.0, 1.0], p=[0.3, 0.7]) * rng.uniform(0.0, 0.05) * period),
    )


def write_case(case: Case, folder: Path) -> None:
    """Writes `model.urdf` or `model/` (a description with corrections), `fit.csv` and `holdout.csv`: no truth."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    staging = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    if case.baseline:
        (staging / "model").mkdir()
        write_urdf(case.chain, staging / "model" / "arm.urdf")
        text = json.dumps(_corrections(case), indent=1)  # which is YAML too
        (staging / "model" / "effects.yaml").write_text(text + "\n", encoding="utf-8")
    else:
        write_urdf(case.chain, staging / "model.urdf")
    rng = np.random.default_rng([case.seed, KINDS.index(case.kind), 1000])
    for name, run, clock in (("fit", case.fit, case.clocks[0]), ("holdout", case.holdout, case.clocks[1])):
        _write_log(case, run, clock, staging / f"{name}.csv", rng)
    shutil.rmtree(folder, ignore_errors=True)
    staging.chmod(0o755)
    staging.rename(folder)


def model_path(folder: Path) -> Path:
    """What a case's `--model` is."""
    return folder / "model" if (folder / "model").is_dir() else folder / "model.urdf"


def _corrections(case: Case) -> dict[str, Any]:
    effects = [
        {"name": e.name, "joints": [case.chain.joints[j] for j in e.joints], "links": [], "parameters": e.values}
        for e in case.baseline
    ]
    return {
        "model": "arm.urdf",
        "joints": list(case.chain.joints),
        "tool_frame": case.chain.link_names[-1],
        "effects": effects,
    }


def _write_log(case: Case, run: Truth, clock: float, path: Path, rng: np.random.Generator) -> None:
    time = clock + run.time + rng.normal(size=len(run.time)) * case.noise.jitter
    columns = {"time": time[:, None]}
    columns["position_measured"] = run.encoder
    columns["torque_measured"] = run.torque + case.noise.draw(len(time), case.period, rng)
    if "velocity_estimated" in case.extras:
        columns["velocity_estimated"] = run.velocity
    if "position_commanded" in case.extras:
        columns["position_commanded"] = run.asked
    header = ",".join(
        "time" if signal == "time" else ",".join(f"{signal}.{joint}" for joint in case.chain.joints)
        for signal in columns
    )
    n = case.chain.n
    form = ["%.6f", *(["%.8f"] * n if k == 0 else ["%.5f"] * n for k in range(len(columns) - 1))]
    flat = [f if isinstance(f, str) else ",".join(f) for f in form]
    with path.open("w", encoding="utf-8") as file:
        file.write(header + "\n")
        row = ",".join(flat) + "\n"
        for values in np.hstack(list(columns.values())):
            file.write(row % tuple(values))


def describe(case: Case) -> dict[str, Any]:
    """What is true of a case, in the catalogue's terms and on the fit log's clock."""
    joints, links = case.chain.joints, case.chain.link_names
    effects = []
    for thing in case.hidden:
        per_joint = bool(thing.joints) and thing.name not in ("coupled_friction", "cable_coupling")
        values: dict[str, Any] = {}
        for key, value in thing.values.items():
            if per_joint:
                values[key] = {joints[j]: x for j, x in zip(thing.joints, value, strict=True)}
            else:
                values[key] = value if len(value) > 1 else value[0]
        effects.append(
            {
                "name": thing.name,
                "joints": [joints[j] for j in thing.joints],
                "links": [] if thing.link is None else [links[thing.link]],
                "parameters": values,
                "onset": None if thing.onset is None else thing.onset + case.clocks[0],
                "end": None if thing.end is None else thing.end + case.clocks[0],
            }
        )
    noise = {key: np.asarray(value).tolist() for key, value in asdict(case.noise).items()}
    return {
        "kind": case.kind,
        "seed": case.seed,
        "outside": case.kind == "outside",
        "dirty": bool(case.baseline),
        "joints": list(joints),
        "effects": effects,
        "period": case.period,
        "noise": noise,
        "encoder": float(case.control.resolution[0]),
        "setting": case.setting,
    }
