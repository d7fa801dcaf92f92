"""Makes torques of logged currents: each joint's own constant, which nobody can guess.

--torque-constants 11.1 9.3 8.8                    # in the order of the model's joints
--torque-constants shoulder=11.1 elbow=9.3         # by name
--torque-constants constants.yaml                  # a list, or a mapping by name
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from twin_diagram.errors import LogError
from twin_diagram.logs.measured_log import Log
from twin_diagram.signals.arrays import Array

OPTION = "--torque-constants"
"""Of the command line, for messages."""


@dataclass(frozen=True)
class TorqueConstants:
    """Torque at a joint over current [N·m/A]: motor constant times gear ratio.

    Attributes:
        values: one per joint, in the model's order or by name.
    """

    values: tuple[float, ...] | Mapping[str, float]

    def of(self, joints: Sequence[str]) -> Array:
        """Return them in the order of a model's joints (n,).

        Raises:
            LogError: these are more or fewer, or have other names.
        """
        if isinstance(self.values, tuple):
            if len(self.values) != len(joints):
                raise LogError(f"{OPTION}: {len(self.values)} given; the arm has {len(joints)}: {', '.join(joints)}")
            return np.array(self.values)
        for name in self.values:
            if name not in joints:
                raise LogError(f"{OPTION}: {name!r} is no joint of the arm; they are {', '.join(joints)}")
        for joint in joints:
            if joint not in self.values:
                raise LogError(f"{OPTION}: {joint} is missing")
        return np.array([self.values[joint] for joint in joints])

    def applied(self, log: Log, joints: Sequence[str]) -> Log:
        """Return a log with torques in the place of currents.

        Args:
            log: whose `torque_measured` or `torque_commanded`, if any, are currents [A].
            joints: of the model, in its order; others are left alone.
        """
        log = log.named(joints) if log.numbered else log
        known = dict(zip(joints, self.of(joints).tolist(), strict=True))
        scale = np.array([known.get(joint, 1.0) for joint in log.joints])
        signals: dict[str, Any] = {
            name: values * scale
            for name in ("torque", "torque_commanded")
            if (values := getattr(log, name)) is not None
        }
        return replace(log, currents=False, **signals)


def torque_constants(given: Sequence[str]) -> TorqueConstants:
    """Return what a command line says.

    Args:
        given: numbers, `joint=number`, or one file; commas part them, too.

    Raises:
        LogError: what is said is none of these; the message names it.
    """
    words = [word for part in given for word in part.split(",") if word]
    if len(given) == 1 and given[0].lower().endswith((".yaml", ".yml", ".json")):
        return _from(_in_file(Path(given[0])), given[0])
    if any("=" in word for word in words):
        return _from(dict(word.partition("=")[::2] for word in words), OPTION)
    return _from(words, OPTION)


def _in_file(path: Path) -> Any:
    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise LogError(f"{OPTION} {path}: {error.strerror}") from error
    except (UnicodeDecodeError, yaml.YAMLError) as error:
        raise LogError(f"{OPTION} {path}: is no YAML") from error


def _from(content: Any, where: str) -> TorqueConstants:
    if isinstance(content, Mapping):
        return TorqueConstants({str(name): _number(value, f"{where}: {name}") for name, value in content.items()})
    if isinstance(content, list) and content:
        return TorqueConstants(tuple(_number(value, where) for value in content))
    raise LogError(f"{where}: is a list of numbers in the order of the joints, or a mapping of joints to numbers")


def _number(value: Any, where: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = float("nan")
    if isinstance(value, bool) or not np.isfinite(number) or number == 0.0:
        raise LogError(f"{where}: {value!r} is no torque constant; it is a number other than 0 [N·m/A at the joint]")
    return number
