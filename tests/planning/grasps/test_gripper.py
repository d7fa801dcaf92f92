"""Grippers: the two that come along against the arms' own files, and one's own from YAML."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from pydrake.geometry import Box, Role, SceneGraph
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from twin_diagram.planning.grasps import PANDA_HAND, WSG50, Gripper, GripperError, gripper_of
from twin_diagram.signals.arrays import Array

ARMS = Path(__file__).resolve().parents[3] / "models" / "arms"


def boxes_of(file: str, frame: str, bodies: list[str], joints: dict[str, float]) -> dict[str, tuple[Array, Array]]:
    """Return the lower and upper corners of collision boxes of bodies in a frame, as Drake reads them."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    assert isinstance(scene_graph, SceneGraph)
    Parser(plant).AddModels(str(ARMS / file))
    plant.Finalize()
    diagram = builder.Build()
    context = plant.GetMyContextFromRoot(diagram.CreateDefaultContext())
    for name, place in joints.items():
        plant.GetJointByName(name).set_translation(context, place)
    inspector = scene_graph.model_inspector()
    found = {}
    for name in bodies:
        body = plant.GetBodyByName(name)
        X_GB = body.body_frame().CalcPose(context, plant.GetFrameByName(frame))
        for number, geometry in enumerate(
            inspector.GetGeometries(plant.GetBodyFrameIdOrThrow(body.index()), Role.kProximity)
        ):
            shape = inspector.GetShape(geometry)
            if isinstance(shape, Box):
                half = np.array(shape.size()) / 2
                corners = half * (np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T)
                placed = X_GB.multiply(inspector.GetPoseInFrame(geometry).multiply(corners.T)).T
                found[f"{name} {number}"] = (placed.min(axis=0), placed.max(axis=0))
    return found


@pytest.mark.parametrize(
    ("gripper", "file", "bodies", "joints"),
    [
        (
            PANDA_HAND,
            "panda_hand.urdf",
            ["panda_leftfinger", "panda_rightfinger", "panda_hand"],
            {"panda_finger_joint1": 0.04, "panda_finger_joint2": 0.04},
        ),
        (
            WSG50,
            "iiwa7_wsg.urdf",
            ["wsg_left_finger", "wsg_right_finger", "wsg_body"],
            {"left_finger_sliding_joint": -0.055, "right_finger_sliding_joint": 0.055},
        ),
    ],
    ids=["panda_hand", "wsg50"],
)
def test_shipped_grippers_are_those_of_the_arms_files(
    gripper: Gripper, file: str, bodies: list[str], joints: dict[str, float]
) -> None:
    found = boxes_of(file, gripper.frame, bodies, joints)
    assert len(found) == 7  # root, tip and pad of each finger, and the palm
    low, high = gripper.boxes()
    for name, (a, b) in found.items():
        held = ((a >= low - 1e-6) & (b <= high + 1e-6)).all(axis=1)
        # Of a finger's box behind the palm's face the palm holds the rest.
        clipped = np.array([a[0], a[1], max(a[2], gripper.palm_front)])
        held |= ((clipped >= low - 1e-6) & (b <= high + 1e-6)).all(axis=1)
        assert held.any(), (name, a, b)
    every_low = np.min([a for a, _ in found.values()], axis=0)
    every_high = np.max([b for _, b in found.values()], axis=0)
    assert low.min(axis=0) == pytest.approx(every_low, abs=1e-6)
    assert high.max(axis=0) == pytest.approx(every_high, abs=1e-6)
    inner = min(np.abs([a[1], b[1]]).min() for name, (a, b) in found.items() if "finger" in name)
    assert 2 * inner == pytest.approx(gripper.opening_most, abs=1e-6)
    for share in (0.0, 0.3):  # of the fingers' travel
        part = boxes_of(file, gripper.frame, bodies, {name: share * open_ for name, open_ in joints.items()})
        inner = min(np.abs([a[1], b[1]]).min() for name, (a, b) in part.items() if "finger" in name)
        travel = share * sum(abs(open_) for open_ in joints.values())
        assert gripper.apart(travel) == pytest.approx(2 * inner, abs=1e-6)


def test_boxes_close_and_are_drawn_out_along_the_approach() -> None:
    low, high = PANDA_HAND.boxes(0.02, retreat=0.1)
    open_low, open_high = PANDA_HAND.boxes()
    assert low[0, 1] == pytest.approx(0.01)
    assert high[1, 1] == pytest.approx(-0.01)
    assert open_low[:, 2] - low[:, 2] == pytest.approx(0.1)
    assert high[:, 2] == pytest.approx(open_high[:, 2])
    assert (high > low).all()
    assert high[0, 1] - low[0, 1] == pytest.approx(PANDA_HAND.finger_thickness)


def test_one_s_own_from_yaml(tmp_path: Path) -> None:
    file = tmp_path / "small.yaml"
    said = {**asdict(replace(PANDA_HAND, opening_most=0.03)), "name": "small"}
    said["palm_size"] = list(said["palm_size"])
    file.write_text(yaml.safe_dump(said))
    assert gripper_of(str(file)) == replace(PANDA_HAND, opening_most=0.03, name="small")
    assert gripper_of("wsg50") is WSG50
    del said["name"]
    file.write_text(yaml.safe_dump(said))
    assert gripper_of(str(file)).name == "small"  # the file's


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"force": -1.0}, "force must be positive"),
        ({"opening_most": "wide"}, "opening_most must be a finite number"),
        ({"opening_most": float("inf")}, "opening_most must be a finite number"),
        ({"opening_most": 80.0}, "over a metre"),
        ({"opening_least": 0.2}, "opening_least 0.2 must be below"),
        ({"opening_least": -0.2}, "opening_least must not be negative"),
        ({"palm_size": [0.1, 0.2]}, "palm_size must be three"),
        ({"palm_size": 3}, "palm_size must be three"),
        ({"fingers": 3}, "no field 'fingers'"),
        ({"pad_width": None}, "pad_width must be a finite number"),
        ({"pad_width": 0.21}, "0.21 wide, reach beyond the fingers"),
        ({"pad_front": 0.05}, "from 0.029 to 0.05 m"),
        ({"pad_length": 0.05}, "from -0.041 to 0.009 m"),
        ({"root_front": 0.02}, "roots that end at 0.02 m"),
        ({"root_front": -0.04}, "roots that end at -0.04 m"),
        ({"root_width": 0.0}, "are 0 wide are not on the fingers"),
        ({"name": 5}, "name must be text, not 5"),
        ({"frame": 5}, "frame must be text, not 5"),
    ],
)
def test_figures_of_no_gripper_are_refused(tmp_path: Path, change: dict[str, object], words: str) -> None:
    file = tmp_path / "odd.yaml"
    said = {**asdict(PANDA_HAND), "palm_size": list(PANDA_HAND.palm_size), **change}
    file.write_text(yaml.safe_dump(said))
    with pytest.raises(GripperError, match=words):
        gripper_of(str(file))


@pytest.mark.parametrize(
    ("text", "words"),
    [("[1, 2]", "must hold a gripper's fields"), ("a: [", "not a readable YAML"), ("force: 3.0", "lacks")],
)
def test_files_of_no_gripper_are_refused(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "odd.yaml"
    file.write_text(text)
    with pytest.raises(GripperError, match=words) as error:
        gripper_of(str(file))
    assert str(file) in str(error.value)


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(GripperError, match="panda_hand, wsg50"):
        gripper_of("robotiq")
