"""Covers hold what they cover, reach no farther than told, and have no ball too many."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest
from pydrake.geometry import Capsule, Cylinder, Sphere

from twin_diagram import scenario
from twin_diagram.errors import ModelError
from twin_diagram.planning.collision.ball_cover import _not_swallowed, _round_cover, arm_balls, arm_plant, box_cover
from twin_diagram.planning.collision.chain import depths
from twin_diagram.planning.collision.geometry_to_solids import points_of
from twin_diagram.signals.arrays import Array

SIZES = [(0.05, 0.3), (0.03, 0.08), (0.1, 0.06), (0.01, 0.5), (0.06, 0.4)]


def surface(radius: float, length: float) -> Array:
    """Points of a cylinder about z, on its side and its ends."""
    rng = np.random.default_rng(0)
    angle, z = rng.uniform(0, 2 * np.pi, 3000), rng.uniform(-length / 2, length / 2, 3000)
    z[:500], z[500:1000] = length / 2, -length / 2
    share = np.where(np.arange(3000) < 1000, np.sqrt(rng.uniform(0, 1, 3000)), 1.0)
    share[:100] = share[500:600] = 1.0
    return np.stack([share * radius * np.cos(angle), share * radius * np.sin(angle), z], axis=1)


def held(points: Array, balls: list[tuple[Array, float]]) -> bool:
    inside = [np.linalg.norm(points - c, axis=1) <= r + 1e-9 for c, r in balls]
    return bool(np.any(inside, axis=0).all())


@pytest.mark.parametrize(("radius", "length"), SIZES)
def test_a_cylinder_is_held_by_as_few_balls_as_its_overhang_allows(radius: float, length: float) -> None:
    balls = _round_cover(Cylinder(radius, length))
    assert held(surface(radius, length), balls)
    count = len(balls)
    assert all(np.abs(c[:2]).max() == 0.0 and r - radius <= 0.013 + 1e-12 for c, r in balls)
    assert count == 1 or np.hypot(radius, length / (count - 1) / 2) - radius > 0.013
    np.testing.assert_allclose([r for _, r in balls], np.hypot(radius, length / count / 2))


@pytest.mark.parametrize(("radius", "length"), SIZES)
def test_a_capsule_is_held_closely(radius: float, length: float) -> None:
    balls = _round_cover(Capsule(radius, length))
    round_end = surface(radius, length)
    rng = np.random.default_rng(1)
    cap = rng.standard_normal((800, 3))
    cap *= radius / np.linalg.norm(cap, axis=1)[:, None]
    cap[:, 2] += np.sign(cap[:, 2]) * length / 2
    assert held(round_end, balls) and held(cap, balls)
    count, most = len(balls), min(0.004, 0.2 * radius)
    assert all(radius <= r <= radius + most + 1e-12 for _, r in balls)
    assert count <= 2 or np.hypot(radius, length / (count - 2) / 2) - radius > most


def test_a_sphere_is_its_own_ball() -> None:
    ((centre, radius),) = _round_cover(Sphere(0.07))
    assert radius == 0.07 and not centre.any()


@pytest.mark.parametrize(
    "size",
    [(0.1, 0.1, 0.1), (0.3, 0.05, 0.04), (0.02, 0.2, 0.02), (0.25, 0.2, 0.3), (0.5, 0.5, 0.5), (1.0, 0.02, 0.02)],
)
def test_a_box_has_the_fewest_cells_that_keep_the_overhang_or_the_best_of_thirty_six(size: tuple[float, ...]) -> None:
    cover = box_cover(np.array(size), 0.013)
    radius = cover[0][1]
    cells = [np.array(size) / n for n in product(range(1, 37), repeat=3) if np.prod(n) <= 36]
    beyond = [np.linalg.norm(c) / 2 - c.min() / 2 for c in cells]
    kept = [c for c, b in zip(cells, beyond, strict=True) if b <= 0.013]
    if kept:
        fewest = min(round(float(np.prod(np.array(size) / c))) for c in kept)
        assert len(cover) == fewest
        assert np.abs(cover[0][0]).max() + radius - max(size) / 2 < 0.05
    else:
        assert radius == pytest.approx(np.linalg.norm(cells[int(np.argmin(beyond))]) / 2)
        assert len(cover) <= 36
    # Parts are numbered along the longest edge, some 8 cm each.
    along = np.array([c[int(np.argmax(size))] for c, _, _ in cover])
    parts = np.array([part for _, _, part in cover])
    assert parts.min() == 0 and (np.diff(parts[np.argsort(along, kind="stable")]) >= 0).all()
    wanted = max(1, round(max(size) / 0.08))
    assert len(set(parts)) == min(wanted, len(set(np.round(along, 9))))


def test_balls_in_others_of_their_link_are_left_out() -> None:
    centres = np.array([[0.0, 0, 0], [0.05, 0, 0], [0.06, 0, 0], [0.05, 0, 0], [1, 0, 0], [1, 0, 0], [0.0, 0, 0.05]])
    radii = np.array([0.1, 0.05, 0.05, 0.05, 0.2, 0.2, 0.04])
    links = np.array([1, 1, 1, 2, 1, 1, 1])
    # 1 touches 0 from within, 2 reaches out, 3 is on another link, of the equal 4 and 5 the first stays.
    assert _not_swallowed(centres, radii, links) == [0, 2, 3, 4]


def test_fingers_are_held_at_both_ends_of_their_travel_and_between() -> None:
    spec = scenario.ArmModel()
    plant, scene_graph, arm, _ = arm_plant(spec)
    depth = depths(plant, arm.joint_indices)
    balls = arm_balls(plant, scene_graph, arm, depth)
    inspector = scene_graph.model_inspector()
    last = plant.get_joint(arm.joint_indices[-1]).child_body()
    own = balls.links == len(arm.joint_indices)
    context = plant.CreateDefaultContext()
    for share in (0.0, 0.5, 1.0):
        for index in arm.gripper_joint_indices:
            joint = plant.get_joint(index)
            low, high = joint.position_lower_limits()[0], joint.position_upper_limits()[0]
            q = plant.GetPositions(context).copy()
            q[joint.position_start()] = low + share * (high - low)
            plant.SetPositions(context, q)
        for index in arm.gripper_joint_indices:
            body = plant.get_joint(index).child_body()
            X_LB = np.linalg.solve(
                plant.EvalBodyPoseInWorld(context, last).GetAsMatrix4(),
                plant.EvalBodyPoseInWorld(context, body).GetAsMatrix4(),
            )
            for geometry in plant.GetCollisionGeometriesForBody(body):
                X = X_LB @ inspector.GetPoseInFrame(geometry).GetAsMatrix4()
                points = points_of(inspector, geometry) @ X[:3, :3].T + X[:3, 3]
                assert held(points, list(zip(balls.centres_L[own], balls.radii[own], strict=True)))
    # No pair of one link, none twice, none that the description's neighbours are.
    links = balls.links[balls.pairs]
    assert (links[:, 0] != links[:, 1]).all() and (balls.pairs[:, 0] < balls.pairs[:, 1]).all()
    assert len(np.unique(balls.pairs, axis=0)) == len(balls.pairs)
    assert balls.links.min() == 1


@pytest.mark.parametrize("kind", ["obj", "stl"])
def test_a_mesh_in_mm_is_asked_about_and_taken_once_it_is_scaled(tmp_path: Path, kind: str) -> None:
    corners = [(x, y, z) for x in (0, 200) for y in (0, 50) for z in (0, 50)]  # a link of 20 cm
    faces = [
        (0, 1, 3),
        (0, 3, 2),
        (4, 6, 7),
        (4, 7, 5),
        (0, 4, 5),
        (0, 5, 1),
        (2, 3, 7),
        (2, 7, 6),
        (0, 2, 6),
        (0, 6, 4),
    ]
    if kind == "obj":
        lines = [*(f"v {x} {y} {z}" for x, y, z in corners), *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces)]
    else:
        lines = ["solid link"]
        for face in faces:
            vertices = "".join(f"vertex {x} {y} {z} " for x, y, z in (corners[k] for k in face))
            lines.append(f"facet normal 0 0 0 outer loop {vertices}endloop endfacet")
    (tmp_path / f"link.{kind}").write_text("\n".join(lines) + "\n")
    arm = tmp_path / "arm.urdf"
    for scale in ("", 'scale="0.001 0.001 0.001"'):
        arm.write_text(
            f"""<robot name="a"><link name="base"/><link name="upper"><inertial><mass value="1"/>
            <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial><collision><geometry>
            <mesh filename="link.{kind}" {scale}/></geometry></collision></link><joint name="turn" type="revolute">
            <parent link="base"/><child link="upper"/><limit lower="-1" upper="1" effort="9" velocity="2"/>
            </joint></robot>"""
        )
        plant, scene_graph, it, _ = arm_plant(scenario.ArmModel(model=str(arm), tool_frame=""))
        depth = depths(plant, it.joint_indices)
        if scale:
            assert arm_balls(plant, scene_graph, it, depth).radii.max() < 0.1
            continue
        with pytest.raises(ModelError, match=r"'upper': its collision mesh spans 200 m.*0\.001"):
            arm_balls(plant, scene_graph, it, depth)
