"""What is left of the torque once the gap is closed, beside what the authors of the data reached."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from kuka_kr300.runs import GEAR_RATIO, JOINTS, ROTOR_INERTIA
from twin_diagram.gap import Gap
from twin_diagram.gap.candidates.records import sentence
from twin_diagram.model import Model
from twin_diagram.model.effects.transmission import JointSpring
from twin_diagram.signals.arrays import Array

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


def show_motor_side(gap: Gap, out: Path) -> None:
    """Print what was published and the table, and write ``motor_side.json``."""
    published = ", ".join(f"{inertia * ratio**2:.0f}" for inertia, ratio in zip(ROTOR_INERTIA, GEAR_RATIO, strict=True))
    print(f"published: payload 151 kg, 0.1 m beyond the flange; rotors {published} kg·m²")
    print("\nresidual torque, motor side, N·m RMS (10 Hz zero-phase low-pass, 0.3 s cut at each end)")
    print(" " * 40 + "".join(f"{joint:>9}" for joint in JOINTS))
    rows = table(gap)
    for name, values in [*rows, *((f"authors, B: {name}", np.array(v)) for name, v in AUTHORS.items())]:
        print(f"{name:<40}" + "".join(f"{value:9.2f}" for value in values))
    print("\n".join(curve_in_words(gap.corrected, gap)))
    result = {name: dict(zip(JOINTS, map(float, values), strict=True)) for name, values in rows}
    (out / "motor_side.json").write_text(json.dumps(result, indent=1, ensure_ascii=False))
