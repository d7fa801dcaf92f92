"""How often the drift monitor cries wolf: hours of a healthy arm at 200 Hz, and the rate's Poisson upper bound.

    python sims/benchmarks/false_alarms.py --hours 10 --out out/false_alarms
    python sims/benchmarks/false_alarms.py --hours 10 --sensors all

Each run is ten minutes of another hidden UR5e in MuJoCo (`filter_truth`): payload unknown, friction within a tenth of
nominal, sensors with noise. Nothing happens to it, so every alarm after the thresholds were learnt is false. Each run
leaves one file with a digest of the code; what is there already, of the same code, is not run again. Five to eight
times as fast as life, on each of `--jobs` cores.

With all sensors a run is five minutes of pick and place with camera, IMU and wrist wrench as well (`hrt_truth`), each
cross-checked against the rest; about three times as fast as life.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from itertools import count
from pathlib import Path
from typing import Any

from filter_truth import JOINTS, Truth, told
from hrt_tables import digest
from scipy.stats import chi2

from twin_diagram.atomic_file import write
from twin_diagram.estimation.drift.alarm_events import events
from twin_diagram.estimation.drift.monitor import Monitor
from twin_diagram.estimation.filter.belief import Entry
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.scenario import Drift, Filter

RUN = 600.0
"""Length of one run [s]."""
LONG = 300.0
"""The same with all sensors [s]."""
LEARNT = 5.0
"""What is normal is learnt by then, with all sensors [s]."""


def watch(seed: int) -> dict[str, Any]:
    """One run: hours in which an alarm could be raised, the alarms, and the filter's counters."""
    tuning = Filter()
    ekf, monitor = Ekf(told(), tuning), Monitor(told(), Drift(), tuning)
    armed: float | None = None
    nis, messages = 0.0, 0
    for t, q, v, tau, _ in Truth.draw(seed).messages(RUN):
        ekf.heed(monitor.alarm())
        ekf.observe(q, v, tau, t)
        belief = ekf.belief
        newest = float(belief.header[Entry.NIS])
        monitor.observe(belief.x[:12], belief.theta, newest, q, tau, t, innovation=belief.innovation)
        nis, messages = nis + newest / 12.0, messages + 1
        if armed is None and monitor.armed:
            armed = t
    counters = {entry.name.lower(): int(ekf.belief.header[entry]) for entry in Entry if entry >= Entry.ACCEPTED}
    hours = 0.0 if armed is None else (RUN - armed) / 3600.0
    found = events(monitor, JOINTS)
    return {"seed": seed, "hours": hours, "alarms": found, "nis": nis / messages, "counters": counters}


def watch_all(seed: int) -> dict[str, Any]:
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


def one(file: Path, seed: int, sensors: str, code: str) -> dict[str, Any]:
    """A run, unless this very code has run it before."""
    if file.exists():
        found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        if found.get("code") == code:
            return found
    found = {**(watch(seed) if sensors == "arm" else watch_all(seed)), "code": code}
    write(file, json.dumps(found))
    return found


def runs(out: Path, first: int, sensors: str, jobs: int) -> Iterator[dict[str, Any]]:
    """Runs without end, in the order of their seeds, `jobs` of them at once."""
    code, prefix = digest(), "" if sensors == "arm" else "all_"
    with ProcessPoolExecutor(jobs) as pool:
        waiting = []
        for seed in count(first):
            waiting.append(pool.submit(one, out / f"{prefix}{seed}.json", seed, sensors, code))
            if len(waiting) > jobs:
                try:
                    yield waiting.pop(0).result()
                except GeneratorExit:
                    pool.shutdown(cancel_futures=True)
                    raise


def main() -> None:
    """Runs what is missing and prints the rate."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=2000, help="of the first run")
    parser.add_argument("--sensors", choices=["arm", "all"], default="arm", help="the arm's own, or all that are fused")
    parser.add_argument("--jobs", type=int, default=1, help="processes; each uses one thread")
    parser.add_argument("--out", type=Path, default=Path("out/false_alarms"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    hours, alarms = 0.0, 0
    results = runs(args.out, args.seed, args.sensors, args.jobs)
    for result in results:
        seed = result["seed"]
        if not result["hours"]:
            print(f"seed {seed}: never armed")
        hours, alarms = hours + max(result["hours"], 1e-9), alarms + len(result["alarms"])
        for alarm in result["alarms"]:
            print(f"seed {seed}: {alarm['time']:.2f} s {alarm['kind']} {alarm.get('shape', '')}")
        if hours > 0.01:
            print(
                f"{hours:.2f} h, {alarms} false alarms: {alarms / hours:.2f} per hour, "
                f"below {bound(alarms, hours):.2f} with 95 % confidence",
                flush=True,
            )
        if hours >= args.hours:
            results.close()


if __name__ == "__main__":
    main()
