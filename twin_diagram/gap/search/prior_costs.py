"""What a hypothesis costs before it has explained anything, and which names do not go together."""

from __future__ import annotations

import math
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

    least: float = 6.0
    """Evidence that each member must bring beyond all prices [nats]; set on clean training logs."""

    further_asked: float = 0.5
    """Share of what a member must bring beyond all prices that is asked of a usual name where it is on several joints
    already: joints of one arm are alike, so that the next one is no surprise; by hand."""


TUNING = Tuning()


def further(name: str, count: int, joints: int) -> float:
    """Return the price of naming an effect on `count` of an arm's joints beyond that of naming it on one [nats].

    Joints of one arm are built alike: what every joint may lack, and several do, may as well be on any set of them,
    one out of so many sets of that size. Joint by joint, all of an arm would be the least likely of them.
    """
    each = TUNING.further_joint * (count - 1)
    if not record_of(name).usual or count < 2:
        return each
    return min(each, max(TUNING.further_joint, math.log(math.comb(max(joints, count), count))))


def asked(members: Iterable[Candidate], least: float) -> float:
    """Return the evidence that a hypothesis must bring beyond all prices [nats].

    Args:
        members: of it.
        least: that each must bring.
    """
    counts: dict[str, int] = {}
    for candidate in members:
        counts[candidate.name] = counts.get(candidate.name, 0) + 1
    later = sum(max(count - 2, 0) for name, count in counts.items() if record_of(name).usual)
    return least * (sum(counts.values()) - (1.0 - TUNING.further_asked) * later)


def price(members: Iterable[Candidate], joints: int) -> float:
    """Return the price of names, joints and searched shapes on an arm of so many joints [nats]."""
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
        total += candidate.price
    mixed = sum(record.mixed for record in map(record_of, counts) if record.plainer in counts)
    return total + mixed + sum(TUNING.new_name + further(name, count, joints) for name, count in counts.items())


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
