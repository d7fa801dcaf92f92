"""Finds what the model of a KUKA KR300 lacks, from one measured run, and holds it against another.

The given model is the published rigid links alone. Known to be there, and not told: a payload of some 150 kg, a
nitrogen
cylinder whose torque is a curve of joint 2's angle, the motors' rotors, friction on all joints. The table compares what
is left of run B's torque, on the motor's side of the gear, with the figures that the authors of the data reached
with a model of their own, whose structure they knew.

    python sims/gap_kuka.py --out out/gap_kuka

The data folder is `$TWIN_DIAGRAM_DATA`, or `../shared/data` beside the checkout.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
import numpy.typing as npt
from replay_kuka import GEAR_RATIO, JOINTS, ROTOR_INERTIA, data_folder

from twin_diagram.errors import TwinError
from twin_diagram.gap.candidates.records import sentence
from twin_diagram.gap.correction.named_effects import sentence_of
from twin_diagram.gap.report.words import headline
from twin_diagram.gap.workflow import Gap, run_gap
from twin_diagram.model.effects.transmission import JointSpring
from twin_diagram.model.model import Model

Array = npt.NDArray[np.float64]

AUTHORS = {
    "rotors, payload, cylinder": [2.52, 3.10, 3.10, 0.68, 0.99, 1.02],
    "… and friction": [0.64, 1.32, 1.43, 0.26, 0.43, 0.29],
}
"""Residual torque of the authors' models on run B, RMS, motor side [N·m]."""

SEEN = np.radians([-90.0, -61.0])
"""Angles of joint 2 that run A visits [rad]."""


def table(gap: Gap) -> list[tuple[str, Array]]:
    """Residual torque on the motor's side, RMS [N·m], by row."""
    fit_before, fit_after = gap.shown.fit_rms()
    before, after = gap.shown.holdout_rms()
    rows = [
        ("A, links alone", fit_before),
        ("A, corrected", fit_after),
        ("B, links alone", before),
        ("B, corrected", after),
    ]
    run = gap.shown.holdout
    inside = (run.position[:, 1] >= SEEN[0]) & (run.position[:, 1] <= SEEN[1])
    for name, chosen in (("B, where A was", inside), ("B, beyond", ~inside)):
        if np.any(chosen):
            rows.append((name, np.sqrt(np.mean(run.after[chosen] ** 2, axis=0))))
    return [(name, values / GEAR_RATIO) for name, values in rows]


def curve_in_words(model: Model, gap: Gap) -> list[str]:
    """How joint 2's spring goes on where run A never was."""
    low, high = (float(f(np.degrees(gap.shown.holdout.position[:, 1]))) for f in (np.min, np.max))
    lines = [
        f"run B takes joint 2 from {low:.1f} to {high:.1f}°, run A from {SEEN[0] * 57.3:.1f} to {SEEN[1] * 57.3:.1f}°"
    ]
    for effect in model.effects:
        if isinstance(effect, JointSpring) and JOINTS[1] in effect.joints:
            if "curve" in effect.parameters:
                law = effect.curve()
                ends = ", ".join(
                    f"{a:.0f}° {float(law(np.radians(a))):.0f} N·m" for a in (low, -90.0, -75.0, -61.0, high)
                )
                lines.append(f"beyond its ends the spring's curve soon goes on with its mean slope: {ends}")
            else:
                lines.append(f"{sentence(effect)}; it goes on as a straight line beyond")
    return lines


def main() -> int:
    """Parses the command line, prints what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/gap_kuka"), help="folder (default: %(default)s)")
    arguments = parser.parse_args()
    begin = time.perf_counter()
    try:
        folder = data_folder()
        gap = run_gap(
            folder / "kr300.urdf",
            [folder / "trajectory_A.csv"],
            folder / "trajectory_B.csv",
            arguments.out,
            lambda text: print(text, file=sys.stderr),
        )
    except TwinError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"{headline(gap.verdict)} ({gap.verdict.verdict}, {time.perf_counter() - begin:.0f} s)")
    for finding in gap.verdict.findings:
        print(f"  {finding.confidence:4.0%}  {sentence_of(finding, gap.given.prismatic)}")
    published = ", ".join(f"{inertia * ratio**2:.0f}" for inertia, ratio in zip(ROTOR_INERTIA, GEAR_RATIO, strict=True))
    print(f"published: payload 151 kg, 0.1 m beyond the flange; rotors {published} kg·m²")
    print("\nresidual torque, motor side, N·m RMS (10 Hz zero-phase low-pass, 0.3 s cut at each end)")
    print(" " * 40 + "".join(f"{joint:>9}" for joint in JOINTS))
    rows = table(gap)
    for name, values in [*rows, *((f"authors, B: {name}", np.array(v)) for name, v in AUTHORS.items())]:
        print(f"{name:<40}" + "".join(f"{value:9.2f}" for value in values))
    print("\n".join(curve_in_words(gap.corrected, gap)))
    result = {name: dict(zip(JOINTS, map(float, values), strict=True)) for name, values in rows}
    (arguments.out / "motor_side.json").write_text(json.dumps(result, indent=1, ensure_ascii=False))
    print(f"see {arguments.out / 'report.html'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
