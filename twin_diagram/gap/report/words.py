"""What the report says in words: the verdict, effects for people who have never met them, numbers with their errors."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from twin_diagram.gap.correction.named_effects import amount_of
from twin_diagram.gap.findings import Estimate, Finding, Moment, Verdict
from twin_diagram.model.effects import REGISTRY

TITLES = {
    "viscous_friction": (
        "Viscous friction",
        "A torque that grows with speed and works against it, as in oil or grease.",
    ),
    "coulomb_friction": (
        "Dry friction",
        "A torque of one size that works against motion at any speed. It jumps where the joint turns back.",
    ),
    "stribeck_friction": (
        "Dry friction with a Stribeck dip",
        "Dry friction that is higher at a crawl than at speed: the joint sticks, then slips.",
    ),
    "load_dependent_friction": (
        "Friction that grows with load",
        "Dry friction in proportion to the torque that the gear carries.",
    ),
    "coupled_friction": (
        "Friction between coupled joints",
        "Friction on the sum of several joints' speeds, as where one gear runs inside another.",
    ),
    "payload": (
        "A payload",
        "Mass at the last link that the model does not know of: a tool, a cable, a part in the hand.",
    ),
    "inertial_parameters": ("A link of other mass", "A link is heavier, lighter or balanced elsewhere than described."),
    "reflected_inertia": (
        "Inertia of a motor's rotor",
        "The rotor turns faster than the joint by the gear's ratio; the joint feels it times the ratio squared.",
    ),
    "gravity_tilt": ("A tilted base", "The base does not stand level, so gravity pulls from another side."),
    "joint_spring": (
        "A spring or counterbalance",
        "A torque that depends on the joint's angle alone: a spring, a balancer, a stiff hose.",
    ),
    "joint_elasticity": (
        "An elastic gear",
        "The gear gives like a spring: the link moves behind the motor, and swings.",
    ),
    "backlash": (
        "Play in a gear",
        "The motor turns a little before the link follows, each time the torque changes side.",
    ),
    "torque_ripple": ("Torque ripple", "A torque that repeats with the joint's angle, from teeth, magnets or poles."),
    "torque_constant": (
        "A wrong torque constant",
        "The motor gives more or less than its log says, always by one factor.",
    ),
    "torque_bias": (
        "A constant torque",
        "A torque that is always there, beyond what is logged: an offset of the sensor.",
    ),
    "torque_saturation": ("Saturated torque", "The motor does not give more than a limit, whatever was asked of it."),
    "time_delay": ("A delay", "What is logged acts later than its time says."),
    "encoder_offset": ("A shifted encoder", "The encoder's zero is not where the model has it."),
    "external_force": ("A push from outside", "Something pushed or pulled at a link for a while."),
    "actuator_fault": ("A failing motor", "From some moment on, the motor gives only part of its torque."),
}
"""Name in the catalogue → title and explanation."""


PARAMETERS = {
    "com": "centre of mass",
    "torque_positive": "torque against positive motion",
    "torque_negative": "torque against negative motion",
    "coulomb": "friction at speed",
    "static": "friction at rest",
    "gap": "total play",
    "gain": "torque applied over torque logged",
    "cycles": "cycles per revolution of the joint",
}
"""Keys that do not say enough by themselves."""


ON_PRISMATIC = {"torque": "force", "angle": "position"}
"""What stands in the place of such words where a joint is prismatic."""


def of_prismatic(text: str) -> str:
    """Return a text about revolute joints, as it is said of prismatic joints."""
    for turning, prismatic in ON_PRISMATIC.items():
        text = text.replace(turning, prismatic).replace(upper_first(turning), upper_first(prismatic))
    return text


def parameter(key: str, prismatic: bool = False, turning: bool = True) -> str:
    """Return a parameter's key for people, of prismatic joints, revolute ones, or both."""
    if key == "cycles" and prismatic:
        return f"{PARAMETERS[key]}, or phase per length" if turning else "phase per length"
    text = PARAMETERS.get(key, key.replace("_", " "))
    return text if turning else of_prismatic(text)


def title(name: str) -> str:
    """Return an effect's name as a headline."""
    return TITLES[name][0] if name in TITLES else name.replace("_", " ").capitalize()


def explanation(name: str, prismatic: bool = False) -> str:
    """Return what an effect is, on revolute or prismatic joints.

    Of a user's own effect, what its class says of itself.
    """
    if name in TITLES:
        return of_prismatic(TITLES[name][1]) if prismatic else TITLES[name][1]
    own = REGISTRY[name].__doc__ if name in REGISTRY else None
    return own.strip().splitlines()[0] if own else ""


def listed(items: Sequence[str]) -> str:
    """Return a, B and C."""
    items = list(items)
    if len(items) < 2:
        return "".join(items)
    return f"{', '.join(items[:-1])} and {items[-1]}"


def places(joints: Sequence[str], links: Sequence[str]) -> str:
    """Return where an effect sits, in words; empty where it sits on no part in particular."""
    return listed([*joints, *links])


def claim(name: str, joints: Sequence[str], links: Sequence[str]) -> str:
    """Return an effect and its place on one line, for alternatives."""
    where = places(joints, links)
    return f"{title(name)} on {where}" if where else title(name)


def headline(verdict: Verdict) -> str:
    """Return the verdict in one sentence."""
    if verdict.verdict == "none":
        return "The model explains these runs. Nothing is missing that they could show."
    if verdict.verdict == "unknown":
        return "Something is missing from the model, and no effect of the catalogue explains it."
    said = (("more", "lacks {}"), ("less", "has more than the arm of {}"), ("other", "has another amount of {}"))
    clauses = [
        clause.format(listed(those))
        for amount, clause in said
        if (those := [_short(f) for f in verdict.findings if amount_of(f) == amount])
    ]
    text = " ".join(f"{'It' if k else 'The model'} {clause}." for k, clause in enumerate(clauses))
    if verdict.remainder:
        text += " Something more is there that no effect of the catalogue explains."
    return text


def _short(finding: Finding) -> str:
    """Return an effect and, where that is short, its place."""
    where = finding.joints if len(finding.joints) <= 3 else ()
    count = f" on {len(finding.joints)} joints" if len(finding.joints) > 3 else ""
    return lower_first(title(finding.name)) + (f" on {listed(where)}" if where else count)


def lower_first(words: str) -> str:
    """For use within a sentence."""
    return words[:1].lower() + words[1:]


def upper_first(words: str) -> str:
    """For use at its begin."""
    return words[:1].upper() + words[1:]


def sureness(confidence: float) -> str:
    """Return a probability in words."""
    for bound, word in ((0.99, "practically certain"), (0.9, "very likely"), (0.7, "likely"), (0.4, "uncertain")):
        if confidence >= bound:
            return word
    return "a guess"


def percent(share: float) -> str:
    """Return a share; not rounded up to certainty."""
    if not math.isfinite(share):
        return "–"
    if 0.99 < share < 1.0:
        return "> 99 %"
    if 0.0 < share < 0.01:
        return "< 1 %"
    return f"{100.0 * share:.0f} %"


def moment(when: Moment | None, several: bool) -> str:
    """Return a time, with its log where there are several."""
    if when is None:
        return ""
    error = f" ± {when.std:.2g}" if when.std > 0.0 else ""
    return f"{when.time:.3f}{error} s" + (f" of log {when.log + 1}" if several else "")


def duration(finding: Finding, several: bool) -> str:
    """From when to when an effect acts; empty where it always does."""
    begin, end = moment(finding.onset, several), moment(finding.end, several)
    if begin and end:
        return f"from {begin} until {end}"
    return f"from {begin} on" if begin else f"until {end}" if end else ""


def with_error(estimate: Estimate) -> str:
    """Return a value ± its standard error, to the digits that the error leaves meaning."""
    if isinstance(estimate.value, (list, tuple, np.ndarray)):
        errors = np.broadcast_to(np.asarray(estimate.std, dtype=float), np.shape(estimate.value))
        inside = ", ".join(_pair(float(x), float(s)) for x, s in zip(estimate.value, errors, strict=True))
        number = f"({inside})"
    else:
        number = _pair(float(estimate.value), float(np.max(estimate.std)))
    unit = "" if estimate.unit in ("1", "") else f" {estimate.unit}"
    return number + unit


def _pair(value: float, std: float) -> str:
    if not (math.isfinite(std) and std > 0.0 and math.isfinite(value)):
        return number(value)
    decimals = max(0, 1 - math.floor(math.log10(std)))
    if decimals > 6:
        return f"{value:.4g} ± {std:.2g}"
    return f"{value:.{decimals}f} ± {std:.{decimals}f}"


def number(value: float) -> str:
    """Return three significant digits, without an exponent where one can do without."""
    if not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    size = math.floor(math.log10(abs(value)))
    if -4 <= size < 5:
        return f"{value:.{max(0, 2 - size)}f}"
    return f"{value:.3g}"
