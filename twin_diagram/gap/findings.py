"""What the search for a gap's cause answers: findings, near pairs, places, and the verdict over them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    guess: float = 0.4
    """Below this probability a name is a guess: something else is more likely than it is; by hand."""


TUNING = Tuning()


@dataclass(frozen=True)
class Estimate:
    """One value of a parameter with its standard error, joint-side SI units.

    Attributes:
        value: a number, or a list for vectors and curves.
        std: of the same shape.
        unit: of the catalogue, for the kind of joint that it is about (`posterior.unit_of`).
        doubt: part of the standard error that comes from what else may be there (`posterior.doubt_of`), likewise.
    """

    value: float | list[float]
    std: float | list[float]
    unit: str
    doubt: float | list[float] = 0.0


@dataclass(frozen=True)
class Moment:
    """A time in one of the fit logs.

    Attributes:
        log: which one, from 0.
        time: on that log's own clock [s].
        std: standard error [s].
    """

    log: int
    time: float
    std: float = 0.0


@dataclass(frozen=True)
class Alternative:
    """Another name for what a finding names.

    Attributes:
        name: of the catalogue.
        joints: that it would sit on.
        links: likewise.
        probability: posterior.
    """

    name: str
    joints: tuple[str, ...]
    links: tuple[str, ...]
    probability: float


@dataclass(frozen=True)
class Rest:
    """Probability that neither a finding nor one of its alternatives has.

    Attributes:
        others: explanations that are each less probable than the alternatives.
        nothing: no effect in its place.
        unseen: it, or an alternative, sits on further joints on which this motion does not show it.
        nameless: something that has no name in the catalogue.
    """

    others: float = 0.0
    nothing: float = 0.0
    unseen: float = 0.0
    nameless: float = 0.0


@dataclass(frozen=True)
class Finding:
    """One named effect.

    Attributes:
        name: of the catalogue.
        joints: that it sits on, in the model's order.
        links: that it sits on.
        parameters: by key; a joint effect has one `Estimate` per joint, any other has one `Estimate`.
        confidence: calibrated probability that name, joints and links are right.
        alternatives: at most three, most probable first, none more so than the finding.
        onset: when it starts, where that is within a log.
        end: when it ends, likewise.
        significance: distance in noise units between the best explanation with it and without it.
        rest: where the probability went that neither it nor its alternatives have.
    """

    name: str
    joints: tuple[str, ...]
    links: tuple[str, ...]
    parameters: dict[str, Estimate | dict[str, Estimate]]
    confidence: float
    alternatives: tuple[Alternative, ...] = ()
    onset: Moment | None = None
    end: Moment | None = None
    significance: float = 0.0
    rest: Rest = Rest()

    def is_guess(self) -> bool:
        """Return whether it is too improbable to be said in a headline."""
        return self.confidence < TUNING.guess


@dataclass(frozen=True)
class Separation:
    """Two explanations that the data hardly tell apart.

    Attributes:
        a: what was named.
        b: its rival.
        distance: between their torques, each fitted as well as it can be, in noise units.
        experiment: what would tell them apart.
    """

    a: str
    b: str
    distance: float
    experiment: str


@dataclass(frozen=True)
class Place:
    """Where the residual torque of the given model is.

    Attributes:
        joint: name.
        share: of the whitened residual's energy above the noise.
        condition: under which it appears, in words.
        time: [s] first and last moment, on the clock of the log that it is strongest in.
        log: that log, from 0.
    """

    joint: str
    share: float
    condition: str
    time: tuple[float, float]
    log: int = 0


@dataclass(frozen=True)
class Verdict:
    """The answer.

    Attributes:
        verdict: `named`, `none` or `unknown`.
        remainder: whether structure is left beside what was named.
        findings: one per name, or several where it starts or ends at other times on other joints; empty unless `named`.
        where: ranked.
        separation: of near pairs, closest first.
        noise_floor: (n,) standard deviation of the torque noise below the residual's cutoff [N·m].
        statistic: of the omnibus test, and what it was held against.
        remainder_statistic: of the test for structure that is left.
        recorded: (n,) residual torque that the given model, corrected before, is known to leave, to which what is left
            now comes again [N·m]; None: nothing is known of it.
        unexplained: joints on which the held-out run is left unexplained, though the fitted ones are not.
    """

    verdict: Literal["named", "none", "unknown"]
    remainder: bool
    findings: tuple[Finding, ...]
    where: tuple[Place, ...]
    separation: tuple[Separation, ...]
    noise_floor: Array
    statistic: float = 0.0
    remainder_statistic: float = 0.0
    seconds: dict[str, float] = field(default_factory=dict)
    recorded: Array | None = None
    unexplained: tuple[str, ...] = ()
