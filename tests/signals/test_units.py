"""Units on revolute and on prismatic joints: of strings, of the catalogue, in sentences and messages."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin_diagram.errors import ModelError
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.dynamics.parameters import ParameterSet
from twin_diagram.gap.candidates.records import sentence
from twin_diagram.gap.candidates.wording import values_on_joints
from twin_diagram.model.effects import REGISTRY, Effect, ParameterKind, add_to_plant, make
from twin_diagram.model.effects.parameter_vector import with_values
from twin_diagram.model.effects.serialisation import effect_of
from twin_diagram.model.model import Model
from twin_diagram.scenario import ArmModel, EffectSpec, Filter
from twin_diagram.signals import units

Array = npt.NDArray[np.float64]

URDF = """<robot name="gantry">
  <link name="base"/>
  <link name="cart"><inertial><origin xyz="0 0 0.05"/><mass value="6"/>
    <inertia ixx="0.05" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="4"/>
    <inertia ixx="0.06" iyy="0.06" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="rail" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="0.8 0 0.6"/>
    <limit lower="-1" upper="1" velocity="2" effort="300"/></joint>
  <joint name="shoulder" type="revolute"><parent link="cart"/><child link="upper"/><origin xyz="0 0 0.3"/>
    <axis xyz="0 1 0"/><limit lower="-2.5" upper="2.5" velocity="3" effort="80"/></joint>
</robot>
"""

CATALOGUE = {
    "viscous_friction": {"damping": "N·m·s/rad"},
    "coulomb_friction": {"torque": "N·m", "torque_positive": "N·m", "torque_negative": "N·m"},
    "stribeck_friction": {"coulomb": "N·m", "static": "N·m", "stribeck_velocity": "rad/s"},
    "load_dependent_friction": {"coefficient": "1"},
    "coupled_friction": {"damping": "N·m·s/rad", "torque": "N·m"},
    "payload": {"mass": "kg", "com": "m"},
    "inertial_parameters": {"mass": "kg", "com": "m", "inertia": "kg·m²"},
    "reflected_inertia": {"inertia": "kg·m²"},
    "gravity_tilt": {"roll": "rad", "pitch": "rad"},
    "joint_spring": {"stiffness": "N·m/rad", "rest_angle": "rad", "curve": "rad, N·m"},
    "joint_elasticity": {"stiffness": "N·m/rad", "rotor_inertia": "kg·m²", "loss": "s"},
    "backlash": {"gap": "rad", "rotor_inertia": "kg·m²"},
    "torque_ripple": {"amplitude": "N·m", "cycles": "1", "phase": "rad"},
    "torque_constant": {"gain": "1"},
    "torque_bias": {"torque": "N·m"},
    "torque_saturation": {"limit": "N·m"},
    "time_delay": {"delay": "s"},
    "encoder_offset": {"offset": "rad"},
    "external_force": {"wrench": "N, N·m", "point": "m"},
    "actuator_fault": {"gain": "1"},
}
"""What gap.json has always said; programs read it."""

SHAPED = {
    "coulomb_friction": {"torque": [5.0, 2.0]},
    "stribeck_friction": {"coulomb": [5.0, 2.0], "static": [8.0, 3.0], "stribeck_velocity": [0.3, 0.2]},
    "viscous_friction": {"damping": [40.0, 1.5]},
    "load_dependent_friction": {"coefficient": [0.1, 0.2]},
    "reflected_inertia": {"inertia": [3.0, 0.2]},
    "joint_spring": {"stiffness": [200.0, 9.0], "rest_angle": [0.1, 0.3]},
    "joint_elasticity": {"stiffness": [2e5, 3e3], "rotor_inertia": [2.0, 0.1]},
    "backlash": {"gap": [2e-4, 1e-3], "rotor_inertia": [2.0, 0.1]},
    "torque_ripple": {"amplitude": [4.0, 0.5], "cycles": [300.0, 12.0], "phase": [0.4, 1.0]},
    "torque_bias": {"torque": [7.0, 1.0]},
    "torque_saturation": {"limit": [60.0, 20.0]},
    "torque_constant": {"gain": [0.9, 1.1]},
    "actuator_fault": {"gain": [0.6, 0.7]},
    "encoder_offset": {"offset": [0.02, 0.05]},
}
"""Every effect with a value per joint, on a prismatic and a revolute joint."""


def gantry(folder: Path) -> Path:
    path = folder / "gantry.urdf"
    path.write_text(URDF)
    return path


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Model:
    path = gantry(tmp_path_factory.mktemp("gantry"))
    return Model.load(ArmModel(model=str(path), joints=["rail", "shoulder"], tool_frame=""))


def on_both(name: str, joints: tuple[str, ...] = ("rail", "shoulder"), **values: list[float]) -> EffectSpec:
    return EffectSpec(name, list(joints), [], values or SHAPED[name])


# Strings.


@pytest.mark.parametrize(
    ("turning", "prismatic"),
    [
        ("N·m", "N"),
        ("rad", "m"),
        ("mrad", "mm"),
        ("rad/s²", "m/s²"),
        ("kg·m²", "kg"),
        ("N·m·s/rad", "N·s/m"),
        ("N·m·s²/rad²", "N·s²/m²"),
        ("Nm/(rad/s)", "N·s/m"),
        ("N*m*s**2/rad**2", "N·s²/m²"),
        ("N·m·s·rad⁻¹", "N·s/m"),
        ("1/rad", "1/m"),
        ("N·m/A", "N/A"),
        ("rad, N·m", "m, N"),
        *((same, same) for same in ("1", "s", "kg", "m", "N", "", "°", "counts", "W)", "m/(s", "%")),
    ],
)
def test_lever_arms_and_angles_go(turning: str, prismatic: str) -> None:
    assert units.on_joint(turning) == prismatic
    assert units.on_joint(turning, prismatic=False) == turning


@given(st.integers(-3, 3), st.integers(-3, 3), st.integers(-3, 3), st.integers(-4, 4))
def test_dimensions_of_a_product(torques: int, inertias: int, seconds: int, angles: int) -> None:
    """Torque^a · inertia^b · s^c · rad^d in m, kg, s, where a newton is kg·m/s², whatever cancels."""
    powers = {"N": torques, "m": torques + 2 * inertias, "kg": inertias, "s": seconds, "rad": angles}
    unit = "·".join(f"{name}^{power}" for name, power in powers.items() if power) or "1"
    found = dimensions(units.on_joint(unit))
    expected = {"kg": torques + inertias, "m": torques + angles, "s": seconds - 2 * torques}
    assert {name: power for name, power in found.items() if power} == {k: x for k, x in expected.items() if x}


@given(st.text(alphabet="Nmradskg·/*()²³⁻1 ^,°é", max_size=12))
def test_what_is_no_unit_does_no_harm(text: str) -> None:
    assert isinstance(units.on_joint(text), str)


def dimensions(unit: str) -> dict[str, int]:
    """Exponents of kg, m, s; an angle of a turning joint has none."""
    result = {"kg": 0, "m": 0, "s": 0}
    for name, power in units.factors(unit).items():
        for base, each in {"N": {"kg": 1, "m": 1, "s": -2}, "rad": {}}.get(name, {name: 1}).items():
            result[base] += each * power
    return result


# The catalogue.


def test_units_on_joints_that_turn_are_as_ever() -> None:
    along = {name: cls for name, cls in REGISTRY.items() if cls.__module__.startswith("twin_diagram.model.effects.")}
    assert {name: {key: kind.unit for key, kind in cls.kinds.items()} for name, cls in along.items()} == CATALOGUE
    assert all(kind.unit_on(False) == kind.unit for cls in along.values() for kind in cls.kinds.values())
    assert {name for name, cls in along.items() if cls.per_joint} == set(SHAPED)


def test_what_is_no_joints_has_one_unit() -> None:
    for name in ("payload", "inertial_parameters", "gravity_tilt", "time_delay", "external_force"):
        assert all(kind.unit_on(True) == kind.unit for kind in REGISTRY[name].kinds.values())


def scaled(unit: str, scale: dict[str, float]) -> float:
    return float(np.prod([scale[name] ** power for name, power in dimensions(unit).items()]))


@pytest.mark.parametrize("name", SHAPED)
def test_laws_hold_in_other_units(model: Model, name: str) -> None:
    """A law on a slide says the same in feet, pounds and minutes once its parameters are converted by their units."""
    scale = {"m": 1.0 / 0.3048, "kg": 1.0 / 0.4536, "s": 1.0 / 60.0}
    rng = np.random.default_rng(3)
    one = {key: value[:1] for key, value in SHAPED[name].items()}
    effect = make(on_both(name, ("rail",), **one)).on_arm(model.prismatic)
    other = with_values(
        effect,
        {key: [x * scaled(effect.unit(key, "rail"), scale) for x in value] for key, value in one.items()},
        check=False,
    )

    def column(unit: str, size: float) -> tuple[Array, Array]:
        values = np.stack([size * rng.uniform(-1.0, 1.0, 50), np.zeros(50)], axis=1)
        return values, values * scaled(unit, scale)

    here, there = zip(column("m", 0.5), column("m/s", 0.5), column("m/s²", 2.0), column("N", 90.0), strict=True)
    moving = np.abs(here[1][:, 0]) > 0.1  # where a sign is one in either unit
    said, said_there = (
        each.logged(model.joints, tau + each.torque(model.bodies, q, v, a, tau))
        for each, (q, v, a, tau) in ((effect, here), (other, there))
    )
    applied, applied_there = (each.applied(model.joints, x[3]) for each, x in ((effect, here), (other, there)))
    true, true_there = (each.true_position(model.joints, x[0]) for each, x in ((effect, here), (other, there)))
    np.testing.assert_allclose(said_there[moving], said[moving] * scaled("N", scale), rtol=1e-9)
    np.testing.assert_allclose(applied_there, applied * scaled("N", scale), rtol=1e-9)
    np.testing.assert_allclose(true_there, true * scaled("m", scale), rtol=1e-9)


def test_gears_have_units_of_their_kind() -> None:
    """Stiffness over inertia is a frequency squared on both kinds of joint, and stiffness times play an effort."""
    for prismatic, effort, coordinate in ((True, "N", {"m": 1}), (False, "N·m", {})):
        gear, play = REGISTRY["joint_elasticity"].kinds, REGISTRY["backlash"].kinds
        stiffness, inertia, gap = (
            dimensions(kind.unit_on(prismatic)) for kind in (gear["stiffness"], gear["rotor_inertia"], play["gap"])
        )
        assert {k: stiffness[k] - inertia[k] for k in stiffness} == {"kg": 0, "m": 0, "s": -2}
        assert gap == {"kg": 0, "m": 0, "s": 0, **coordinate}
        assert {k: stiffness[k] + gap[k] for k in gap} == dimensions(effort)


# Sentences and messages.


@pytest.mark.parametrize("name", SHAPED)
def test_a_joint_that_slides_is_told_in_newtons_and_metres(model: Model, name: str) -> None:
    """Each joint has its own units in one sentence; what turns is told as ever."""
    both = sentence(model.with_effects([make(on_both(name))]).effects[-1])
    alone, turning = (
        sentence(
            model.with_effects(
                [make(on_both(name, (joint,), **{key: [x[k]] for key, x in SHAPED[name].items()}))]
            ).effects[-1]
        )
        for k, joint in enumerate(("rail", "shoulder"))
    )
    for never in ("N·m", "rad", "kg·m²", "torque", "angle", "revolution"):
        assert never not in alone.replace("torque ripple", "")
    assert turning == sentence(make(on_both(name, ("shoulder",), **{k: [x[1]] for k, x in SHAPED[name].items()})))
    assert "rail" in both and "shoulder" in both
    if any(kind.unit_on(True) != kind.unit for kind in REGISTRY[name].kinds.values()):
        assert any(unit in both for unit in ("N·m", "rad", "kg·m²"))
        assert alone.split(" of ")[-1].split(" by ")[-1].split(" on ")[0] in both


def test_sentences_word_by_word(model: Model) -> None:
    def told(spec: EffectSpec) -> str:
        return sentence(model.with_effects([make(spec)]).effects[-1])

    assert told(on_both("coulomb_friction")) == "dry friction of 5 N on rail, 2 N·m on shoulder"
    assert told(on_both("viscous_friction")) == "viscous friction of 40 N·s/m on rail, 1.5 N·m·s/rad on shoulder"
    assert told(on_both("backlash")) == "play in the gear of 0.2 mm on rail, 1 mrad on shoulder"
    assert told(on_both("encoder_offset")) == "encoders read too much by 0.02 m on rail, 0.05 rad on shoulder"
    assert told(on_both("joint_elasticity")) == (
        "an elastic gear of 2e+05 N/m on rail behind a rotor of 2 kg more; "
        "3000 N·m/rad on shoulder behind a rotor of 0.1 kg·m² more"
    )
    assert told(on_both("torque_ripple")) == (
        "torque ripple of 4 N, again every 0.02094 m, on rail; 0.5 N·m, 12 times per revolution, on shoulder"
    )
    assert told(on_both("torque_bias", ("rail",), torque=[7.0])) == (
        "a constant force beyond the logged one of 7 N on rail"
    )
    curve = on_both("joint_spring", ("rail",), curve=[-0.5, 0.0, 0.5, -20.0, 0.0, 30.0])
    assert told(curve) == (
        "a spring on rail whose force follows a curve of the position, -20 to 30 N between -0.5 and 0.5 m"
    )
    coupled = on_both("coupled_friction", damping=[3.0], torque=[1.0])
    assert told(coupled) == ("friction on the sum of the speeds of rail, shoulder: 3 N·s/m or N·m·s/rad and 1 N or N·m")


def test_a_users_own_effect_follows(model: Model) -> None:
    class Drag(Effect):
        """Drag that grows with the square of the speed."""

        name = "quadratic_drag"
        kinds: ClassVar[Mapping[str, ParameterKind]] = {"drag": ParameterKind("N·m·s²/rad²", lower=0.0)}

        def sentence(self) -> str:
            return f"drag of {values_on_joints(self, 'drag')}"

    effect = effect_of(Drag, EffectSpec("quadratic_drag", ["rail", "shoulder"], [], {"drag": [2.0, 3.0]}))
    assert sentence(effect.on_arm(model.prismatic)) == "drag of 2 N·s²/m² on rail, 3 N·m·s²/rad² on shoulder"


def test_models_tell_their_effects(model: Model) -> None:
    """Theirs alone: an effect that a model was made of knows of no arm, and one that turns is handed on untouched."""
    effect, other = make(on_both("coulomb_friction")), make(on_both("torque_bias", ("shoulder",), torque=[1.0]))
    corrected = model.with_effects([effect, other])
    assert (
        model.prismatic == {"rail"} and corrected.effects[0].prismatic == {"rail"} and effect.prismatic == frozenset()
    )
    assert corrected.effects[1] is other
    assert corrected.with_effects(corrected.effects).effects == corrected.effects


def test_messages_are_in_the_joints_units(model: Model) -> None:
    for name, key, kg in (("viscous_friction", "damping", "N·s/m"), ("reflected_inertia", "inertia", "kg")):
        with pytest.raises(ModelError, match=rf"-3 {kg} in all on rail"):
            model.with_effects([make(on_both(name, ("rail",), **{key: [-3.0]}))])
    with pytest.raises(ModelError, match=r"-3 N in all on rail"):
        model.with_effects([make(on_both("coulomb_friction", ("rail",), torque=[-3.0]))])
    with pytest.raises(ModelError, match=r"-3 N·m in all on shoulder"):
        model.with_effects([make(on_both("coulomb_friction", ("shoulder",), torque=[-3.0]))])
    with pytest.raises(ModelError, match=r"\[-1.0\] N·m/rad \(N/m where the joint is prismatic\) is not within"):
        make(on_both("joint_spring", ("rail",), stiffness=[-1.0], rest_angle=[0.0]))
    with pytest.raises(ModelError, match=r"\[4.0\] rad is not within"):
        make(EffectSpec("gravity_tilt", [], [], {"roll": [4.0], "pitch": [0.0]}))


def test_what_a_filter_learns_is_told_in_the_joints_units(model: Model) -> None:
    parameters = ["viscous_friction", "coulomb_friction", "torque_bias", "torque_constant"]
    learnt = ParameterSet(ArmTerms.from_model(model), Filter(parameters=parameters))
    assert learnt.labels(model.joints) == [
        "viscous_friction.rail [N·s/m]",
        "viscous_friction.shoulder [N·m·s/rad]",
        "coulomb_friction.rail [N]",
        "coulomb_friction.shoulder [N·m]",
        "torque_bias.rail [N]",
        "torque_bias.shoulder [N·m]",
        "torque_constant.rail [1]",
        "torque_constant.shoulder [1]",
    ]


def test_a_simulators_messages_too(tmp_path: Path) -> None:
    from pydrake.multibody.plant import MultibodyPlant

    from twin_diagram.model.description.add_arm import add_arm

    plant = MultibodyPlant(0.001)
    arm = add_arm(plant, ArmModel(model=str(gantry(tmp_path)), joints=["rail", "shoulder"], tool_frame=""))
    with pytest.raises(ModelError, match="-3 N in all"):
        add_to_plant(plant, arm, [on_both("coulomb_friction", torque=[-3.0, 1.0])])
