"""The outline's experiments, one function each: seed → records. Runs are simulated, written to two files, read."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from hrt_truth import world
from hrt_truth.hidden import Fault, Hidden
from hrt_truth.motion import pick_and_place
from hrt_truth.sensors import Case, Defects, sense
from hrt_truth.streams import Streams, Truth, load, save

from hrt_bench import baselines, convergence, learned, ours, scores
from hrt_bench.estimate import AHEAD, STRIDE, Estimate, Kinematics
from hrt_bench.ours import OUTLINE, Setup

Record = dict[str, Any]
TRAINING: Final = range(2000, 2024)
"""Seeds of the arms that learners are trained on."""
FINE: Final = Defects(encoder=2e-5, velocity=2e-3)
"""Encoders as a UR5e has them, for faults and adaptation."""
FAULT_PARAMS: Final = replace(OUTLINE, encoder_std=3e-5, velocity_std=2.5e-3)


LEARNERS: Final[dict[str, Any]] = {
    "randomised": learned.Randomised,
    "threshold": learned.Threshold,
    "lstm": learned.Lstm,
}


class Bench:
    """What all experiments share; learners are trained when first asked for.

    Attributes:
        folder: where runs are kept; nowhere where None.
        trained: where learners are kept, for the next process; nowhere where None.
    """

    def __init__(self, folder: Path | None = None, trained: Path | None = None) -> None:
        self.folder, self.trained = folder, trained
        self.kinematics = Kinematics()
        self._learners: dict[str, Any] = {}

    def simulate(self, case: Case, tag: str) -> tuple[Streams, Callable[[], Truth]]:
        """Streams, and what opens the truth: methods get the first, the scorer alone calls the second."""
        happened = world.run(case.hidden, *pick_and_place(case.hidden.seed, case.duration, busy=case.busy), case.fault)
        streams, truth = sense(case, happened)
        if self.folder is not None:
            place = self.folder / tag
        else:
            place = Path(tempfile.mkdtemp(prefix="hrt_"))
        save(place / "streams.npz", streams)
        save(place / "truth.npz", truth)
        streams = load(place / "streams.npz", Streams)
        secret = place / "truth.npz"
        if self.folder is None:
            kept = load(secret, Truth)
            for file in place.iterdir():
                file.unlink()
            place.rmdir()
            return streams, lambda: kept
        return streams, lambda: load(secret, Truth)

    def learner(self, kind: str, defects: Defects = FINE) -> Any:
        """`randomised`, `threshold` or `lstm`, trained on arms of the training seeds."""
        if kind not in self._learners:
            file = None if self.trained is None else self.trained / f"{kind}.npz"
            if file is not None and file.exists():
                self._learners[kind] = learned.load(file, LEARNERS[kind])
            else:
                self._learners[kind] = self._train(kind, defects)
                if file is not None:
                    learned.save(file, self._learners[kind])
        return self._learners[kind]

    def _train(self, kind: str, defects: Defects) -> Any:
        if kind == "randomised":
            return learned.Randomised.train(list(_training(0.0, 5.0, 2.0, Defects())))
        if "normal" not in self._learners:
            self._learners["normal"] = [s for s, _ in _training(0.0, 2.0, 1.0, defects)]
        return LEARNERS[kind].train(self._learners["normal"])


def _training(least: float, most: float, spread: float, defects: Defects) -> Iterator[tuple[Streams, Truth]]:
    """Runs of the training seeds, with payloads in between [kg]; every other one busy."""
    for seed in TRAINING:
        mass = float(np.random.default_rng([seed, 49]).uniform(least, most))
        case = Case(Hidden.draw(seed, mass=mass, spread=spread), 10.0, defects=defects, busy=seed % 2 == 0)
        yield sense(case, world.run(case.hidden, *pick_and_place(seed, case.duration, busy=case.busy)))


def synchronisation(bench: Bench, seed: int) -> list[Record]:
    """Hand RMSE with 0, 2 and 5 kg, now and ahead, of all methods on the same runs."""
    records = []
    for mass in (0.0, 2.0, 5.0):
        case = Case(Hidden.draw(seed, mass=mass), 10.0)
        streams, truth = bench.simulate(case, f"sync_{seed}_{mass:g}")
        methods: dict[str, Callable[[], Estimate]] = {
            "ours": lambda s=streams: ours.run(s, Setup(), bench.kinematics),
            "ours, encoders alone": lambda s=streams: ours.run(s, Setup(sensors=("encoders",)), bench.kinematics),
            "fixed EKF": lambda s=streams: ours.run(s, ours.FIXED, bench.kinematics),
            "physics-only": lambda s=streams: baselines.physics_only(s, baselines.told_commands(s)),
            "vision-only": lambda s=streams: baselines.vision_only(s),
            "encoders-only": lambda s=streams: baselines.encoders_only(s, bench.kinematics),
            "domain-randomised": lambda s=streams: bench.learner("randomised").run(s, bench.kinematics),
        }
        for name, method in methods.items():
            e = method()
            record = {"method": name, "payload": mass, **scores.accuracy(e, truth())}
            if name == "ours":
                record |= scores.rejection(e, truth()) | scores.honesty(e, truth())
                record["mass_error"] = float(abs(e.mass[-1] - mass))
                record["message_ms"] = float(np.nanmedian(e.extra["spent"]))
                record["message_p99_ms"] = float(np.nanquantile(e.extra["spent"], 0.99))
            records.append(record)
    return records


def payload_added(bench: Bench, seed: int) -> list[Record]:
    """2 kg at 10 s: how long until the hand is back in its band, and the mass's error."""
    records = []
    for biased in (False, True):
        hidden = Hidden.draw(seed, mass=0.0, biased=biased)
        case = Case(hidden, 16.0, Fault("payload_added", 10.0, 2.0))
        streams, truth = bench.simulate(case, f"added_{seed}_{biased}")
        known = ["payload", "torque_bias"] if biased else ["payload"]
        calm, same = bench.simulate(replace(case, fault=Fault()), f"not_added_{seed}_{biased}")
        setup = Setup(params=replace(OUTLINE, parameters=known))
        usual = scores.hand_error(ours.run(calm, setup, bench.kinematics), same())
        for name, setup in (
            ("ours", Setup(params=replace(OUTLINE, parameters=known))),
            ("fixed EKF", ours.FIXED),
            ("gradient rule", Setup(params=replace(OUTLINE, parameters=known, rule="gradient"))),
        ):
            e, t = ours.run(streams, setup, bench.kinematics), truth()
            record: Record = {"method": name, "bias": "unknown" if biased else "calibrated"}
            error = scores.hand_error(e, t)
            record |= scores.recovery(error, t.time, 10.0, usual=usual if name == "ours" else None)
            record |= {f"ahead_{k}": v for k, v in _ahead_recovery(e, t).items()}
            for after in (0.5, 1.0, 2.0, 5.0):
                k = int(np.searchsorted(t.time, 10.0 + after))
                record[f"mass_error_{after:g}s"] = float(abs(e.mass[k] - t.mass[k]) / 2.0)
                record[f"mass_bound_{after:g}s"] = (
                    scores.mass_bound(bench.kinematics.terms, t, 10.0, 10.0 + after) / 2.0
                )
            records.append(record)
    return records


def _ahead_recovery(e: Estimate, t: Truth) -> dict[str, float]:
    """Of predictions 100 ms ahead, by the time at which they were made."""
    p = e.ahead[AHEAD[0]]
    k = np.arange(len(p)) * STRIDE
    there = np.minimum(k + round(AHEAD[0] / scores.DT), len(t.time) - 1)
    error = np.nan_to_num(np.linalg.norm(p - t.hand[there, 4:], axis=1))
    return scores.recovery(error, t.time[k], 10.0, window=0.1)


def friction_third(bench: Bench, seed: int) -> list[Record]:
    """Dry friction of all joints drops to a third at 10 s; the levels are learnt, the faster after an alarm."""
    from filter_truth import COULOMB

    case = Case(Hidden.draw(seed, mass=0.0), 15.0, Fault("friction_third", 10.0), busy=True)
    streams, truth = bench.simulate(case, f"friction_{seed}")
    setup = Setup(params=replace(OUTLINE, parameters=["coulomb_friction"]), predict=False, monitor=True)
    e, t = ours.run(streams, setup, bench.kinematics), truth()
    level = COULOMB + e.extra["theta"]
    error = np.abs(level - t.friction) / t.friction  # as the outline counts it: of what is true then
    record: Record = {"method": "ours", **scores.latency([at for at, _ in e.alarms], t.fault, 1.0)}
    for after in (0.5, 1.0, 2.3, 4.0):
        k = int(np.searchsorted(t.time, 10.0 + after))
        record[f"error_{after:g}s"] = float(error[k].mean())
        record[f"worst_{after:g}s"] = float(error[k].max())
        bound = scores.friction_bound(bench.kinematics.terms, t, 10.0, after) / t.friction[k]
        told = np.isfinite(bound)
        # The mean absolute value of what is Gaussian, so that it is of a kind with the errors.
        record[f"bound_{after:g}s"] = float(np.sqrt(2.0 / np.pi) * bound[told].mean())
        record[f"error_told_{after:g}s"] = float(error[k][told].mean())
        record[f"resting_{after:g}s"] = int(np.sum(~told))
    return [record]


ABLATIONS: Final[dict[str, tuple[Setup, Defects]]] = {
    "all": (Setup(predict=False), Defects()),
    "encoders alone": (Setup(sensors=("encoders",), predict=False), Defects()),
    "no IMU": (Setup(sensors=("encoders", "camera", "wrench"), predict=False), Defects()),
    "no camera": (Setup(sensors=("encoders", "imu", "wrench"), predict=False), Defects()),
    "no force sensor": (Setup(sensors=("encoders", "camera", "imu"), predict=False), Defects()),
    "with lidar": (Setup(sensors=(*ours.ALL, "lidar"), predict=False), Defects()),
    "camera covered 10 s": (Setup(predict=False), Defects(covered=((3.0, 13.0),))),
    "all vision lost at 5 s": (
        Setup(sensors=(*ours.ALL, "lidar"), missing=(("camera", 5.0, np.inf), ("lidar", 5.0, np.inf)), predict=False),
        Defects(),
    ),
    "encoders noisy 5 s (×10)": (Setup(predict=False), Defects(encoder_worse=(5.0, 10.0, 10.0))),
    "IMU lost at 5 s": (Setup(missing=(("imu", 5.0, np.inf),), predict=False), Defects()),
    "force sensor lost at 5 s": (Setup(missing=(("wrench", 5.0, np.inf),), predict=False), Defects()),
    "encoders lost 5 to 7 s": (Setup(missing=(("encoders", 5.0, 7.0),), predict=False), Defects()),
    "camera and IMU alone from 3 s": (Setup(missing=(("encoders", 3.0, np.inf),), predict=False), Defects()),
}


def ablation(bench: Bench, seed: int) -> list[Record]:
    """Sensors left out and outages, 1 kg held."""
    records = []
    for name, (setup, defects) in ABLATIONS.items():
        case = Case(Hidden.draw(seed, mass=1.0), 14.0, defects=defects)
        streams, truth = bench.simulate(case, f"ablation_{seed}")
        e, t = ours.run(streams, setup, bench.kinematics), truth()
        worst = float(1e3 * scores.hand_error(e, t)[t.time >= scores.START].max())
        records.append({"method": name, **scores.accuracy(e, t), **scores.honesty(e, t), "worst_mm": worst})
    return records


SLIP: Final = 0.077
"""How long a slip of 5 mm takes where friction lets go of half the weight [s]."""
FAULTS: Final[dict[str, tuple[Fault, float, str]]] = {
    "motor lost": (Fault("motor_lost", 5.0, 0.0, joint=1, loaded=10.0), 1.0, "≤ 20 ms (outline 87)"),
    "motor 20 % weak": (Fault("motor_weak", 5.0, 0.8, joint=1, loaded=10.0), 1.0, "≤ 60 ms"),
    "motor 20 % weak, sliding": (Fault("motor_weak", 5.0, 0.8, joint=1, loaded=10.0, moving=0.05), 1.0, "≤ 60 ms"),
    "contact 10 N": (Fault("contact", 5.0, 10.0, lasts=0.5), 0.5, "≤ 40 ms (outline 61)"),
    "encoder jump 5 mrad": (Fault("encoder_jump", 5.0, 5e-3, joint=2), 0.5, "≤ 20 ms"),
    "gyro bias 0.02 rad/s": (Fault("gyro_bias", 5.0, 0.02), 3.0, "≤ 1 s (outline 2.3)"),
    "grasp slip 5 mm": (Fault("grasp_slip", 5.0, 5e-3, lasts=SLIP), 1.0, "≤ 60 ms (outline 134)"),
    "grasp slip 5 mm, down": (Fault("grasp_slip", 5.0, 5e-3, lasts=SLIP, down=True), 1.0, "≤ 60 ms (outline 134)"),
}


def faults(bench: Bench, seed: int) -> list[Record]:
    """Each fault once, seen by three detectors."""
    records = []
    for name, (fault, patience, _) in FAULTS.items():
        case = Case(Hidden.draw(seed, mass=1.0), 5.5 + patience + 2.0, fault, FINE, busy=True)
        streams, truth = bench.simulate(case, f"fault_{seed}_{name}")
        e, t = ours.run(streams, Setup(params=FAULT_PARAMS, predict=False, monitor=True), bench.kinematics), truth()
        if not np.isfinite(t.fault[0]):
            records.append({"fault": name, "method": "ours", "skipped": "the joint was never loaded"})
            continue
        found = {"ours": [at for at, _ in e.alarms]}
        for kind in ("threshold", "lstm"):
            found[kind] = [float(at) for at in bench.learner(kind).alarms(streams)]
        for method, alarms in found.items():
            records.append({"fault": name, "method": method, **scores.latency(alarms, t.fault, patience)})
        records[-3]["said"] = [f"{what} +{at - t.fault[0]:.3f}" for at, what in e.alarms][:8]
    return records


SPOOFS: Final = {
    "camera pulled 5 mm/s": Fault("camera_spoofed", 5.0, 5e-3),
    "encoder pulled 5 mrad/s": Fault("encoder_spoofed", 5.0, 5e-3, joint=1),
}


def spoofing(bench: Bench, seed: int) -> list[Record]:
    """A slow pull: how far off the hand estimate is when it is noticed."""
    records = []
    for name, fault in SPOOFS.items():
        case = Case(Hidden.draw(seed, mass=1.0), 15.0, fault, FINE)
        streams, truth = bench.simulate(case, f"spoof_{seed}_{fault.kind}")
        e, t = ours.run(streams, Setup(params=FAULT_PARAMS, predict=False, monitor=True), bench.kinematics), truth()
        after = [at for at, _ in e.alarms if at >= 5.0]
        record: Record = {"fault": name, "method": "ours", "noticed_s": min(after) - 5.0 if after else None}
        record["false"] = len(e.alarms) - len(after)
        error = scores.hand_error(e, t)
        until = min(after) if after else t.time[-1]
        record["off_mm"] = float(1e3 * error[(t.time >= 5.0) & (t.time <= until)].max())
        record["said"] = [what for at, what in e.alarms if at >= 5.0][:4]
        records.append(record)
    return records


def false_alarms(bench: Bench, seed: int) -> list[Record]:
    """Five minutes of normal operation."""
    case = Case(Hidden.draw(seed, mass=1.0), 300.0, defects=FINE)
    streams, truth = bench.simulate(case, f"normal_{seed}")
    e = ours.run(streams, Setup(params=FAULT_PARAMS, predict=False, monitor=True), bench.kinematics)
    record: Record = {"method": "ours", "hours": case.duration / 3600.0, "alarms": len(e.alarms)}
    record["said"] = [f"{what} {at:.2f}" for at, what in e.alarms][:10]
    record |= scores.honesty(e, truth())
    others = [
        {
            "method": kind,
            "hours": case.duration / 3600.0,
            "alarms": len(np.unique(np.floor(2.0 * bench.learner(kind).alarms(streams)))),
        }
        for kind in ("threshold", "lstm")
    ]
    return [record, *others]


EXPERIMENTS: Final[dict[str, Callable[[Bench, int], list[Record]]]] = {
    "synchronisation": synchronisation,
    "payload_added": payload_added,
    "friction_third": friction_third,
    "ablation": ablation,
    "faults": faults,
    "spoofing": spoofing,
    "convergence": lambda bench, seed: convergence.measure(seed),
    "false_alarms": false_alarms,
}
