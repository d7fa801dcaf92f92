"""What the gap workflow knows of an effect, in one record, and the registry that all of its steps ask.

An effect's class (`twin_diagram.model.effects`) is its law. Its record says how it is told, searched for, priced,
merged with what a model has, and shown by an experiment; it stands in the file that makes the effect's candidates.
Importing `twin_diagram.gap.candidates` registers those of the catalogue. A user's own effect has none: `record_of`
makes one of its class.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.candidates.merging import Merge, Parameters, beside
from twin_diagram.gap.candidates.wording import name_and_place
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.model.effects import REGISTRY, Effect
from twin_diagram.scenario import EffectSpec
from twin_diagram.signals.arrays import Array


class Wakes(Enum):
    """What motion or load brings an effect out; see `experiments.advice`."""

    POSE = "held at many poses"
    REVERSAL = "turning back slowly"
    SPEED = "moving at several speeds"
    ACCELERATION = "accelerating hard"
    LOAD = "carrying another load"
    TIME = "waiting for it"


@dataclass(frozen=True)
class EffectRecord:
    """All that the workflow knows of one effect beside its law; what is left out is what holds of most.

    Grouped: words; candidates; price; kinship with other effects; roles in the search; refinement; experiment.

    Attributes:
        effect: its class, of which `name` is taken.
        title: headline, on revolute joints.
        explanation: one or two sentences for people who have never met it, on revolute joints.
        sentence: says an effect with its values, each in its joint's own unit.
        keys: words for parameters whose keys do not say enough.
        keys_on_prismatic: words of those that mean something else on a prismatic joint.
        on_joints: candidates of each joint, a list per joint; empty lists where they do not vary enough to matter.
        on_arm: candidates of the whole arm.
        family: records with the same, registered one after the other, make their candidates joint by joint.
        smooth: whether the first, saturated fit needs them.
        shapes: key and ratio bounds of each search about a candidate's shape.
        rebuilt: a candidate anew for another value of one of its shapes.
        shape_cost: price of the search for a shape of which dozens are worked out [nats].
        recentred: a candidate that is not linear, linearised about half of its coefficients.
        once: whether it is said once; several forces in a row follow any curve of time, several links' inertias any
            arm's.
        apart: whether two candidates at one place are two effects; None: they never are.
        again: price of a further one on a joint that has one [nats].
        mixed: price of saying it on some joints and its plainer law on others [nats].
        rivals: names that are not said of a joint beside it; it is enough that one of two says so.
        rivals_on_link: the same of a link.
        plainer: name of the plainer law that it holds; empty: none.
        plainer_share: what it brings beyond the plainer law is none of its own below this share.
        share_of_own: whether that is a share of what it brings at all, not of all evidence.
        wider_than: names of laws that it holds as a special case, so that it is never worse.
        merge: what two at one place are together.
        joint_by_joint: whether its parameters hold a value per joint, and add up joint by joint.
        leading: parameters whose sign says whether something was added or taken away, of an effect that is nothing at
            zero and cannot be below it. Empty: it can.
        on_last_link: whether one without a link sits on the last.
        taken_off: names of other laws from which a loss of it is taken where it is not there itself, and how.
        put_down: a model's specifications after a loss of it that belongs to no single one of them; None: it does.
        everywhere: its turn among the names that are tried on every joint at once; 0: it is not.
        usual: whether every joint may well lack it at once.
        starts: whether it is looked for as starting within a log.
        started: name of one that does, where that is another.
        dry: whether it holds a joint at rest.
        holds: whether it is a law of dry friction on a joint's own speed, of which a hold tells.
        coupled: whether it acts on a sum of two joints' speeds.
        motor: whether it stands between the logged torque and the motor's: it is no load of the motor.
        late: whether it delays the logged torque.
        swung: whether a gear that swings looks like it at first.
        of_rotor: whether it is of a rotor, which does not show behind its gear.
        unseen: probability, for each further joint, that it is there too and too little of it shows to be told: of laws
            whose weak ones are not among the hypotheses at all, since a shape must be found first.
        per_joint: whether a finding's parameters are told per joint.
        adds: parameters that may be negative as differences.
        logarithmic: parameters whose logarithm is refined: their size is what matters.
        untold: parameters that may be left to their defaults, and are not reported.
        fixed: which numbers of which parameters stay as they were found: a choice, as of the point about which a wrench
            is told.
        held: parameters that stay above half of what they were found to be.
        scanned: parameter on which torques depend so steeply that a step from a rough value may lead astray.
        sharp: whether it knocks, so that samples must not be thinned.
        of_link: whether it is refined as the inertia of the link that it sits on.
        left_out: standard errors, absolute and relative, of what the law leaves out, by parameter.
        wakes: what brings it out.
    """

    effect: type[Effect]
    title: str
    explanation: str
    sentence: Callable[[Effect], str] = name_and_place
    keys: Mapping[str, str] = field(default_factory=dict)
    keys_on_prismatic: Mapping[str, str] = field(default_factory=dict)

    on_joints: Callable[[Terms], list[list[Candidate]]] | None = None
    on_arm: Callable[[Terms], list[Candidate]] | None = None
    family: str = ""
    smooth: bool = True
    shapes: Callable[[Terms, Candidate], list[tuple[str, float, float]]] | None = None
    rebuilt: Callable[[Terms, Candidate, str, float], Candidate | None] | None = None
    shape_cost: float = 0.0
    recentred: Callable[[Terms, Candidate, Array], Candidate | None] | None = None

    once: bool = False
    apart: Callable[[Candidate, Candidate], bool] | None = None
    again: float = 0.0
    mixed: float = 0.0

    rivals: frozenset[str] = frozenset()
    rivals_on_link: frozenset[str] = frozenset()
    plainer: str = ""
    plainer_share: float = 0.0
    share_of_own: bool = False
    wider_than: frozenset[str] = frozenset()
    merge: Merge = beside
    joint_by_joint: bool = False
    leading: tuple[str, ...] = ()
    on_last_link: bool = False
    taken_off: Mapping[str, Merge] = field(default_factory=dict)
    put_down: Callable[[list[EffectSpec], EffectSpec], list[EffectSpec]] | None = None

    everywhere: int = 0
    usual: bool = False
    starts: bool = False
    started: str = ""
    dry: bool = False
    holds: bool = False
    coupled: bool = False
    motor: bool = False
    late: bool = False
    swung: bool = False
    of_rotor: bool = False
    unseen: float = 0.0
    per_joint: bool = True

    adds: frozenset[str] = frozenset()
    logarithmic: frozenset[str] = frozenset()
    untold: frozenset[str] = frozenset()
    fixed: Callable[[Parameters], Mapping[str, Sequence[int]]] = lambda parameters: {}
    held: frozenset[str] = frozenset()
    scanned: str = ""
    sharp: bool = False
    of_link: bool = False
    left_out: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    wakes: frozenset[Wakes] = frozenset()

    @property
    def name(self) -> str:
        """Of the catalogue."""
        return self.effect.name

    @property
    def positive(self) -> bool:
        """Whether it is nothing at zero and cannot be below it."""
        return bool(self.leading)


RECORDS: dict[str, EffectRecord] = {}
"""By name, in the order in which candidates are made."""


def register(record: EffectRecord) -> None:
    """Make a record known under its effect's name."""
    RECORDS[record.name] = record


def records() -> tuple[EffectRecord, ...]:
    """Return all that are registered."""
    return tuple(RECORDS.values())


def record_of(name: str) -> EffectRecord:
    """Return the record of a name; where none is registered, one that says what the effect's class says of itself."""
    if name in RECORDS:
        return RECORDS[name]
    effect = REGISTRY.get(name)
    text = (effect.__doc__ or "").strip() if effect is not None else ""
    title, explanation = name.replace("_", " ").capitalize(), text.splitlines()[0] if text else ""
    return EffectRecord(effect or Effect, title, explanation)


def sentence(effect: Effect) -> str:
    """Return what an effect says of itself; a class that has a `sentence()` of its own says it so."""
    own = getattr(effect, "sentence", None)
    return str(own()) if own is not None else record_of(effect.name).sentence(effect)


def catalogue_candidates(terms: Terms) -> list[Candidate]:
    """Return those of every record but for those that are proposed on the way: of joints first, then of the arm."""

    def made() -> Iterator[Candidate]:
        for _, family in itertools.groupby(records(), lambda record: record.family or record.name):
            each = [record.on_joints(terms) for record in family if record.on_joints is not None]
            for of_one in itertools.chain.from_iterable(zip(*each, strict=True)):
                yield from of_one
        for record in records():
            if record.on_arm is not None:
                yield from record.on_arm(terms)

    return list(made())
