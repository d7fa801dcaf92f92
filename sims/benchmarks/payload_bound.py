"""Prints how well any unbiased estimator could tell a payload's mass on a model that an unloaded log corrected.

    python sims/benchmarks/payload_bound.py --first 60200 --count 24 --every 2

Arms as `gap_whole_robots.py --quick` draws them, each with a payload. The bound is Cramér and Rao's with priors: laws
are taken to be exact, noise is the sensor's alone with its colour, links are drawn to the description by as much as
they are off in truth; friction, offsets and rotors are found along, from either log. What `gap` says of an arm stands
in `loaded` of `gap_whole_robots.py`.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

SIMS = Path(__file__).resolve().parent
sys.path[:0] = [str(SIMS), str(SIMS.parents[1])]

from whole_robots import arms, runs  # noqa: E402

from twin_diagram.gap.candidates.payload import payload_about  # noqa: E402
from twin_diagram.gap.residuals.prepared_logs import prepare  # noqa: E402
from twin_diagram.gap.whole_robot.explain import begun  # noqa: E402
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, independent, solve  # noqa: E402
from twin_diagram.gap.whole_robot.torque_equations import equations, low_passed  # noqa: E402
from twin_diagram.gap.whole_robot.unusual import terms_of  # noqa: E402
from twin_diagram.logs import read_log  # noqa: E402
from twin_diagram.model.prediction import load_model_for  # noqa: E402

Array = npt.NDArray[np.float64]

WITHIN = 0.03
"""Share of its mass within which a payload is to be told."""

DRAWS = 8
"""Times that noise is drawn to know its size and colour."""


def main(arguments: list[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--first", type=int, default=60200, help="seed of the first arm (default: %(default)s)")
    parser.add_argument("--count", type=int, default=10, help="how many seeds (default: %(default)s)")
    parser.add_argument("--every", type=int, default=1, help="each so many-th of them (default: %(default)s)")
    given = parser.parse_args(arguments)
    arms.UNUSUAL = ("payload",)
    chances = []
    for seed in range(given.first, given.first + given.count, given.every):
        with tempfile.TemporaryDirectory() as scratch:
            robot = runs.make(seed, True, Path(scratch))
            if not robot.truth.unusual:
                continue
            mass = float(robot.truth.unusual[0].values["mass"][0])
            error = bound(robot, Path(scratch))
        chances.append(math.erf(WITHIN * mass / error / math.sqrt(2.0)))
        print(f"{seed}: {mass:.3f} kg, no better than {error:.3f} kg ({error / mass:.1%})", flush=True)
    if chances:
        print(f"within {WITHIN:.0%} for {np.mean(chances):.0%} of them at best")
    return 0


def bound(robot: runs.Robot, folder: Path) -> float:
    """Least standard error of the payload's mass [kg].

    Args:
        robot: with a payload.
        folder: of its description and logs.
    """
    rng = np.random.default_rng(1)
    bare, loaded = (_problem(robot, folder, name, rng) for name in ("unloaded", "fit"))
    z = solve(bare)
    told = _covariance(bare, z)[: 10 * bare.n, : 10 * bare.n]
    least = np.diag((1e-4 * bare.links.scale.ravel()) ** 2)
    centre = np.asarray(robot.truth.unusual[0].values["com"], dtype=float)
    load = payload_about(terms_of(loaded.sums, loaded.sums.records.model), centre)
    both = replace(loaded, sums=loaded.sums.with_further([load]), told=told + least, spread=1e-4)
    place = both.place(0)
    return float(np.sqrt(_covariance(both, np.concatenate([z, np.zeros(load.size)]))[place, place][0, 0]))


def _problem(robot: runs.Robot, folder: Path, name: str, rng: np.random.Generator) -> RobotProblem:
    """Everything usual free on one log, with the noise that its sensors truly have."""
    given, log, _ = load_model_for(read_log(folder / f"{name}.csv"), folder / "model.urdf", None, None, None)
    records = prepare(given, [log])
    problem = begun(records, equations(records))
    record = problem.sums.records.records[0]
    step = robot.truth.described.column("effort") / 2.0**12
    left = []
    for _ in range(DRAWS):
        noise = robot.noise.draw(len(record.time), robot.period, rng)
        noise = noise + step * rng.uniform(-0.5, 0.5, noise.shape)
        left.append(low_passed(noise, record)[record.kept] * problem.sums.weights)
    return replace(
        problem,
        spread=float(robot.truth.setting["links"]),
        variance=np.mean([np.mean(one**2, axis=0) for one in left], axis=0),
        share=np.mean([independent(one, problem.sums.gaps) for one in left], axis=0),
    )


def _covariance(problem: RobotProblem, z: Array) -> Array:
    H, _ = problem.system(z, problem.sums.whole)
    free = np.flatnonzero(problem.free)
    result = np.zeros_like(H)
    result[np.ix_(free, free)] = np.linalg.inv(H[np.ix_(free, free)])
    return result


if __name__ == "__main__":
    sys.exit(main())
