"""What is believed of one object from frame to frame: that it is there, what it is named, and which way round."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from twin_diagram.perception.registration.alternatives import PoseHypothesis
from twin_diagram.perception.registration.data_association import Poses
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.naming import TUNING as NAMING
from twin_diagram.perception.registration.naming import Naming
from twin_diagram.perception.registration.plain_body import most_of_name
from twin_diagram.perception.registration.settling import SettledPose, apart
from twin_diagram.perception.registration.slots import TUNING as SLOTS
from twin_diagram.perception.registration.slots import Slot, predict
from twin_diagram.perception.registration.turned_alike import TUNING as TURNED
from twin_diagram.perception.registration.turned_alike import turned
from twin_diagram.scene.object_filter import FilterLayout, Mode
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, PoseMeasurement


@dataclass(frozen=True)
class Tuning:
    """Constants of what is believed, set on `sims/benchmarks/followed_scenes.py`, seeds 0 to 25."""

    even: float = 0.85
    """A pose of which this share of the surface seen fits is right as often as wrong, …"""

    doubt: float = 0.04
    """… and so much more or less of it makes it e times rarer that it is wrong, or right
    (`sims/benchmarks/followed_scenes.py`, seeds 0 to 5)."""

    alike: float = 0.65
    """Where it looks like itself to less than this share of what is usual, as much less counts as fitting."""

    missed: float = 40.0
    """An object that should be seen whole and is not loses so many nats of its odds in a second: said in 0.15 s."""

    missed_aloft: float = 160.0
    """And one that was carried: what carries it took it elsewhere. Of 30 claims of 0.5 to 0.9 that such a one is still
    where it went, and of which more than a fifth was missed, one was right (seeds 0 to 9, 21, 24, 25)."""

    forgotten: float = 60.0
    """An object that nobody sees is as likely to be there as not after so long [s], …"""

    forgotten_aloft: float = 0.5
    """… and one that was carried [s]: `slots` goes on with a speed for 0.3 s. One that moved then
    goes on, nobody knows whereto: after so long it is e times rarer where it is expected, …"""

    strays: float = 0.12
    """… as it is after so long a way at the speed that it had [m]. Of claims that what was carried is where its speed
    led, half were right within 5 cm an image later, one of seven two images later, none of 40 after that (seeds 100410
    to 100412)."""

    points: int = 300
    """Points of an object that show whether it is told from a plain body."""


TUNING = Tuning()


@dataclass
class Individual:
    """What the tracker believes of one object, be it the first of its kind or a further one.

    Attributes:
        track: its number.
        asset: its kind's, in the library.
        filter: what its measurements made of its pose; see `object_filter`.
        odds: logarithm of the odds that it is there and what it is named.
        rivals: what it may be mistaken for, as X_OO' (turn, shift) and probability, from when it was found.
        followed: whether the frame before showed it.
        posed: probability of its pose among those that the last frame that showed it allows.
        told_name: by how much a frame has told it from a plain body of the same surface in view, at most [nat].
    """

    track: int
    asset: int
    filter: Array
    odds: float = 0.0
    rivals: tuple[tuple[Array, Array, float], ...] = ()
    followed: bool = False
    posed: float = 1.0
    told_name: float = 0.0

    def named(self, said: Naming, model: ModelCloud, frame: Frame, shown: Poses | None) -> float:
        """Return the probability of its name: no more than frames can tell, unless somebody told it.

        Args:
            said: its name, as sure as what fits makes it.
            model: what it is named.
            frame: the image.
            shown: its pose, if this frame shows it.
        """
        if said == Naming():
            return said.probability
        if shown is not None and self.told_name < NAMING.certain:
            self.told_name = max(self.told_name, most_of_name(model, frame, shown, TUNING.points))
        return replace(said, odds=min(said.odds, self.told_name)).probability

    def believed(
        self, found: bool, shape: float, whole: float, since: float, aloft: bool = False, speed: float = 0.0
    ) -> float:
        """Return how probable it is after a frame, of which `whole` could be seen, and of that `shape` fits.

        Args:
            found: the frame shows it.
            shape: share of what could be seen that fits, 0 to 1.
            whole: share of its camera-facing surface that nothing hides, 0 to 1.
            since: the frame before [s].
            aloft: it was in the air when it was seen last.
            speed: that it had then [m/s]; 0: it rested.
        """
        if found:
            rarer = (shape - TUNING.even) / TUNING.doubt
            there = float(1.0 - 0.5 * np.exp(-rarer) if rarer > 0.0 else 0.5 * np.exp(rarer))
            self.odds = float(np.log(there / (1.0 - there)))
            return there
        missed = TUNING.missed_aloft if aloft else TUNING.missed
        forgotten = TUNING.forgotten_aloft if aloft else TUNING.forgotten
        self.odds -= since * missed * whole * (1.0 - shape)
        if aloft and speed > 0.0:
            rate = 1.0 / forgotten + speed / TUNING.strays
            there = np.exp(-since * rate) / (1.0 + np.exp(-self.odds))
            self.odds = float(np.log(there / (1.0 - there)))
        else:
            self.odds -= since * max(self.odds, 0.0) / forgotten
        self.odds = float(np.clip(self.odds, -20.0, 20.0))
        return float(1.0 / (1.0 + np.exp(-self.odds)))

    def with_rivals(self, after: SettledPose, right: float) -> tuple[PoseHypothesis, ...]:
        """Return what a frame allows, and what it may have been mistaken for: `right` is how probable it is not."""
        one, all_rivals = after.registration, sum(share for _, _, share in self.rivals)
        doubt = 1.0 - right if self.rivals else 0.0
        others = [
            PoseHypothesis(one.R @ turn, one.p + one.R @ shift, one.covariance, doubt * share / all_rivals)
            for turn, shift, share in self.rivals
        ]
        # What the frame says of a rival is in the doubt already.
        left = [h for h in after.hypotheses if h is after.hypotheses[0] or all(apart(h, other) for other in others)]
        whole = sum(h.probability for h in left)
        return (*(replace(h, probability=(1.0 - doubt) * h.probability / whole) for h in left), *others)


class PoseShown(NamedTuple):
    """Where a frame shows an object: R (3, 3), p (3,) [m], covariance, and what it may have been mistaken for."""

    R: Array
    p: Array
    spread: Array
    hypotheses: tuple[PoseHypothesis, ...]

    def told(self, measured: PoseMeasurement) -> PoseMeasurement:
        """Return what tracking measured, at this pose."""
        return replace(measured, pose=np.concatenate([rotations.from_matrix(self.R), self.p]))


def expected(slot: Slot, filter_: Array, believed: Array, spread: Array, now: float) -> PoseShown:
    """Return where an object is that this frame does not show: at rest as images averaged, else as tracked.

    A filter that holds what was seen last for an outlier, or for noise, or goes on with what two images made of a
    speed, knows less.

    Args:
        slot: what tracking remembers of it.
        filter_: (FILTER_SIZE,) what its measurements made of its pose.
        believed: (7,) pose that the filter gives for now.
        spread: (6, 6) its covariance.
        now: the frame's time [s].
    """
    handed = slot.seen == NEVER  # another camera's frame showed where it goes
    if not handed and filter_[FilterLayout.MODE] == Mode.REST and filter_[FilterLayout.LAST_SEEN] >= slot.seen:
        R = rotations.matrix(believed[None, :4])[0]
        if turned(R, slot.R) < TURNED.other:
            return PoseShown(R, believed[4:], spread, ())
    R, p = (slot.R, slot.p) if handed else predict(slot, min(now, slot.seen + SLOTS.coast))
    return PoseShown(R, p, spread, ())


def along_the_way(spread: Array, velocity: Array, late: float) -> Array:
    """Return the covariance (6, 6) of a pose that may be shown late.

    Args:
        spread: (6, 6) of what the image tells (rotation, translation).
        velocity: (6,) of the object [rad/s, m/s].
        late: standard deviation of how late [s].
    """
    way = late * velocity
    return np.asarray(spread + np.outer(way, way))
