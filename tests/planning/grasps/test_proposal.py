"""Grasps of whole objects, held to plain geometry; what is asked for beside them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.planning.grasps.brute_force import box_triangles, collides, cylinder_triangles, dense_points, pad_contacts
from twin_diagram.assets.mesh import read_obj
from twin_diagram.planning.grasps import (
    PANDA_HAND,
    WSG50,
    AntipodalProposer,
    GraspError,
    GraspProposer,
    Grasps,
    Gripper,
    Wanted,
    given_poses,
    propose,
    rank,
    target_of,
)
from twin_diagram.planning.grasps.proposal import approach_poses
from twin_diagram.planning.grasps.triangles import surface_cloud
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array

MODELS = Path(__file__).resolve().parents[3] / "models" / "objects"
BOX = box_triangles(0.05, 0.08, 0.16)


def triangles_of(name: str) -> Array:
    if name == "box":
        return BOX
    if name == "tin":
        return cylinder_triangles(0.03, 0.11)
    mesh = read_obj(MODELS / name / "visual.obj")
    return mesh.vertices[mesh.faces]


def grasps_of_mesh(triangles: Array, gripper: Gripper, seed: int = 0, count: int = 10, **told: object) -> Grasps:
    points, normals = surface_cloud(triangles, 3000, seed)
    return propose(points, normals, gripper, wanted=Wanted(count, seed, triangles=triangles), **told)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def cloud() -> tuple[Array, Array]:
    return surface_cloud(BOX, 3000, 0)


@pytest.mark.parametrize("gripper", [PANDA_HAND, WSG50], ids=lambda one: one.name)
@pytest.mark.parametrize("name", ["box", "tin", "mug", "bottle", "sugar_box"])
def test_grasps_touch_nothing_but_with_their_pads_which_meet_the_surface_squarely(name: str, gripper: Gripper) -> None:
    triangles = triangles_of(name)
    points = dense_points(triangles, 0.003)
    found = grasps_of_mesh(triangles, gripper, count=6)
    assert len(found) >= 4
    cone = np.cos(np.arctan(gripper.friction))
    for k in range(len(found)):
        R, p = found.R[k], found.poses[k, 4:]
        assert not collides(triangles, points, gripper, R, p, retreat=0.10)
        width, square, share = pad_contacts(triangles, gripper, R, p)
        assert (share > 0).all()
        assert (square >= cone - 0.03).all(), (k, square)
        assert width == pytest.approx(found.width[k], abs=0.003)


@pytest.mark.parametrize("gripper", [PANDA_HAND, WSG50], ids=lambda one: one.name)
@pytest.mark.parametrize("edge", [0.006, 0.015])
@pytest.mark.parametrize("on_table", [False, True])
def test_what_is_shorter_than_the_fingers_is_held_by_the_pads(gripper: Gripper, edge: float, on_table: bool) -> None:
    """Pushed on until the palm is before it, the pads had gone past it, and there was nothing between them."""
    triangles = box_triangles(edge, edge, edge)
    table = np.array([0.0, 0.0, 1.0, -edge / 2]) if on_table else None
    found = grasps_of_mesh(triangles, gripper, count=3, table=table)
    assert len(found) == 3
    points = dense_points(triangles, 0.001)
    for R, pose in zip(found.R, found.poses, strict=True):
        assert not collides(triangles, points, gripper, R, pose[4:], retreat=0.10)
        _, square, share = pad_contacts(triangles, gripper, R, pose[4:])
        assert (share > 0).all() and (square > 0.85).all()
    assert found.width.min() >= edge - 1e-3 and found.width.max() <= np.sqrt(2) * edge + 1e-3


@pytest.mark.parametrize("gripper", [PANDA_HAND, WSG50], ids=lambda one: one.name)
@pytest.mark.parametrize("radius", [0.003, 0.004, 0.005])
def test_a_thin_rod_is_held_across_its_middle(gripper: Gripper, radius: float) -> None:
    """A pad that gave way by 2 mm met a pen on half of its round, so that all of it leaned out of the friction cone."""
    found = grasps_of_mesh(cylinder_triangles(radius, 0.14), gripper, count=3)
    assert len(found) == 3
    assert np.abs(found.R[:, 2, 1]).max() < np.sin(0.1)  # closed across the rod, not along it
    np.testing.assert_allclose(found.width, 2 * radius, rtol=0.02)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_box_is_held_across_a_side_that_fits(seed: int) -> None:
    found = grasps_of_mesh(BOX, PANDA_HAND, seed)
    assert len(found) == 10
    assert found.width == pytest.approx(0.05, abs=0.002)
    assert (np.abs(found.R[:, 0, 1]) > np.cos(np.deg2rad(10.0))).all()
    assert found.score == pytest.approx(np.sort(found.score), abs=0)
    assert found.score == pytest.approx(np.sum(list(found.terms.values()), axis=0))
    # Both contacts are on the sides they claim, and the first is the one at the pad of positive y.
    assert np.abs(found.contacts[:, :, 0]) == pytest.approx(0.025, abs=0.002)
    along = np.einsum("ki,ki->k", found.contacts[:, 0] - found.contacts[:, 1], found.R[:, :, 1])
    assert along == pytest.approx(found.width, abs=0.004)


def test_no_two_grasps_are_alike() -> None:
    found = grasps_of_mesh(BOX, WSG50)
    middle = found.contacts.mean(axis=1)
    for k in range(len(found)):
        for j in range(k):
            near = np.linalg.norm(middle[k] - middle[j]) < 0.009  # judged again on more points, they shift a little
            y, z = (float(found.R[k][:, axis] @ found.R[j][:, axis]) for axis in (1, 2))
            assert not (near and min(abs(y), z) > np.cos(np.deg2rad(14.9)))


def test_the_same_seed_gives_the_same_bits_and_another_one_others(cloud: tuple[Array, Array]) -> None:
    one, again, other = (propose(*cloud, PANDA_HAND, seed=seed) for seed in (3, 3, 4))
    assert one.poses.tobytes() == again.poses.tobytes()
    assert one.score.tobytes() == again.score.tobytes()
    assert one.reasons == again.reasons
    assert one.poses.tobytes() != other.poses.tobytes()


def test_where_the_object_lies_and_how_changes_nothing(cloud: tuple[Array, Array]) -> None:
    points, normals = cloud
    R = rotations.matrix(rotations.exp(np.array([0.4, -0.8, 1.1])))
    shift = np.array([0.5, -1.0, 2.0])
    here, there = propose(points, normals, WSG50), propose(points @ R.T + shift, normals @ R.T, WSG50)
    assert len(there) == len(here) == 10
    assert there.score[:3] == pytest.approx(here.score[:3], abs=0.03)


def test_what_is_too_wide_has_no_grasps_and_says_why() -> None:
    found = grasps_of_mesh(box_triangles(0.12, 0.13, 0.14), PANDA_HAND)
    assert len(found) == 0
    assert found.why_empty().startswith("too wide (")
    assert found.poses.shape == (0, 7)
    assert found.contacts.shape == (0, 2, 3)
    assert found.R.shape == (0, 3, 3)
    assert len(grasps_of_mesh(box_triangles(0.10, 0.13, 0.14), WSG50)) > 0  # the wider hand holds as much


def test_what_the_closed_fingers_leave_room_for_is_too_thin() -> None:
    found = grasps_of_mesh(cylinder_triangles(0.0015, 0.14), WSG50)  # its pads stay 5 mm apart
    assert len(found) == 0
    assert found.why_empty().startswith("too thin (")
    assert len(grasps_of_mesh(cylinder_triangles(0.0015, 0.14), PANDA_HAND, count=3)) == 3


def test_what_friction_cannot_carry_has_no_grasps(cloud: tuple[Array, Array]) -> None:
    most = 2 * PANDA_HAND.friction * PANDA_HAND.force / 9.81
    assert len(propose(*cloud, PANDA_HAND, mass=0.95 * most)) == 10
    heavy = propose(*cloud, PANDA_HAND, mass=1.05 * most)
    assert len(heavy) == 0
    assert heavy.why_empty().startswith("too heavy")


def test_weight_draws_grasps_to_the_centre_of_mass(cloud: tuple[Array, Array]) -> None:
    end = np.array([0.0, 0.0, 0.07])
    away = propose(*cloud, PANDA_HAND, mass=2.0, centre=end)
    level = propose(*cloud, PANDA_HAND, mass=2.0, centre=-end)
    assert away.contacts[:3, :, 2].mean() > 0.03
    assert level.contacts[:3, :, 2].mean() < -0.03


def test_a_table_is_kept_off() -> None:
    triangles = box_triangles(0.05, 0.08, 0.04)
    table = np.array([0.0, 0.0, 1.0, -0.02])
    free, found = grasps_of_mesh(triangles, PANDA_HAND), grasps_of_mesh(triangles, PANDA_HAND, table=table)
    low, high = PANDA_HAND.boxes()
    corners = np.array([np.where([i & 4, i & 2, i & 1], high, low) for i in range(8)]).reshape(-1, 3)

    def lowest(grasps: Grasps) -> Array:
        return ((corners @ grasps.R.transpose(0, 2, 1)) + grasps.poses[:, None, 4:])[:, :, 2].min(axis=1)

    assert (lowest(free) < -0.02).any()  # without a table some come from below
    assert len(found) >= 3
    assert (lowest(found) >= -0.02 + 0.0029).all()
    assert found.reasons["into the table"] > 0
    # The approach is free of it, too.
    before = found.poses.copy()
    before[:, 4:] -= 0.10 * found.approach
    assert (lowest(replace(found, poses=before)) >= -0.02).all()


def test_other_things_are_kept_off(cloud: tuple[Array, Array]) -> None:
    """A wall beside the lower half of the box, where a finger would go."""
    y, z = np.meshgrid(np.linspace(-0.2, 0.2, 60), np.linspace(-0.2, 0.0, 60))
    wall = np.stack([np.full(y.size, 0.032), y.ravel(), z.ravel()], axis=1)
    low, high = PANDA_HAND.boxes()

    def meet_the_wall(grasps: Grasps) -> list[bool]:
        places = [(wall - p) @ R for R, p in zip(grasps.R, grasps.poses[:, 4:], strict=True)]
        return [any(((x > a) & (x < b)).all(axis=1).any() for a, b in zip(low, high, strict=True)) for x in places]

    assert sum(meet_the_wall(propose(*cloud, PANDA_HAND))) > 4
    kept_off = meet_the_wall(propose(*cloud, PANDA_HAND, surroundings=wall))
    assert len(kept_off) == 10 and not any(kept_off)


def test_a_wall_all_along_leaves_no_room(cloud: tuple[Array, Array]) -> None:
    y, z = np.meshgrid(np.linspace(-0.2, 0.2, 60), np.linspace(-0.2, 0.2, 60))
    wall = np.stack([np.full(y.size, 0.032), y.ravel(), z.ravel()], axis=1)
    assert not len(propose(*cloud, PANDA_HAND, surroundings=wall))


def test_a_partial_cloud_claims_nothing_of_the_hidden_side(cloud: tuple[Array, Array]) -> None:
    points, normals = cloud
    viewpoint = np.array([0.5, 0.3, 0.5])
    shown = np.einsum("ni,ni->n", normals, viewpoint - points) > 0
    found = propose(points[shown], normals[shown], WSG50, viewpoint=viewpoint)
    assert len(found) > 0
    assert (found.seen.sum(axis=1) >= 1).all()
    assert (~found.seen).any()  # of a box no two opposite sides are seen at once
    outward = found.R[:, None, :, 1] * np.array([[[1.0], [-1.0]]])
    for k, side in np.argwhere(found.seen):
        contact = found.contacts[k, side]
        assert outward[k, side] @ (viewpoint - contact) > 0  # faces the camera
        near = np.linalg.norm(points[shown] - contact, axis=1).argmin()
        assert normals[shown][near] @ outward[k, side] > 0.8
    assert np.isnan(found.contacts[~found.seen]).all()
    assert (found.terms["unseen"] > 0).tolist() == (~found.seen).any(axis=1).tolist()
    # The finger on the hidden side has room for more than what is seen.
    assert (found.width <= WSG50.opening_most - 2 * 0.010 + 1e-9).all()
    # Without being told that it is partial, the same cloud has no second side at all.
    assert len(propose(points[shown], normals[shown], WSG50)) < len(found)


def test_grasps_that_hold_in_all_samples_of_the_pose_come_first(cloud: tuple[Array, Array]) -> None:
    sure = propose(*cloud, WSG50)
    # The object may be turned about z: a grasp along z with the box's long side in the fingers can stand that less.
    doubt = np.diag([1e-6, 1e-6, 0.12**2, 1e-8, 1e-8, 0.012**2])
    found = propose(*cloud, WSG50, wanted=Wanted(10, covariance=doubt))
    assert "misses" in found.terms
    assert "misses" not in sure.terms
    again = rank(sure, target_of(*cloud), WSG50, Wanted(10, covariance=doubt))
    assert found.terms["misses"][:3].mean() <= again.terms["misses"].mean()
    assert (again.terms["misses"] > 0).any()
    certain = rank(sure, target_of(*cloud), WSG50, Wanted(10, covariance=np.diag([1e-12] * 6)))
    assert certain.terms["misses"] == pytest.approx(0.0)


def test_what_an_arm_cannot_reach_is_left_out_and_the_whole_approach_is_asked(cloud: tuple[Array, Array]) -> None:
    asked: list[Array] = []
    X_WO = np.array([np.cos(0.3), 0.0, 0.0, np.sin(0.3), 0.4, 0.1, 0.2])
    R_WO = rotations.matrix(X_WO[:4])

    def from_above(way: Array) -> bool:
        asked.append(way)
        return bool((rotations.matrix(way[:, :4])[:, 2, 2] < -0.5).all())

    found = propose(*cloud, PANDA_HAND, wanted=Wanted(5, pose=X_WO, reachable=from_above))
    assert len(found) > 0
    assert ((found.R @ np.eye(3))[:, 2, 2] < -0.5).all()  # z of O is z of W here
    assert found.reasons["out of reach"] > 0
    way = asked[-1]
    step = np.diff(way[:, 4:], axis=0)
    assert np.linalg.norm(way[-1, 4:] - way[0, 4:]) == pytest.approx(0.10)
    assert np.cross(step, rotations.matrix(way[0, :4])[:, 2]) == pytest.approx(0.0, abs=1e-12)
    assert (step @ rotations.matrix(way[0, :4])[:, 2] > 0).all()
    ends = np.array([one[-1, 4:] for one in asked])
    in_world = found.poses[:, 4:] @ R_WO.T + X_WO[4:]
    assert np.linalg.norm(ends[None] - in_world[:, None], axis=2).min(axis=1) == pytest.approx(0.0, abs=1e-9)
    none = propose(*cloud, PANDA_HAND, wanted=Wanted(5, reachable=lambda way: False))
    assert len(none) == 0
    assert "out of reach" in none.why_empty()


def test_an_approach_ends_in_its_grasp() -> None:
    pose = np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0, 0.1, 0.2, 0.3])  # z of G is -y of O
    way = approach_poses(pose, 0.1, 3)
    assert way[-1] == pytest.approx(pose)
    assert way[0, 4:] == pytest.approx([0.1, 0.3, 0.3])
    assert way[1, 4:] == pytest.approx([0.1, 0.25, 0.3])


class StubNetwork:
    """Stands for a learned proposer: one good grasp of the box, one beside it, one in it."""

    def propose(self, points: Array, normals: Array, gripper: Gripper) -> Grasps:
        down = rotations.from_matrix(np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]))  # y of G along x of O
        return given_poses(
            np.array([[*down, 0, 0, 0.075], [*down, 0.3, 0, 0.075], [*down, 0, 0, 0.0], [*down, 0.01, 0, 0.075]])
        )


def test_learned_proposers_plug_in_and_are_not_believed(cloud: tuple[Array, Array]) -> None:
    proposers: list[GraspProposer] = [StubNetwork(), AntipodalProposer(count=3, seed=1)]
    given = [one.propose(*cloud, PANDA_HAND) for one in proposers]
    found = rank(given[0], target_of(*cloud), PANDA_HAND)
    assert [float(x) for x in found.poses[0, 4:]] == [0, 0, 0.075]
    assert len(found) == 1  # one in collision, one that holds nothing, one like the first
    assert found.reasons == {"in collision": 1, "nothing between the fingers": 1}
    assert found.width[0] == pytest.approx(0.05, abs=1e-6)
    own = rank(given[1], target_of(*cloud), PANDA_HAND)
    # Equal but for their order, which follows scores that differ as the clouds do that they were found on.
    order, before = (np.argsort(one.poses[:, 4], kind="stable") for one in (own, given[1]))
    assert own.poses[order] == pytest.approx(given[1].poses[before])
    assert own.score[order] == pytest.approx(given[1].score[before], abs=0.02)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"points": np.zeros((5, 3))}, "one normal to each point"),
        ({"points": np.zeros((5, 3)), "normals": np.ones((5, 3))}, "no surface"),
        ({"points": np.full((3000, 3), np.nan)}, "3000 of 3000 are not finite"),
        ({"points": np.zeros((3000, 2))}, r"array \(N, 3\)"),
        ({"normals": np.zeros((3000, 3))}, "have no length"),
        ({"mass": -1.0}, "must be positive"),
        ({"mass": float("nan")}, "must be positive"),
        ({"table": np.zeros(4)}, "table: must be 4 finite numbers"),
        ({"viewpoint": np.zeros(2)}, "viewpoint: must be 3 finite numbers"),
    ],
)
def test_what_cannot_be_is_refused(cloud: tuple[Array, Array], change: dict[str, object], words: str) -> None:
    given = {"points": cloud[0], "normals": cloud[1], **change}
    with pytest.raises(GraspError, match=words):
        propose(gripper=PANDA_HAND, **given)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"count": 0}, "count 0"),
        ({"seed": -1}, "seed -1"),
        ({"covariance": np.eye(5)}, "covariance"),
        ({"covariance": -np.eye(6)}, "covariance"),
    ],
)
def test_what_cannot_be_asked_is_refused(asked: dict[str, object], words: str) -> None:
    with pytest.raises(GraspError, match=words):
        Wanted(**asked)  # type: ignore[arg-type]


def revolved(profile: list[tuple[float, float]], around: int = 64) -> Array:
    """Return triangles, turned outwards, of a profile (radius, height) that starts and ends on the z axis."""
    turn = 2 * np.pi * np.arange(around + 1) / around
    r, z = np.array(profile).T
    rings = np.stack([np.outer(r, np.cos(turn)), np.outer(r, np.sin(turn)), np.repeat(z[:, None], around + 1, 1)], 2)
    a, b, c, d = rings[:-1, :-1], rings[:-1, 1:], rings[1:, :-1], rings[1:, 1:]
    both = np.concatenate([np.stack([a, b, d], 2).reshape(-1, 3, 3), np.stack([a, d, c], 2).reshape(-1, 3, 3)])
    area = np.linalg.norm(np.cross(both[:, 1] - both[:, 0], both[:, 2] - both[:, 0]), axis=1)
    return np.asarray(both[area > 1e-12])


BOWLS = [(0.003, True, 32), (0.003, False, 64), (0.003, True, 64), (0.005, True, 64)]
"""Wall [m], whether it stands on a table, and of how many flat sides it is made."""


@pytest.mark.long
@pytest.mark.parametrize(("wall", "on_table", "sides"), BOWLS)
def test_a_bowl_that_is_too_wide_is_held_at_its_rim(wall: float, on_table: bool, sides: int) -> None:
    """16 cm across: its wall curves away by 0.7 mm along a pad; of ten, five or fewer were found before."""
    angles = np.linspace(0.05, 1.35, 24)
    outside = [(0.08 * np.sin(angle), 0.08 * (1 - np.cos(angle))) for angle in angles]
    inside = [((0.08 - wall) * np.sin(angle), 0.08 - (0.08 - wall) * np.cos(angle)) for angle in angles[::-1]]
    triangles = revolved([(0.0, 0.0), *outside, *inside, (0.0, wall)], sides)
    points = dense_points(triangles, 0.002)
    table = np.array([0.0, 0.0, 1.0, 0.0]) if on_table else None
    found = grasps_of_mesh(triangles, PANDA_HAND, table=table)
    assert len(found) >= 8, found.why_empty()
    assert (np.abs(found.width - wall) < 0.0025).all()
    for R, p in zip(found.R, found.poses[:, 4:], strict=True):
        assert not collides(triangles, points, PANDA_HAND, R, p)


def test_of_a_small_thing_fewer_points_are_looked_at() -> None:
    """Nearly all of them lie between the pads: a cube of 1 cm took five times as long as a can."""
    small, large = (target_of(*surface_cloud(box_triangles(*[edge] * 3), 3000, 0)) for edge in (0.01, 0.1))
    assert len(small.sparser().thinned(600).points) == 150 and len(small.thinned(600).points) == 600
    assert len(large.sparser().thinned(600).points) == 600
    assert len(grasps_of_mesh(box_triangles(0.01, 0.01, 0.01), PANDA_HAND)) == 10
