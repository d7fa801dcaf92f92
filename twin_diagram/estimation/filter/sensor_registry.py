"""The further sensors of a filter, by name: where their states lie in x, and their track records."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.errors import TwinError
from twin_diagram.estimation.filter.belief import Belief, Entry, SensorTrack
from twin_diagram.estimation.sensors.sensor import Sensor
from twin_diagram.signals import chi_square
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER


@dataclass(frozen=True)
class Tuning:
    """When a further sensor is doubted: chosen by hand.

    `sims/benchmarks/false_alarms.py` with `--sensors all` shows what it costs in false alarms.
    """

    vouched: float = 0.1
    """A sensor that was used within this time vouches for the state [s]."""

    disagreement: float = 1e-8
    """Probability that a sensor that agrees with the rest is said to contradict it, per reading."""

    farthest: float = 5.0
    """A bias this many standard deviations of its prior from zero is no bias."""

    memory: float = 32.0
    """Readings over which a sensor's NIS and its mean innovation are averaged."""


TUNING = Tuning()


class FilterError(TwinError):
    """A measurement or an input that the filter cannot take: wrong size, unknown sensor, a time that goes back."""


class Declared:
    """The further sensors, in the order in which they were added.

    Attributes:
        sensors: by name.
        own: how many states they have together.
        sizes: degrees of freedom of each.
    """

    def __init__(self) -> None:
        self.sensors: dict[str, Sensor] = {}
        self.own = 0
        self.sizes: tuple[int, ...] = ()

    def add(self, sensor: Sensor, start: int, payload: slice | None) -> None:
        """Add one.

        Args:
            sensor: its model.
            start: 3n + p: where the sensors' own states begin in x.
            payload: where in x the payload's mass and moment lie; None: not learnt.

        Raises:
            FilterError: a sensor of that name is there already.
        """
        if sensor.name in self.sensors:
            raise FilterError(f"a sensor {sensor.name!r} is declared already: give each a name of its own")
        size = len(sensor.own_std())
        sensor.declare(slice(start + self.own, start + self.own + size), payload)
        self.sensors[sensor.name] = sensor
        self.own += size
        self.sizes = (*self.sizes, sensor.size)

    def prior(self) -> Array:
        """Return (own,) variances that the sensors' own states start with."""
        return np.concatenate([np.zeros(0), *(sensor.own_std() ** 2 for sensor in self.sensors.values())])

    def walk(self) -> Array:
        """Return (own,) variances that they gain per second."""
        return np.concatenate([np.zeros(0), *(sensor.own_walk() ** 2 for sensor in self.sensors.values())])

    def labels(self) -> list[str]:
        """Return (own,) names with units."""
        return [label for sensor in self.sensors.values() for label in sensor.own_labels()]

    def track(self, belief: Belief, sensor: Sensor) -> Array | None:
        """Return the track record of a sensor, a view; None for the arm's own."""
        for other, track in zip(self.sensors.values(), belief.tracks, strict=True):
            if other is sensor:
                return track
        return None

    def start(self, belief: Belief, t: float) -> None:
        """Begin anew as the state was at t: what was refused before says nothing now."""
        for track in belief.tracks:
            track[SensorTrack.STREAK] = 0.0
            track[SensorTrack.LAST] = min(track[SensorTrack.LAST], t)

    def vouched(self, belief: Belief, sensor: Sensor | None, t: float) -> bool:
        """Return whether another sensor than this one told of the state within `vouched` before t."""
        heard = [track[SensorTrack.LAST] for track in belief.tracks]
        if sensor is not None:
            heard = [last for last, other in zip(heard, self.sensors.values(), strict=True) if other is not sensor]
            heard.append(float(belief.header[Entry.HEARD]))
        return any(last > t - TUNING.vouched for last in heard if last != NEVER)

    def suspicion(self, belief: Belief) -> dict[str, float]:
        """Return how strongly each sensor contradicts the rest, over the threshold: above 1 it does.

        Two signs: the mean of its whitened innovations over some tens of readings, which a slow pull moves long before
        a single reading leaves its gate, and a bias that has left what its prior allows.
        """
        found = {}
        for (name, sensor), track in zip(self.sensors.items(), belief.tracks, strict=True):
            level = float(track[SensorTrack.RUN]) / float(chi_square.quantile(1.0 - TUNING.disagreement, sensor.size))
            prior = sensor.own_std()
            if len(prior):
                level = max(level, float(np.max(np.abs(belief.x[sensor.own]) / (TUNING.farthest * prior))))
            found[name] = level
        return found

    def odd_one_out(self, belief: Belief) -> str | None:
        """Return which sensor is wrong, by majority; `joints` where all others agree against the arm's own.

        With one further sensor alone two stand against each other, and no majority exists: it is the one named, since
        the state hangs on the encoders.
        """
        level = self.suspicion(belief)
        against = [name for name, value in level.items() if value > 1.0]
        if len(level) > 1 and len(against) == len(level):
            return "joints"
        return max(against, key=lambda name: level[name]) if against else None


def note(track: Array, white: Array, nis: float, t: float, accepted: bool) -> None:
    """Bring a track record up to date.

    Args:
        track: the record, in place.
        white: (m,) whitened innovation.
        nis: its square.
        t: of the reading [s].
        accepted: whether it was used.
    """
    size = len(white)
    blend = 1.0 / TUNING.memory
    track[SensorTrack.NIS] = nis
    mean = track[len(SensorTrack) :]
    # Capped, so that one spike is no bias. Of white noise this mean has variance blend / (2 − blend).
    mean += blend * (np.clip(white, -6.0, 6.0) - mean)
    track[SensorTrack.RUN] = float(mean @ mean) * (2.0 - blend) / blend
    if accepted:
        track[SensorTrack.ACCEPTED] += 1
        track[SensorTrack.STREAK] = 0.0
        track[SensorTrack.LAST] = max(track[SensorTrack.LAST], t)
        track[SensorTrack.NIS_MEAN] += blend * (nis / size - track[SensorTrack.NIS_MEAN])
    else:
        track[SensorTrack.REFUSED] += 1
        track[SensorTrack.STREAK] += 1
