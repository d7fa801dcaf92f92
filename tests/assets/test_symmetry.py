"""Turns that nothing tells apart: of shapes whose symmetry is known, with colours that break it, and as told."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
import trimesh

from twin_diagram.assets import symmetry
from twin_diagram.errors import AssetError
from twin_diagram.signals import rotations

Array = npt.NDArray[np.float64]
CAN = trimesh.creation.cylinder(0.034, 0.1, sections=96)
HEXAGON = trimesh.creation.cylinder(0.03, 0.08, sections=6)
CONE = trimesh.creation.cone(0.04, 0.1, sections=96)


def cloud(mesh: trimesh.Trimesh, seed: int = 1) -> tuple[Array, Array]:
    points, face = trimesh.sample.sample_surface(mesh, 4000, seed=seed)
    return np.asarray(points), np.asarray(mesh.face_normals[face])


def cup() -> trimesh.Trimesh:
    handle = trimesh.creation.box((0.03, 0.01, 0.05))
    handle.apply_translation([0.045, 0.0, 0.0])
    return trimesh.util.concatenate([CAN, handle])


@pytest.mark.parametrize(
    ("mesh", "expected"),
    [
        (trimesh.creation.box((0.06, 0.1, 0.18)), ("x 2", "y 2", "z 2")),
        (trimesh.creation.box((0.08, 0.08, 0.18)), ("x 2", "y 2", "z 4")),
        (trimesh.creation.box((0.21, 0.16, 0.07)), ("x 2", "y 2", "z 2")),
        (CAN, ("x 2", "y 2", "z any")),
        (HEXAGON, ("x 2", "y 2", "z 6")),
        (trimesh.creation.icosphere(4, 0.05), ("x any", "y any", "z any")),
        (cup(), ("x 2",)),
        (trimesh.creation.box((0.2, 0.15, 0.0002)), ("x 2", "y 2", "z 2")),
        (trimesh.creation.box((0.2, 0.2, 0.001)), ("x 2", "y 2", "z 4")),
        (trimesh.creation.cylinder(0.1, 0.001, sections=96), ("x 2", "y 2", "z any")),
    ],
)
def test_shapes_repeat_themselves_as_they_do(mesh: trimesh.Trimesh, expected: tuple[str, ...]) -> None:
    points, normals = cloud(mesh)
    assert symmetry.proposed(points, normals, np.full((4000, 3), 0.4)) == expected


@pytest.mark.parametrize("teeth", [7, 12, 20])
def test_a_gear_repeats_itself_by_each_of_its_teeth(teeth: int) -> None:
    gear = [trimesh.creation.cylinder(0.03, 0.012, sections=96)]
    for k in range(teeth):
        tooth = trimesh.creation.box((0.01, 0.5 * 2 * np.pi * 0.033 / teeth, 0.012))
        tooth.apply_translation([0.033, 0.0, 0.0])
        gear.append(tooth.apply_transform(trimesh.transformations.rotation_matrix(2 * np.pi * k / teeth, [0, 0, 1])))
    points, normals = cloud(trimesh.util.concatenate(gear))
    assert symmetry.proposed(points, normals, np.full((4000, 3), 0.4))[-1] == f"z {teeth}"


def test_what_is_nearly_round_does_not_repeat_itself_by_small_turns() -> None:
    oval = CAN.copy().apply_scale([1.08, 1.0, 1.0])  # 15° move its side by 0.7 mm, a quarter turn by 2.7 mm
    assert symmetry.proposed(*cloud(oval), np.full((4000, 3), 0.4)) == ("x 2", "y 2", "z 2")


def test_a_cone_has_no_upside_down() -> None:
    points, normals = cloud(CONE)
    points = points - points.mean(axis=0)
    assert symmetry.proposed(points, normals, np.full((4000, 3), 0.4)) == ("z any",)


def test_colours_break_what_the_shape_has() -> None:
    points, normals = cloud(CAN)
    colours = np.full((4000, 3), 0.6)
    label = (np.arctan2(points[:, 1], points[:, 0]) % np.pi < 0.6) & (np.abs(points[:, 2]) < 0.04)
    colours[label] = [0.6, 0.1, 0.1]
    # Two labels opposite each other, the same upside down: half a turn about z is left.
    assert symmetry.proposed(points, normals, colours)[-1] == "z 2"
    colours[points[:, 2] > 0.03] = 0.1
    assert symmetry.proposed(points, normals, colours) == ("z 2",)
    # As little as light and shade do it does not matter.
    assert symmetry.proposed(points, normals, np.full((4000, 3), 0.5) + 0.05 * normals[:, :1])[-1] == "z any"


def lit_from_one_side(normals: Array, paint: Array) -> Array:
    """Colours of paint (M, 3) as a lamp at one side shows them: what faces away has two thirds of what faces it."""
    lamp = np.array([0.5, -0.35, 0.8]) / np.linalg.norm([0.5, -0.35, 0.8])
    return np.asarray(paint * (0.6 + 0.4 * np.maximum(normals @ lamp, 0.0))[:, None])


def test_a_lamp_at_one_side_makes_nothing_less_round() -> None:
    points, normals = cloud(CONE)
    points = points - points.mean(axis=0)
    paint = np.where(points[:, 2:] > 0.0, [0.9, 0.8, 0.3], [0.85, 0.85, 0.85])
    lit = lit_from_one_side(normals, paint)
    rng = np.random.default_rng(0)
    assert symmetry.proposed(points, normals, lit + 0.02 * rng.standard_normal(lit.shape)) == ("z any",)
    # A label is no light, be it darker paint or another colour.
    angle = np.arctan2(points[:, 1], points[:, 0])
    label = (np.abs(angle) < 0.5) & (points[:, 2] > -0.02) & (points[:, 2] < 0.03)
    for one in (0.5 * paint, [0.3, 0.7, 0.85] + 0 * paint):
        labelled = lit_from_one_side(normals, np.where(label[:, None], one, paint))
        assert symmetry.proposed(points, normals, labelled) == ()
    halves = lit_from_one_side(normals, np.where(angle[:, None] > 0.0, 0.25 * paint, paint))
    assert symmetry.proposed(points, normals, halves) == ()
    # What faces away has a tenth: no lamp does that alone.
    black = paint * (0.55 + 0.45 * np.cos(angle))[:, None]
    assert symmetry.proposed(points, normals, black) == ()


def test_light_makes_no_flat_sides_alike() -> None:
    points, normals = cloud(HEXAGON)
    sides = np.full((4000, 3), 0.9) * (1.0 + 0.3 * normals[:, :1])  # of light or of paint: nothing tells
    assert not any("z" in one for one in symmetry.proposed(points, normals, sides))


def test_what_no_picture_showed_makes_nothing_less_round() -> None:
    points, normals = cloud(CONE)
    points = points - points.mean(axis=0)
    below = normals[:, 2] < -0.9
    colours = lit_from_one_side(normals, np.full((4000, 3), 0.8))
    colours[below & (points[:, 0] > 0.0)] = 0.1  # made up
    assert symmetry.proposed(points, normals, colours) == ()
    assert symmetry.proposed(points, normals, colours, below) == ("z any",)
    # Of what was seen from one side alone most is compared with what nobody saw.
    points, normals = cloud(CAN)
    colours = np.where(points[:, :1] > 0.0, 0.9, 0.1) * np.ones((4000, 3))
    assert not any("any" in one for one in symmetry.proposed(points, normals, colours, points[:, 0] < 0.0))


def test_what_is_told_is_read_or_refused() -> None:
    assert symmetry.parsed(["z 4", "x any"], "here") == ((2, 4), (0, 0))
    for wrong in ("z", "z 1", "w 2", "z -2", "z 4.5", "z 0", "zz 2", "", "x 999"):
        with pytest.raises(AssetError, match=r"^here: symmetries holds"):
            symmetry.parsed([wrong], "here")


@pytest.mark.long
def test_turns_differ_up_to_symmetries() -> None:
    turn = rotations.matrix(rotations.exp(np.array([0.3, -0.2, 0.9])))
    about = rotations.matrix(rotations.exp(np.array([[0.0, 0.0, 0.4], [0.0, 0.0, np.pi / 2], [np.pi, 0.0, 0.0]])))
    others = turn @ about
    assert np.allclose(symmetry.apart(turn, others, ()), [0.4, np.pi / 2, np.pi])
    assert np.allclose(symmetry.apart(turn, others, ((2, 4),)), [0.4, 0.0, np.pi], atol=1e-6)
    assert np.allclose(symmetry.apart(turn, others, ((2, 0),)), [0.0, 0.0, np.pi], atol=1e-6)
    assert np.allclose(symmetry.apart(turn, others, ((0, 2), (2, 0), (2, 0))), 0.0, atol=1e-6)
    assert np.allclose(symmetry.apart(turn, others, ((0, 2), (2, 4))), [0.4, 0.0, 0.0], atol=1e-6)
    assert np.allclose(symmetry.apart(turn, others, ((0, 0), (2, 0))), 0.0)
    assert np.isfinite(symmetry.apart(turn, others, ((0, 7), (2, 360)))).all()
