"""Serial chains: read from a URDF, drawn at random, written as a neutral URDF, and turned into a MuJoCo model."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

DRAKE = "http://drake.mit.edu"
GRAVITY = np.array([0.0, 0.0, -9.81])


@dataclass(frozen=True, eq=False)
class Link:
    """A joint and the link that it moves; the link's frame is the joint's.

    Attributes:
        position: of the frame in the parent link's [m].
        rotation: (3, 3) of the frame in the parent link's.
        axis: unit vector, in the link's frame.
        mass: [kg].
        com: in the link's frame [m].
        inertia: (3, 3) about the centre of mass, in the link's axes [kg·m²].
        lower, upper: [rad].
        velocity: limit [rad/s].
        effort: limit, which is also what torque noise is a part of [N·m].
        rotor: reflected inertia that the description states [kg·m²].
    """

    position: Array
    rotation: Array
    axis: Array
    mass: float
    com: Array
    inertia: Array
    lower: float
    upper: float
    velocity: float
    effort: float
    rotor: float = 0.0

    def with_lump(self, mass: float, com: Array, inertia: Array | None = None) -> Link:
        """The link with a body (negative: without one) welded to it; `inertia` is about the lump's own centre."""
        lump = np.zeros((3, 3)) if inertia is None else inertia
        total = self.mass + mass
        centre = (self.mass * self.com + mass * com) / total
        both = self.inertia + lump + self.mass * _steiner(self.com - centre) + mass * _steiner(com - centre)
        return replace(self, mass=total, com=centre, inertia=both)


@dataclass(frozen=True, eq=False)
class Chain:
    """An arm whose joints and links are called `joint_1`, `link_1` and so on; the base is `link_0`.

    Attributes:
        links: from the base outwards.
        capacity: payload that the arm is built for [kg].
        kind: which arm it was, for the truth file.
        home: a pose in the middle of the usual work space (n,) [rad].
    """

    links: tuple[Link, ...]
    capacity: float
    kind: str
    home: Array

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.links)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names."""
        return tuple(f"joint_{k + 1}" for k in range(self.n))

    @property
    def link_names(self) -> tuple[str, ...]:
        """Names of the moving links."""
        return tuple(f"link_{k + 1}" for k in range(self.n))

    def column(self, name: str) -> Array:
        """A scalar attribute of every link (n,)."""
        return np.array([getattr(link, name) for link in self.links])


def _steiner(r: Array) -> Array:
    return float(r @ r) * np.eye(3) - np.outer(r, r)


def _rotation(rpy: Array) -> Array:
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return np.asarray(z @ y @ x)


def _rpy(R: Array) -> Array:
    pitch = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    if np.cos(pitch) < 1e-9:
        return np.array([np.arctan2(-R[1, 2], R[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])])


def _floats(element: ET.Element | None, name: str, default: str = "0 0 0") -> Array:
    return np.array([float(x) for x in (default if element is None else element.get(name, default)).split()])


def _inertial(link: ET.Element) -> tuple[float, Array, Array]:
    """Mass, centre and tensor about the centre, in the link's frame."""
    inertial = link.find("inertial")
    if inertial is None:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    mass = float(inertial.find("mass").get("value"))  # type: ignore[union-attr, arg-type]
    i = {key: float(value) for key, value in inertial.find("inertia").attrib.items()}  # type: ignore[union-attr]
    tensor = np.array([[i["ixx"], i["ixy"], i["ixz"]], [i["ixy"], i["iyy"], i["iyz"]], [i["ixz"], i["iyz"], i["izz"]]])
    R = _rotation(_floats(inertial.find("origin"), "rpy"))
    return mass, _floats(inertial.find("origin"), "xyz"), R @ tensor @ R.T


def read_urdf(path: Path, kind: str, capacity: float, home: Array) -> Chain:
    """A serial chain out of a URDF; fixed links are merged into what carries them."""
    root = ET.parse(path).getroot()
    links = {link.get("name"): link for link in root.iter("link")}
    joints = [joint for joint in root.findall("joint")]
    rotors = {}
    for transmission in root.iter("transmission"):
        actuator = transmission.find("actuator")
        ratio, rotor = (actuator.find(f"{{{DRAKE}}}{key}") for key in ("gear_ratio", "rotor_inertia"))  # type: ignore[union-attr]
        if ratio is not None and rotor is not None:
            name = transmission.find("joint").get("name")  # type: ignore[union-attr]
            rotors[name] = float(rotor.get("value", 0)) * float(ratio.get("value", 0)) ** 2
    children = {joint.find("child").get("link") for joint in joints}  # type: ignore[union-attr]
    (here,) = [name for name in links if name not in children]
    R, p = np.eye(3), np.zeros(3)
    chain: list[Link] = []
    while True:
        after = [joint for joint in joints if joint.find("parent").get("link") == here]  # type: ignore[union-attr]
        if not after:
            return Chain(tuple(chain), capacity, kind, home)
        (joint,) = after
        origin, here = joint.find("origin"), joint.find("child").get("link")  # type: ignore[union-attr]
        p = p + R @ _floats(origin, "xyz")
        R = R @ _rotation(_floats(origin, "rpy"))
        mass, com, inertia = _inertial(links[here])
        if joint.get("type") == "fixed":
            if chain and mass > 0.0:
                chain[-1] = chain[-1].with_lump(mass, p + R @ com, R @ inertia @ R.T)
            continue
        limit = {key: float(value) for key, value in joint.find("limit").attrib.items()}  # type: ignore[union-attr]
        chain.append(
            Link(
                p,
                R,
                _floats(joint.find("axis"), "xyz"),
                mass,
                com,
                inertia,
                limit["lower"],
                limit["upper"],
                limit["velocity"],
                limit["effort"],
                rotors.get(joint.get("name"), 0.0),
            )
        )
        R, p = np.eye(3), np.zeros(3)


def random_chain(rng: np.random.Generator) -> Chain:
    """Five to seven joints, alternating axes with an occasional parallel pair, tapering links."""
    n = int(rng.integers(5, 8))
    reach = rng.uniform(0.7, 1.6)
    lengths = np.linspace(1.0, 0.25, n) * rng.uniform(0.7, 1.3, n)
    lengths *= reach / lengths.sum()
    first = rng.uniform(4.0, 14.0)
    links = []
    previous = np.zeros(3)
    for k in range(n):
        turn = np.zeros(3) if k == 0 else np.array([rng.choice([-1, 1]) * np.pi / 2, 0.0, rng.choice([0.0, np.pi])])
        if 1 < k < n - 2 and rng.random() < 0.35:
            turn = np.array([0.0, 0.0, rng.uniform(-0.5, 0.5)])
        along = rng.normal(size=3) * [0.35, 0.35, 1.0]
        along *= lengths[k] / np.linalg.norm(along)
        position = np.array([0.0, 0.0, rng.uniform(0.1, 0.4)]) if k == 0 else previous
        previous = along  # where the next joint sits
        mass = first * 0.72**k * rng.uniform(0.7, 1.3)
        com = along * rng.uniform(0.3, 0.6) + rng.normal(size=3) * 0.01
        radii = np.array([0.06, 0.06, 0.06 + 0.3 * lengths[k]]) * rng.uniform(0.7, 1.2, 3) * 0.9**k
        size = mass * (np.sum(radii**2) - radii**2) / 5.0  # of a solid ellipsoid
        R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        half = rng.uniform(1.6, 2.9)
        velocity = rng.uniform(1.5, 3.2)
        links.append(
            Link(
                position,
                _rotation(turn),
                np.array([0.0, 0.0, 1.0]),
                mass,
                com,
                R @ np.diag(size) @ R.T,
                -half,
                half,
                velocity,
                1.0,
            )
        )
    home = rng.uniform(-0.7, 0.7, n)
    chain = Chain(tuple(links), float(rng.uniform(0.08, 0.2) * sum(link.mass for link in links)), "random", home)
    return replace(chain, links=tuple(_with_motor(chain, rng)))


def _with_motor(chain: Chain, rng: np.random.Generator) -> list[Link]:
    """Motors strong enough for the arm held out straight, and then some."""
    model = compile_model(mjcf(chain, timestep=1e-3))
    data = mujoco.MjData(model)
    worst = np.zeros(chain.n)
    for _ in range(200):
        data.qpos[:] = rng.uniform(-2.0, 2.0, chain.n)
        mujoco.mj_forward(model, data)
        worst = np.maximum(worst, np.abs(data.qfrc_bias) + 4.0 * np.diag(mass_matrix(model, data)))
    scale = rng.uniform(1.6, 2.6)
    floor = 0.12 * worst.max()
    return [
        replace(link, effort=float(np.round(scale * max(worst[k], floor), 1))) for k, link in enumerate(chain.links)
    ]


def mjcf(
    chain: Chain,
    *,
    timestep: float,
    integrator: str = "implicitfast",
    soft: dict[int, dict[str, float]] | None = None,
    hung: dict[int, str] | None = None,
    tail: str = "",
) -> str:
    """A MuJoCo model of the chain; contacts, joint limits and actuators left out.

    Args:
        chain: with the masses that the truth has.
        timestep: [s].
        integrator: MuJoCo's name.
        soft: second joints about the same axes, by joint index: `stiffness` and `damping` for an elastic one, `gap` for
            one with play; the first joint is then the motor's.
        hung: bodies welded or hinged to links, by link index, as MJCF.
        tail: more elements of the model, as MJCF.
    """
    soft, hung = soft or {}, hung or {}
    dry = 'solreffriction="0.001 1" solimpfriction="0.99 0.999 0.001"'
    opened = []
    for k, link in enumerate(chain.links):
        i = link.inertia
        full = _text([i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]])
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, link.rotation.flatten())
        axis = _text(link.axis)
        second = ""
        if k in soft:
            s = soft[k]
            if "gap" in s:
                half = 0.5 * s["gap"]
                second = (
                    f'<joint name="soft_{k + 1}" type="hinge" axis="{axis}" limited="true" range="{-half} {half}" '
                    f'solreflimit="0.002 1" solimplimit="0.95 0.99 0.0002" damping="{s.get("damping", 0.0)}"/>'
                )
            else:
                second = (
                    f'<joint name="soft_{k + 1}" type="hinge" axis="{axis}" stiffness="{s["stiffness"]}" '
                    f'damping="{s["damping"]}"/>'
                )
        opened.append(
            f'<body name="link_{k + 1}" pos="{_text(link.position)}" quat="{_text(quat)}">'
            f'<inertial pos="{_text(link.com)}" mass="{float(link.mass)!r}" fullinertia="{full}"/>'
            f'<joint name="joint_{k + 1}" type="hinge" axis="{axis}" armature="{float(link.rotor)!r}" {dry}/>'
            f"{second}{hung.get(k, '')}"
        )
    return (
        f'<mujoco model="arm"><compiler angle="radian"/>'
        f'<option timestep="{timestep}" integrator="{integrator}" gravity="{_text(GRAVITY)}">'
        f'<flag contact="disable"/></option><worldbody>{"".join(opened)}{"</body>" * chain.n}</worldbody>'
        f"{tail}</mujoco>"
    )


def compile_model(text: str) -> mujoco.MjModel:
    """Of MJCF text."""
    return mujoco.MjModel.from_xml_string(text)


def mass_matrix(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """Of the current configuration, (nv, nv)."""
    M = np.zeros((model.nv, model.nv))
    try:
        mujoco.mj_fullM(model, M, data.qM)
    except (AttributeError, TypeError):
        mujoco.mj_fullM(model, data, M)
    return M


def _text(values: Array | list[float]) -> str:
    return " ".join(repr(float(x)) for x in values)


def write_urdf(chain: Chain, path: Path) -> None:
    """The description that the workflow under test gets: neutral names, no shapes."""
    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        f'<robot xmlns:drake="{DRAKE}" name="arm">',
        '<link name="link_0"/>',
    ]
    for k, link in enumerate(chain.links):
        i = link.inertia
        lines += [
            f'<link name="link_{k + 1}"><inertial><origin xyz="{_text(link.com)}"/><mass value="{float(link.mass)!r}"/>'
            f'<inertia ixx="{i[0, 0]!r}" ixy="{i[0, 1]!r}" ixz="{i[0, 2]!r}" iyy="{i[1, 1]!r}" iyz="{i[1, 2]!r}" '
            f'izz="{i[2, 2]!r}"/></inertial></link>',
            f'<joint name="joint_{k + 1}" type="revolute"><parent link="link_{k}"/><child link="link_{k + 1}"/>'
            f'<origin xyz="{_text(link.position)}" rpy="{_text(_rpy(link.rotation))}"/><axis xyz="{_text(link.axis)}"/>'
            f'<limit lower="{link.lower!r}" upper="{link.upper!r}" velocity="{link.velocity!r}" '
            f'effort="{link.effort!r}"/></joint>',
        ]
        rotor = f'<drake:gear_ratio value="100"/><drake:rotor_inertia value="{link.rotor / 1e4!r}"/>'
        lines.append(
            f'<transmission name="motor_{k + 1}"><type>transmission_interface/SimpleTransmission</type>'
            f'<joint name="joint_{k + 1}"><hardwareInterface>hardware_interface/EffortJointInterface'
            f'</hardwareInterface></joint><actuator name="motor_{k + 1}">'
            f"{rotor if link.rotor > 0.0 else ''}</actuator></transmission>"
        )
    text = "\n".join([*lines, "</robot>", ""])
    path.write_text(re.sub(r"np\.float64\(([^)]*)\)", r"\1", text), encoding="utf-8")
