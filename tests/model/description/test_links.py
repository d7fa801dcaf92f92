"""Links by name, of an arm whose description is made of several models."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant

from twin_diagram.errors import ModelError
from twin_diagram.gap.candidates.given_link import link_inertia
from twin_diagram.model.description.add_arm import add_arm
from twin_diagram.model.effects.serialisation import make
from twin_diagram.model.effects.simulated.add_to_plant import add_to_plant
from twin_diagram.model.effects.simulated.external_force import Push
from twin_diagram.model.model import Model
from twin_diagram.scenario import ArmModel, EffectSpec

LINK = (
    '<link name="{0}"><inertial><origin xyz="0.1 0 0.2"/><mass value="{1}"/>'
    '<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>'
)
JOINT = (
    '<joint name="{1}_turns" type="revolute"><parent link="{0}"/><child link="{1}"/><origin xyz="0.1 0 0.3"/>'
    '<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="9" velocity="2"/></joint>'
)
ARM = "".join(
    [*(LINK.format(*one) for one in (("base", 1), ("upper", 2), ("fore", 3)))]
    + [JOINT.format("base", "upper"), JOINT.format("upper", "fore")]
)


def of_two(folder: Path, upper: str) -> Path:
    """Write an arm and a hand whose `base` is called as the arm's and whose second link is called `upper`."""
    second = (
        LINK.format(upper, 0.5) + f'<joint name="w" type="fixed"><parent link="base"/><child link="{upper}"/></joint>'
    )
    (folder / "arm.urdf").write_text(f'<robot name="arm">{ARM}</robot>')
    (folder / "hand.urdf").write_text(f'<robot name="hand">{LINK.format("base", 0.7)}{second}</robot>')
    (folder / f"{upper}.dmd.yaml").write_text(
        "directives:\n- add_model: {name: arm, file: package://lab/arm.urdf}\n"
        "- add_model: {name: hand, file: package://lab/hand.urdf}\n- add_weld: {parent: arm::fore, child: hand::base}\n"
    )
    return folder / f"{upper}.dmd.yaml"


def loaded(path: Path, *effects: EffectSpec) -> Model:
    return Model.load(ArmModel(model=str(path), tool_frame="fore", effects=list(effects)), {"lab": path.parent})


@pytest.mark.parametrize("name", ["payload", "inertial_parameters"])
def test_of_two_links_the_one_that_a_joint_moves_is_meant(tmp_path: Path, name: str) -> None:
    """Drake ended in a traceback."""
    heavier = EffectSpec(name, [], ["upper"], {"mass": [1.5]})
    like, unlike = (loaded(of_two(tmp_path, upper), heavier) for upper in ("upper", "palm"))
    q, v = np.array([0.3, -0.4]), np.array([0.5, 0.2])
    np.testing.assert_allclose(like.bias(q, v), unlike.bias(q, v), rtol=1e-12)
    assert [like.bodies.body_of(link)[0] for link in like.tree.link] == [0, 1]
    assert link_inertia(like, "upper")[0] == link_inertia(unlike, "upper")[0]


def test_a_name_that_does_not_tell_which_link_is_refused(tmp_path: Path) -> None:
    heavier = EffectSpec("payload", [], ["base"], {"mass": [1.5]})
    with pytest.raises(ModelError, match=r"effects\.payload\.links: 2 links of the model are called 'base'"):
        loaded(of_two(tmp_path, "palm"), heavier)


def test_a_simulator_pushes_a_link_of_the_hand(tmp_path: Path) -> None:
    """It was looked for in the arm's own file alone."""
    plant = MultibodyPlant(1e-3)
    arm = add_arm(plant, ArmModel(model=str(of_two(tmp_path, "palm")), tool_frame="fore"), {"lab": tmp_path})
    push = make(EffectSpec("external_force", [], ["palm"], {"wrench": [1.0, 2.0, 3.0, 0.0, 0.0, 0.0]}))
    add_to_plant(plant, arm, [push])
    plant.Finalize()
    pushing = Push(plant, arm, [push])
    context = pushing.CreateDefaultContext()
    pushing.get_input_port().FixValue(context, np.zeros(plant.num_multibody_states()))
    (force,) = pushing.get_output_port().Eval(context)
    assert plant.get_body(force.body_index).name() == "palm"
    np.testing.assert_array_equal(force.F_Bq_W.translational(), [1.0, 2.0, 3.0])
