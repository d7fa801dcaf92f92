"""What a hypothesis costs before it has explained anything, and which names do not go together."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.candidates.records import record_of


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    new_name: float = 6.0
    """Price of naming one more effect [nats]: some twenty names, some seven places."""

    further_joint: float = 3.0
    """Price of naming it on one more joint."""


TUNING = Tuning()


def price(members: Iterable[Candidate]) -> float:
    """Return the price of names, joints and searched shapes [nats]."""
    counts: dict[str, int] = {}
    total = 0.0
    there: set[tuple[str, int]] = set()
    for candidate in members:
        again = record_of(candidate.name).again
        if again > 0.0:
            place = (candidate.name, candidate.joints[0])
            total += again if place in there else 0.0
            there.add(place)
        counts[candidate.name] = counts.get(candidate.name, 0) + 1
        total += candidate.cost
    mixed = sum(record.mixed for record in map(record_of, counts) if record.plainer in counts)
    return total + mixed + sum(TUNING.new_name + TUNING.further_joint * (count - 1) for count in counts.values())


def compatible(members: Iterable[Candidate], new: Candidate) -> bool:
    """Return whether a candidate may join others."""
    own = record_of(new.name)
    for old in members:
        if new.name == old.name:
            same_place = new.joints == old.joints and new.links == old.links
            if own.once or (same_place and not (own.apart is not None and own.apart(new, old))):
                return False
        if new.name in old.excludes or old.name in new.excludes:
            return False
        other = record_of(old.name)
        if set(new.joints) & set(old.joints) and (old.name in own.rivals or new.name in other.rivals):
            return False
        on_one_link = new.links and new.links == old.links
        if on_one_link and (old.name in own.rivals_on_link or new.name in other.rivals_on_link):
            return False
    return True
