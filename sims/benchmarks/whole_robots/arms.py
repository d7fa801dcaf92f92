"""Draws an arm that is not what its description says: links, friction, rotors, gains and offsets, all at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from gap_truth import cases, hidden
from gap_truth.chain import Chain, Link, random_chain
from gap_truth.hidden import Hidden, Scale
from gap_truth.phenomena import install
from gap_truth.world import STEP, World

Array = npt.NDArray[np.float64]

UNUSUAL = ("payload", "gravity_tilt", "joint_spring", "time_delay", "external_force", "encoder_offset")
"""What half of the arms has beyond what all have, in turn."""

SHAPES = ("plain", "sigmoid", "power", "asymmetric", "load", "hysteresis")
"""Of friction over speed; each joint has one."""


@dataclass
class Friction:
    """What each joint's friction is, each (n,).

    Attributes:
        shape: of `SHAPES`.
        level: dry part [N·m].
        damping: [N·m·s/rad].
        speed: of the sigmoid [rad/s].
        more: of what its shape has more, as a share of the level.
        drift: share by which the level has changed at the run's end.
    """

    shape: list[str]
    level: Array
    damping: Array
    speed: Array
    more: Array
    drift: Array

    def sliding(self, v: Array, tau: Array, share: float = 0.5) -> Array:
        """Torque (…, n) that friction takes at speeds (…, n) and transmitted torques, at a share of the run's time."""
        level = self.level * (1.0 + self.drift * share)
        result = level * np.sign(v) + self.damping * v
        for j, shape in enumerate(self.shape):
            speed, at = v[..., j], level[j]
            if shape == "sigmoid":
                result[..., j] += at * (np.tanh(speed / self.speed[j]) - np.sign(speed))
            elif shape == "power":
                result[..., j] += self.more[j] * at * np.sign(speed) * np.abs(speed) ** 0.7 - self.damping[j] * speed
            elif shape == "asymmetric":
                result[..., j] += self.more[j] * at
            elif shape == "load":
                result[..., j] += self.more[j] * 0.05 * np.abs(tau[..., j]) * np.sign(speed)
        return result


@dataclass
class Truth:
    """All that is true of an arm.

    Attributes:
        described: what its description says.
        real: with the masses and rotors that it has.
        friction: on its joints.
        gain: torque applied over torque logged (n,).
        offset: torque applied beyond what is logged (n,) [N·m].
        unusual: what it has beyond that; empty for half of them.
        as_described: whether it is as it is described.
        setting: for the record.
    """

    described: Chain
    real: Chain
    friction: Friction
    gain: Array
    offset: Array
    unusual: list[Hidden]
    as_described: bool
    setting: dict[str, float | str] = field(default_factory=dict)


def arm(rng: np.random.Generator) -> Chain:
    """Three to seven joints, published or drawn."""
    if rng.random() < 0.3:
        whole = random_chain(rng)
        count = int(rng.integers(3, 6))
        return replace(whole, links=whole.links[:count], home=whole.home[:count])
    return cases.draw_arm(rng)


def other_link(link: Link, size: float, rng: np.random.Generator) -> Link:
    """The link with its mass, centre and inertia off by a share, and still a body: its pseudo-inertia stretched."""
    second = 0.5 * np.trace(link.inertia) * np.eye(3) - link.inertia + link.mass * np.outer(link.com, link.com)
    pseudo = np.block([[second, link.mass * link.com[:, None]], [link.mass * link.com[None], np.array([[link.mass]])]])
    width = np.sqrt(np.trace(link.inertia) / link.mass)
    A = np.eye(4) + 0.5 * size * np.diag(rng.normal(size=4))
    A[:3, :3] += 0.25 * size * rng.normal(size=(3, 3))
    A[:3, 3] = size * width * 0.5 * rng.normal(size=3)
    pseudo = A @ pseudo @ A.T
    mass, com = pseudo[3, 3], pseudo[:3, 3] / pseudo[3, 3]
    about = pseudo[:3, :3] - mass * np.outer(com, com)
    return replace(link, mass=float(mass), com=com, inertia=np.trace(about) * np.eye(3) - about)


def friction(chain: Chain, scale: Scale, rng: np.random.Generator) -> Friction:
    """On every joint: 1 to 6 % of its motor's torque, viscous at its speed as much again, of some shape."""
    n, effort = chain.n, chain.column("effort")
    level = effort * np.exp(rng.uniform(np.log(0.01), np.log(0.06), n))
    return Friction(
        shape=[str(x) for x in rng.choice(SHAPES, n)],
        level=level,
        damping=level * rng.uniform(0.1, 1.0, n) / np.maximum(scale.speed, 0.1),
        speed=rng.uniform(0.01, 0.05, n),
        more=rng.uniform(0.1, 0.6, n),
        drift=np.where(rng.random(n) < 0.3, rng.uniform(-0.1, 0.1, n), 0.0),
    )


def draw(chain: Chain, scale: Scale, duration: float, seed: int, rng: np.random.Generator) -> Truth:
    """What is true of an arm; of each five, the last is as described, and of the others half have something unusual."""
    n = chain.n
    if seed % 5 == 4:
        none = Friction(["plain"] * n, *(np.zeros(n) for _ in range(5)))
        return Truth(chain, chain, none, np.ones(n), np.zeros(n), [], as_described=True)
    size = float(np.exp(rng.uniform(np.log(0.03), np.log(0.3))))
    links = [other_link(link, size, rng) for link in chain.links]
    effort = chain.column("effort")
    rotors = effort * np.exp(rng.uniform(np.log(0.005), np.log(0.03), n))
    links = [replace(link, rotor=float(rotor)) for link, rotor in zip(links, rotors, strict=True)]
    if rng.random() < 0.5:  # half of the descriptions know of no rotors, the others of wrong ones
        known = [float(r * rng.uniform(0.7, 1.4)) for r in rotors]
        chain = replace(chain, links=tuple(replace(x, rotor=r) for x, r in zip(chain.links, known, strict=True)))
    else:
        chain = replace(chain, links=tuple(replace(x, rotor=0.0) for x in chain.links))
    gain = np.where(rng.random(n) < 0.3, 1.0 + rng.choice([-1.0, 1.0], n) * rng.uniform(0.02, 0.05, n), 1.0)
    offset = np.where(rng.random(n) < 0.5, 0.01 * effort * rng.normal(size=n), 0.0)
    unusual = []
    if seed % 2 == 0:
        name = UNUSUAL[(seed // 2) % len(UNUSUAL)]
        thing = hidden.draw(name, chain, scale, rng)
        if name == "payload":
            thing.values["mass"] = [chain.capacity * float(rng.uniform(0.2, 0.8))]
        if name == "external_force":
            onset = float(rng.uniform(0.2, 0.6)) * duration
            thing = replace(thing, onset=onset, end=onset + 0.2 * duration)
        unusual = [thing]
    real = replace(chain, links=tuple(links))
    return Truth(chain, real, friction(chain, scale, rng), gain, offset, unusual, False, {"links": size})


def world(truth: Truth, duration: float, afterwards: bool) -> World:
    """The arm in MuJoCo; what ended is not there afterwards."""
    made, laws = World(truth.real), truth.friction
    made.offset = np.zeros(truth.real.n)
    for thing in truth.unusual:
        if not (afterwards and thing.end is not None):
            install(made, replace(thing, onset=None if afterwards else thing.onset))
    made.motors.append(lambda t, q, v, tau: tau * truth.gain + truth.offset)
    dry = np.array([shape not in ("sigmoid", "hysteresis") for shape in laws.shape])
    level, load = np.where(dry, laws.level, 0.0), np.array([shape == "load" for shape in laws.shape])
    if np.any(laws.level):
        made.levels.append(
            lambda t, q, v, tau: level * (1.0 + laws.drift * t / duration) + load * laws.more * 0.05 * np.abs(tau)
        )
        made.loads.append(_smooth(laws, duration))
    return made


def _smooth(laws: Friction, duration: float) -> Callable[[float, Array, Array], Array]:
    """Torque of what is no dry friction: damping, sigmoids, powers, what is asymmetric, and hysteresis over 5 mrad."""
    shape = np.array(laws.shape)
    power, sigmoid, hysteresis = (shape == x for x in ("power", "sigmoid", "hysteresis"))
    constant = np.where(shape == "asymmetric", laws.more, 0.0) * laws.level
    bent = np.zeros(len(shape))

    def load(t: float, q: Array, v: Array) -> Array:
        level = laws.level * (1.0 + laws.drift * t / duration)
        bent[:] = np.clip(bent + STEP * v / 5e-3 * (1.0 - np.sign(v) * bent), -1.0, 1.0)
        rising = np.sign(v) * np.abs(v) ** 0.7 * laws.more * level
        return np.asarray(
            -np.where(power, rising, laws.damping * v)
            - sigmoid * level * np.tanh(v / np.maximum(laws.speed, 1e-6))
            - hysteresis * level * bent
            - constant
        )

    return load
