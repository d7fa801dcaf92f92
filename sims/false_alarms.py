"""How often the drift monitor cries wolf: hours of a healthy arm at 200 Hz, and the rate's Poisson upper bound.

    python sims/false_alarms.py --hours 10 --out out/false_alarms
    python sims/false_alarms.py --hours 10 --sensors all

Each run is ten minutes of another hidden UR5e in MuJoCo (`filter_truth`): payload unknown, friction within a tenth of
nominal, sensors with noise. Nothing happens to it, so every alarm after the thresholds were learnt is false. Each run
leaves one file; what is there already is not run again. About eight times as fast as life.

With all sensors a run is five minutes of pick and place with camera, IMU and wrist wrench as well (`hrt_truth`), each
cross-checked against the rest; about three times as fast as life.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from filter_truth import JOINTS, Truth, told
from scipy.stats import chi2

from twin_diagram.estimation.belief import Entry
from twin_diagram.estimation.drift import Monitor
from twin_diagram.estimation.ekf import Ekf
from twin_diagram.estimation.events import events
from twin_diagram.looking.atomic_file import write
from twin_diagram.scenario import Drift, Filter

RUN = 600.0
"""Length of one run [s]."""
LONG = 300.0
"""The same with all sensors [s]."""
LEARNT = 5.0
"""What is normal is learnt by then, with all sensors [s]."""


def watch(seed: int) -> dict[str, object]:
    """One run: hours in which an alarm could be raised, the alarms, and the filter's counters."""
    terms, tuning = told(), Filter()
    ekf, monitor = Ekf(terms, tuning), Monitor(terms, Drift(), tuning)
    armed: float | None = None
    nis = 0.0
    count = 0
    for t, q, v, tau, _ in Truth.draw(seed).messages(RUN):
        ekf.observe(q, v, tau, t)
        belief = ekf.belief
        newest = float(belief.header[Entry.NIS])
        monitor.observe(belief.x[:12], belief.theta, newest, q, tau, t, innovation=belief.innovation)
        nis, count = nis + newest / 12.0, count + 1
        if armed is None and monitor.armed:
            armed = t
    counters = {entry.name.lower(): int(ekf.belief.header[entry]) for entry in Entry if entry >= Entry.ACCEPTED}
    hours = 0.0 if armed is None else (RUN - armed) / 3600.0
    return {"seed": seed, "hours": hours, "alarms": events(monitor, JOINTS), "nis": nis / count, "counters": counters}


def watch_all(seed: int) -> dict[str, object]:
    """The same with all sensors fused and cross-checked."""
    from hrt_bench import experiments, ours
    from hrt_truth.hidden import Hidden
    from hrt_truth.sensors import Case

    bench = experiments.Bench()
    case = Case(Hidden.draw(seed, mass=1.0), LONG, defects=experiments.FINE)
    streams, _ = bench.simulate(case, "")
    setup = ours.Setup(params=experiments.FAULT_PARAMS, predict=False, monitor=True)
    alarms = ours.run(streams, setup, bench.kinematics).alarms
    found = [{"time": at, "kind": what} for at, what in alarms]
    return {"seed": seed, "hours": (LONG - LEARNT) / 3600.0, "alarms": found}


def bound(alarms: int, hours: float) -> float:
    """Rate [1/h] that a Poisson process exceeds with probability 5 % at most, given what was seen."""
    return float(chi2.ppf(0.95, 2 * (alarms + 1)) / 2.0 / hours)


def main() -> None:
    """Runs what is missing and prints the rate."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=2000, help="of the first run")
    parser.add_argument("--sensors", choices=["arm", "all"], default="arm", help="the arm's own, or all that are fused")
    parser.add_argument("--out", type=Path, default=Path("out/false_alarms"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    hours, alarms, seed = 0.0, 0, args.seed
    while hours < args.hours:
        file = args.out / (f"{seed}.json" if args.sensors == "arm" else f"all_{seed}.json")
        if not file.exists():
            write(file, json.dumps(watch(seed) if args.sensors == "arm" else watch_all(seed)))
        result = json.loads(file.read_text(encoding="utf-8"))
        if not result["hours"]:
            print(f"seed {seed}: never armed")
            hours += 1e-9
        hours, alarms = hours + result["hours"], alarms + len(result["alarms"])
        for alarm in result["alarms"]:
            print(f"seed {seed}: {alarm['time']:.2f} s {alarm['kind']} {alarm.get('shape', '')}")
        if hours > 0.01:
            print(
                f"{hours:.2f} h, {alarms} false alarms: {alarms / hours:.2f} per hour, "
                f"below {bound(alarms, hours):.2f} with 95 % confidence",
                flush=True,
            )
        seed += 1


if __name__ == "__main__":
    main()
