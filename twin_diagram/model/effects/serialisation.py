"""Effects by name: the register of their classes, and their way from and to a scenario or an `effects.yaml`."""

from __future__ import annotations

import math
import sys
from typing import TypeVar

from twin_diagram.errors import ArgumentError, ModelError
from twin_diagram.model.effects.effect import Effect
from twin_diagram.model.effects.parameter import Parameter
from twin_diagram.model.effects.timing import Interval
from twin_diagram.model.effects.users_modules import SCRIPT, lacking, load_installed, module_of
from twin_diagram.scenario import EffectSpec

Class = TypeVar("Class", bound=type[Effect])
"""The class that `register` hands back as it got it."""

REGISTRY: dict[str, type[Effect]] = {}
"""Effect classes by their names in the catalogue."""


def register(cls: Class) -> Class:
    """Make an effect's class known by its name, as a decorator; raises ArgumentError for what is no effect."""
    if not (isinstance(cls, type) and issubclass(cls, Effect)):
        raise ArgumentError(f"register: a class derived from Effect is wanted, not {cls!r}")
    REGISTRY[cls.name] = cls
    return cls


def users_effects() -> dict[str, str]:
    """Return the modules of users that have registered effects here, with their files: for `import_again` elsewhere."""
    modules = {module_of(cls) for cls in REGISTRY.values()} - {"", SCRIPT}
    files = {name: getattr(sys.modules.get(name), "__file__", None) for name in sorted(modules)}
    return {name: file for name, file in files.items() if file}


def make(spec: EffectSpec) -> Effect:
    """Return the effect that a specification names.

    Raises:
        ModelError: unknown name, or parameters that do not fit it.
    """
    if spec.name not in REGISTRY:
        load_installed()
    if spec.name not in REGISTRY:
        if spec.module:
            raise ModelError(lacking(spec.name, spec.module))
        raise ModelError(f"effects: no effect is called {spec.name!r}; there are {', '.join(sorted(REGISTRY))}")
    return effect_of(REGISTRY[spec.name], spec)


def effect_of(cls: type[Effect], spec: EffectSpec) -> Effect:
    """Return the effect of a class, registered or not, that a scenario or an `effects.yaml` specifies.

    Raises:
        ModelError: an unknown or missing parameter, a wrong number of values, or a value out of bounds.
    """
    if cls.per_joint and not spec.joints:
        raise ModelError(f"effects.{cls.name}.joints: name the joints that it sits on")
    if len(set(spec.joints)) != len(spec.joints):
        raise ModelError(f"effects.{cls.name}.joints: a joint is named twice in {', '.join(spec.joints)}")
    result = cls(spec.joints, spec.links, _parameters(cls, spec))
    result.when = _interval(cls, spec)
    result.check()
    return result


def spec_of(effect: Effect) -> EffectSpec:
    """Return an effect as a scenario or an `effects.yaml` holds it; the inverse of `make`."""
    return EffectSpec(
        name=effect.name,
        joints=list(effect.joints),
        links=list(effect.links),
        parameters={key: [float(x) for x in parameter.value] for key, parameter in effect.parameters.items()},
        onset=effect.when.onset,
        end=effect.when.end,
        log=effect.when.log,
        elsewhere=dict(effect.when.elsewhere),
        module=module_of(type(effect)),
    )


def _parameters(cls: type[Effect], spec: EffectSpec) -> dict[str, Parameter]:
    """Return the parameters, in the order of `kinds`, each of the size that its kind and the joints ask for."""
    result: dict[str, Parameter] = {}
    for key in spec.parameters:
        if key not in cls.kinds:
            raise ModelError(f"effects.{cls.name}.{key}: no such parameter; it has {', '.join(cls.kinds)}")
    for key, kind in cls.kinds.items():
        where = f"effects.{cls.name}.{key}"
        size = len(spec.joints) if cls.per_joint and kind.size is not None else kind.size
        value = spec.parameters.get(key)
        if value is None:
            if kind.default is None:
                if kind.optional:
                    continue
                raise ModelError(f"{where}: is missing")
            value = [kind.default] * (size or 1)
        if size is not None and len(value) != size:
            per = " (one per joint)" if cls.per_joint else ""
            raise ModelError(f"{where}: needs {size} value(s){per}, got {len(value)}")
        result[key] = Parameter.of(kind, value, where)
    return result


def _interval(cls: type[Effect], spec: EffectSpec) -> Interval:
    """Return when it acts, its times checked."""
    for run, when in spec.elsewhere.items():
        if math.isnan(when):
            raise ModelError(f"effects.{cls.name}.elsewhere: the time in {run} is not a number")
    for key, moment in (("onset", spec.onset), ("end", spec.end)):
        if moment is not None and not math.isfinite(moment):
            raise ModelError(f"effects.{cls.name}.{key}: {moment} is not finite")
    if spec.onset is not None and spec.end is not None and not spec.onset < spec.end:
        raise ModelError(f"effects.{cls.name}.end: {spec.end:g} s is not after the onset at {spec.onset:g} s")
    return Interval(spec.onset, spec.end, spec.log, dict(spec.elsewhere))
