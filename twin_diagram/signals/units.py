"""Units of what is said of a joint: the one place that knows them for prismatic joints.

The catalogue states units for revolute joints, and `on_joint` tells the same quantity's on a prismatic one: there the
coordinate is a length and the effort a force, so that a unit made of N·m, rad and kg·m² becomes one of N, m and kg.
"""

from __future__ import annotations

import re

TORQUE = "N·m"
"""Of a revolute joint's effort."""
ANGLE = "rad"
"""Of its position."""
SPEED = "rad/s"
"""Of its velocity."""
ACCELERATION = "rad/s²"
"""Of its acceleration."""

_RAISED = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
"""From exponents to plain digits."""
_RAISE = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
"""From plain digits to exponents."""
_FACTOR = re.compile(r"([^\W\d_]+)(?:\^|\*\*)?(-?\d*)")
"""A unit and its exponent."""
_TURNING = {"rad": "m", "mrad": "mm"}
"""What an angle's unit is on a prismatic joint."""


def on_joint(unit: str, prismatic: bool = True) -> str:
    """Return a quantity's unit on a joint, from its unit on a revolute joint.

    Each angle is a length, and each torque or inertia loses its lever arms: N·m is N, rad is m, kg·m² is kg, and what
    is made of them follows (N·m·s/rad is N·s/m). What holds neither stays: kg, s, a length, a pure number.

    Args:
        unit: for a revolute joint; several, with commas between them, for a list of different things.
        prismatic: whether the joint is prismatic; if not, the unit stays as it is.
    """
    return ", ".join(_prismatic(part) for part in unit.split(", ")) if prismatic else unit


def factors(unit: str) -> dict[str, int]:
    """Return a product's units and their exponents, in order; a sign of division holds for what is next to it alone.

    Raises:
        ValueError: it is no such product.
    """
    result: dict[str, int] = {}
    sign, ends = 1, [1]
    for token in re.findall(r"\*\*-?\d+|[()/]|[·⋅* ]|[^()/·⋅* ]+(?:\*\*-?\d+)?", unit.translate(_RAISED)):
        if token == "/":
            sign = -1
        elif token == "(":
            ends.append(ends[-1] * sign)
            sign = 1
        elif token == ")":
            if len(ends) == 1:
                raise ValueError(f"{unit!r}: a bracket is closed that was not opened")
            ends.pop()
        elif token not in "·⋅* " and token != "1":
            match = _FACTOR.fullmatch(token)
            if match is None:
                raise ValueError(f"{unit!r}: {token!r} is no unit")
            for name in ("N", "m") if match[1] == "Nm" else (match[1],):
                result[name] = result.get(name, 0) + ends[-1] * sign * int(match[2] or 1)
            sign = 1
    return {name: power for name, power in result.items() if power}


def _prismatic(unit: str) -> str:
    try:
        powers = factors(unit)
    except ValueError:
        return unit
    # N·m and kg·m² hold one and two lever arms; where the metres are others, they are no lever arms.
    arms = powers.get("N", 0) + 2 * powers.get("kg", 0)
    rest = dict(powers)
    if arms and powers.get("m", 0) == arms:
        del rest["m"]
    for angle, length in _TURNING.items():
        if angle in rest:
            rest[length] = rest.get(length, 0) + rest.pop(angle)
    return unit if rest == powers else _product({name: power for name, power in rest.items() if power})


def _product(powers: dict[str, int]) -> str:
    above = [_power(name, power) for name, power in powers.items() if power > 0]
    below = [_power(name, -power) for name, power in powers.items() if power < 0]
    divisor = below[0] if len(below) == 1 else f"({'·'.join(below)})"
    return ("·".join(above) or "1") + (f"/{divisor}" if below else "")


def _power(name: str, power: int) -> str:
    return name if power == 1 else name + str(power).translate(_RAISE)
