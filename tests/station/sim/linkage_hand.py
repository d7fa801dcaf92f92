"""A Panda whose fingers a linkage of bars carries, as a Robotiq's or an xArm's: one motor, five joints that follow."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.arrays import Array

BAR, AT_REST, SHUT = 0.05, float(np.arctan2(0.03, 0.04)), 0.9
"""Length of a bar [m], its angle at rest from the approach and the motor's travel [rad]."""
FRAME, X_FG = "panda_hand", (0.0, 0.0, 0.1525)
"""Where the tool frame is: 10 mm behind the tips, half open."""

SIDE = """
<link name="{name}_bar"><inertial><mass value="0.05"/>
<inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry>{bar}</geometry></collision></link>
<joint name="{name}_bar_joint" type="revolute"><parent link="panda_hand"/><child link="{name}_bar"/>
<origin xyz="0 {y} 0.0584"/><axis xyz="{s} 0 0"/>
<limit lower="{low}" upper="{high}" effort="20" velocity="3"/>{led}</joint>
<link name="{name}_finger"><inertial><mass value="0.05"/>
<inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="{name}_finger_joint" type="revolute"><parent link="{name}_bar"/><child link="{name}_finger"/>
<origin xyz="0 {y} 0.04"/><axis xyz="{s} 0 0"/><limit lower="-2" upper="2" effort="20" velocity="3"/>{back}</joint>
<link name="{name}_pad"><inertial><mass value="0.02"/>
<inertia ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0 {inwards} 0.03"/><geometry>{pad}</geometry></collision></link>
<joint name="{name}_pad_joint" type="fixed"><parent link="{name}_finger"/><child link="{name}_pad"/></joint>
"""
SMALL, LONG = '<box size="0.004 0.004 0.004"/>', '<box size="0.004 0.06 0.12"/>'
BOX = '<box size="0.02 0.0146 0.05"/>'
MOTOR = (
    '<transmission name="bars"><type>transmission_interface/SimpleTransmission</type><joint name="left_bar_joint">'
    "<hardwareInterface>EffortJointInterface</hardwareInterface></joint>"
    '<actuator name="bars"><mechanicalReduction>1</mechanicalReduction></actuator></transmission>'
)


def opening(angle: Array | float) -> Array:
    """Return how far the pads come apart [m] from where they meet to an angle of the motor [rad]."""
    return np.asarray(2.0 * BAR * (np.sin(AT_REST - np.asarray(angle)) - np.sin(AT_REST - SHUT)))


def linkage_hand(
    folder: Path, *, parallel: bool = True, mirrored: bool = False, bar: str = SMALL, pad: str = BOX
) -> Path:
    """Write the description.

    Args:
        folder: for it.
        parallel: whether the pads keep their direction.
        mirrored: whether the motor turns the other way: it is shut at its lower, negative end.
        bar: collision shape of a bar, about its hinge at the palm.
        pad: and of a pad.
    """
    arms = models_dir() / "arms"
    text = (arms / "panda_hand.urdf").read_text()
    for side in ("left", "right"):
        text = re.sub(rf'<link name="panda_{side}finger">.*?</link>', "", text, flags=re.DOTALL)
        text = text.replace(f'<drake:member link="panda_{side}finger"/>', f'<drake:member link="{side}_pad"/>')
    for k in (1, 2):
        text = re.sub(rf'<joint name="panda_finger_joint{k}" type.*?</joint>', "", text, flags=re.DOTALL)
        motor = rf'<transmission name="panda_finger_joint{k}_transmission">.*?</transmission>'
        text = re.sub(motor, "", text, flags=re.DOTALL)
    way = -1 if mirrored else 1
    low, high = (-SHUT, 0.0) if mirrored else (0.0, SHUT)
    mimic = '<mimic joint="left_bar_joint" multiplier="{}"/>'.format
    sides = "".join(
        SIDE.format(
            name=name, s=way * s, y=s * 0.03, inwards=-s * 0.01, bar=bar, pad=pad, low=low, high=high,
            led="" if s > 0 else mimic(1), back=mimic(-1 if parallel else 0.3),
        )
        for name, s in (("left", 1), ("right", -1))
    )  # fmt: skip
    path = folder / "hand.urdf"
    path.write_text(text.replace("</robot>", f"{sides}{MOTOR}</robot>"))
    for each in arms.iterdir():
        if each.is_dir() and not (folder / each.name).exists():
            (folder / each.name).symlink_to(each)
    return path
