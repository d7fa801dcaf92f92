"""What a model has and what it lacks, made one: coefficients of the same law at the same place add up.

Findings are relative to the given model. Most laws are linear in their coefficients, so that adding the finding beside
what is there would do; it does not where something became less (a payload put down, a brake that wears), which no
effect can say alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

from twin_diagram.errors import ModelError
from twin_diagram.gap.candidates.merging import TUNING as MERGING
from twin_diagram.gap.candidates.records import record_of
from twin_diagram.model.effects import Effect, make, spec_of
from twin_diagram.scenario import EffectSpec


def merged(present: Iterable[Effect], added: Iterable[EffectSpec]) -> list[Effect]:
    """Return the effects of a model that had `present` and lacked `added`.

    Args:
        present: of the given model; those that its description states stay as they are.
        added: relative to it; coefficients may be negative where there is something to take away.

    Raises:
        ModelError: more is taken away than there is.
    """
    kept = [effect for effect in present if effect.given]
    specs = [spec_of(effect) for effect in present if not effect.given]
    for addition in added:
        for piece in _pieces(addition):
            left = _put_down(specs, piece)
            specs = _add(specs, piece) if left is None else left
    return [*kept, *(make(spec) for spec in specs)]


def _put_down(specs: list[EffectSpec], piece: EffectSpec) -> list[EffectSpec] | None:
    """Return what is left after a loss that belongs to no single effect; None: it does, or is none."""
    put_down = record_of(piece.name).put_down
    if put_down is None or piece.onset is not None or piece.end is not None or not is_less(piece):
        return None
    return put_down(specs, piece)


def _pieces(spec: EffectSpec) -> list[EffectSpec]:
    """Return one per joint, where the parameters are."""
    if not record_of(spec.name).joint_by_joint or len(spec.joints) < 2:
        return [spec]
    return [_on_joint(spec, k) for k in range(len(spec.joints))]


def _on_joint(spec: EffectSpec, k: int, keep: Callable[[int], bool] | None = None) -> EffectSpec:
    chosen = [i for i in range(len(spec.joints)) if (i == k if keep is None else keep(i))]
    parameters = {key: [values[i] for i in chosen] for key, values in spec.parameters.items()}
    return replace(spec, joints=[spec.joints[i] for i in chosen], links=list(spec.links), parameters=parameters)


def _add(specs: list[EffectSpec], piece: EffectSpec) -> list[EffectSpec]:
    timed = piece.onset is not None or piece.end is not None
    law = record_of(piece.name)
    for place, spec in enumerate(specs):
        wears = _wears(spec, piece) and not any(_alike(other, piece) for other in specs)
        keys = [set(some.parameters) - law.untold for some in (spec, piece)]
        if not wears and (spec.name != piece.name or keys[0] != keys[1]):
            continue
        if spec.onset is not None or spec.end is not None:
            continue
        if law.joint_by_joint:
            if len(piece.joints) != 1 or piece.joints[0] not in spec.joints or "curve" in piece.parameters:
                continue
            k = spec.joints.index(piece.joints[0])
            here = _on_joint(spec, k)
        elif spec.joints == piece.joints and (spec.links == piece.links or (law.on_last_link and not spec.links)):
            k, here = 0, replace(spec, links=list(piece.links))
        else:
            continue
        rule = law.taken_off[spec.name] if wears else law.merge
        sums = rule(here.parameters, piece.parameters)
        if sums is None or (timed and not is_less(piece)):
            continue
        rest = [_on_joint(spec, 0, lambda i, k=k: i != k)] if law.joint_by_joint else []  # type: ignore[misc]
        rest = [other for other in rest if other.joints]
        changed = EffectSpec(here.name, list(here.joints), list(here.links), sums)
        if timed:
            before = EffectSpec(here.name, list(here.joints), list(here.links), here.parameters, None, piece.onset)
            before.log = changed.log = piece.log
            before.elsewhere = changed.elsewhere = dict(piece.elsewhere)
            changed.onset, changed.end = piece.onset, piece.end
            if piece.end is not None:
                raise ModelError(f"effects.{piece.name}: became less for a while; that cannot be said")
            rest.append(before)
        now = [changed] if _something(changed) else []
        return [*specs[:place], *rest, *now, *specs[place + 1 :]]
    return [*specs, piece]


def _alike(spec: EffectSpec, piece: EffectSpec) -> bool:
    """Return whether there is friction of the same kind for a piece to be taken off."""
    return spec.name == piece.name and spec.onset is None and spec.end is None and piece.joints[0] in spec.joints


def _wears(spec: EffectSpec, piece: EffectSpec) -> bool:
    """Return whether what became less may be a part of another law, as a Stribeck curve's level is dry friction."""
    return spec.name in record_of(piece.name).taken_off and is_less(piece) and piece.joints[0] in spec.joints


def is_less(piece: EffectSpec) -> bool:
    """Return whether a piece takes away, which no effect can do alone."""
    return any(value < 0.0 for key in record_of(piece.name).leading for value in piece.parameters.get(key, []))


def _something(spec: EffectSpec) -> bool:
    law = record_of(spec.name)
    sizes = [abs(x) for key in law.leading for x in spec.parameters.get(key, [])]
    return not law.positive or max(sizes) > MERGING.nothing
