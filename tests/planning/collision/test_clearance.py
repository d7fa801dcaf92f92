"""Distances of balls on links from solids and from each other, against loops over all of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twin_diagram.planning.collision.ball_cover import Balls
from twin_diagram.planning.collision.chain import Chain
from twin_diagram.planning.collision.clearance import Clearance, Surroundings
from twin_diagram.planning.collision.convex_solids import Ball, Box, Drum
from twin_diagram.planning.collision.solid_batch import Body
from twin_diagram.signals.arrays import Array

FAR = 1e3


def chain_of_three() -> Chain:
    """Turns about z, slides along x, turns about y; links of 0.4 m."""
    zero = np.zeros((3, 4, 4))
    constant, sine, cosine, linear = zero.copy(), zero.copy(), zero.copy(), zero.copy()
    for k, axis in ((0, np.array([0, 0, 1.0])), (2, np.array([0, 1.0, 0]))):
        K = np.zeros((4, 4))
        K[:3, :3] = np.cross(np.eye(3), axis)
        shift = np.eye(4)
        shift[0, 3] = 0.4 * bool(k)
        constant[k], sine[k], cosine[k] = shift @ (np.eye(4) + K @ K), shift @ K, -shift @ K @ K
    constant[1] = np.eye(4)
    constant[1][0, 3] = 0.4
    linear[1][0, 3] = 1.0
    axes = np.array([[0, 0, 1.0], [1.0, 0, 0], [0, 1.0, 0]])
    origins = np.array([[0, 0, 0], [0.4, 0, 0], [0.4, 0, 0]])
    prismatic = np.array([False, True, False])
    return Chain(constant, sine, cosine, linear, axes, origins, prismatic, np.eye(4), np.array([0, 0, -9.81]))


RNG = np.random.default_rng(0)
LINKS = np.array([3, 1, 2, 3, 1, 2, 3, 2, 1])
GROUPS = np.array([4, 0, 2, 3, 1, 2, 4, 2, 0])
PAIRS = np.array([(i, j) for i in range(9) for j in range(i) if LINKS[i] != LINKS[j] and (i + j) % 5])
BALLS = Balls(0.2 * RNG.standard_normal((9, 3)), RNG.uniform(0.02, 0.08, 9), LINKS, GROUPS, PAIRS)
BODIES = [
    Body.of(
        "boxes", [Box(np.array([0.1, 0.05, 0.2]), np.eye(3), np.array([0.1, 0, 0])), Ball(np.array([-0.2, 0, 0]), 0.05)]
    ),
    Body.of("drum", [Drum(np.zeros(3), np.array([0, 0, 1.0]), 0.1, 0.05)]),
    Body.of("ball", [Ball(np.array([0.0, 0.3, 0.1]), 0.15)]),
]
IGNORED = np.zeros((4, 3), dtype=bool)
IGNORED[1, 0] = IGNORED[0] = True
COUNT = 40
Q = RNG.uniform(-1.0, 1.0, (COUNT, 3))
PRESENT = np.array([True, True, False])


def surroundings(*, still: bool) -> Surroundings:
    X = np.tile(np.eye(4), (3, COUNT, 1, 1))
    for b in range(3):
        many = Rotation.random(COUNT, random_state=b).as_matrix()
        X[b, :, :3, :3] = many[0] if still else many
        X[b, :, :3, 3] = np.array([0.5, 0.2, 0.1]) * (b - 1) + (0.0 if still else 0.2) * RNG.standard_normal((COUNT, 3))
    return Surroundings(X, RNG.uniform(0.0, 0.03, (3, COUNT)), PRESENT, np.full(3, still))


def by_loops(clearance: Clearance, around: Surroundings) -> tuple[Array, Array, Array]:
    """(N, S, B) each ball's distance, (N, P) each pair's, (N, S, 3) centres, by no shortcut."""
    X = clearance.chain.place(Q).X_WL[:, LINKS]
    centres = np.einsum("nsij,sj->nsi", X[..., :3, :3], BALLS.centres_L) + X[..., :3, 3]
    each = np.full((COUNT, 9, 3), FAR)
    for row in range(COUNT):
        for b, body in enumerate(BODIES):
            p = (centres[row] - around.X_WO[b, row, :3, 3]) @ around.X_WO[b, row, :3, :3]
            nearest = np.min([solid.distance(p)[0] for solid in body.solids], axis=0)
            if around.present[b]:
                each[row, :, b] = nearest - BALLS.radii - around.grown[b, row]
    each[:, IGNORED[LINKS]] = FAR
    first, second = PAIRS.T
    pairs = np.linalg.norm(centres[:, first] - centres[:, second], axis=2) - BALLS.radii[first] - BALLS.radii[second]
    return each, pairs, centres


@pytest.fixture(scope="module")
def clearance() -> Clearance:
    return Clearance(chain_of_three(), BALLS, BODIES, IGNORED)


@pytest.mark.parametrize("still", [True, False])
def test_distances_are_the_smallest_of_all(clearance: Clearance, still: bool) -> None:
    around = surroundings(still=still)
    each, pairs, centres = by_loops(clearance, around)
    order = np.argsort(LINKS, kind="stable")
    np.testing.assert_allclose(clearance.centres(clearance.chain.place(Q)), centres[:, order], atol=1e-12)
    expected = np.concatenate([each.min(axis=1), pairs.min(axis=1)[:, None]], axis=1)
    np.testing.assert_allclose(clearance.distances(Q, around, 9.0), expected, atol=1e-9)
    for reach in (0.3, 0.05, 0.02):
        found = clearance.distances(Q, around, reach)
        within = expected < reach
        np.testing.assert_allclose(found[within], expected[within], atol=1e-9)
        assert within.any(axis=0)[[0, 1, 3]].all() and (found[~within] >= reach).all()
    assert (clearance.distances(Q, around, 9.0, own=False)[:, -1] == FAR).all()
    by_link = np.stack([each[:, LINKS == k].min(axis=1) for k in (1, 2, 3)], axis=1)
    np.testing.assert_allclose(clearance.link_distances(Q, around), by_link, atol=1e-9)
    rows = np.array([7, 3, 3])
    np.testing.assert_allclose(clearance.distances(Q[rows], around.take(rows), 9.0), expected[rows], atol=1e-9)


def test_own_distances_are_by_pairs_of_parts(clearance: Clearance) -> None:
    _, pairs, _ = by_loops(clearance, surroundings(still=True))
    keys = np.sort(GROUPS[PAIRS], axis=1)
    found = clearance.own_distances(Q, 9.0)
    seen = set()
    for column, (a, b) in enumerate(clearance.group_pairs):
        ordered = (GROUPS[PAIRS] == [a, b]).all(axis=1)
        assert ordered.any()
        np.testing.assert_allclose(found[:, column], pairs[:, ordered].min(axis=1), atol=1e-12)
        seen.add((min(a, b), max(a, b)))
    assert seen == {(int(a), int(b)) for a, b in keys}
    near = clearance.own_distances(Q, 0.1)
    np.testing.assert_allclose(near[found < 0.1], found[found < 0.1])
    assert (near[found >= 0.1] >= 0.1).all()
    fewer = Clearance(chain_of_three(), BALLS, BODIES, IGNORED)
    drop = np.arange(len(fewer.group_pairs)) % 2 == 0
    fewer.drop_group_pairs(drop)
    np.testing.assert_allclose(fewer.own_distances(Q, 9.0), found[:, ~drop], atol=1e-12)


@pytest.mark.parametrize("still", [True, False])
def test_contacts_are_one_per_part_with_their_slopes(clearance: Clearance, still: bool) -> None:
    around = surroundings(still=still)
    each, pairs, _ = by_loops(clearance, around)
    contacts = clearance.contacts(Q, around, 0.15, 0.1)
    expected = []
    for row in range(COUNT):
        expected += [(row, b, d) for b in range(3) for g in range(5) if (d := each[row, g == GROUPS, b].min()) < 0.15]
        for key in np.unique(GROUPS[PAIRS], axis=0):
            d = pairs[row, (GROUPS[PAIRS] == key).all(axis=1)].min()
            expected += [(row, 3, d)] * bool(d < 0.1)
    found = sorted(zip(contacts.row.tolist(), contacts.body.tolist(), contacts.distance.tolist(), strict=True))
    assert len(found) == len(expected) > 60
    np.testing.assert_allclose(found, sorted(expected), atol=1e-9)
    # Slopes, where what is nearest stays so.
    h, rows = 1e-6, contacts.row
    moved = [clearance.contacts(Q + h * np.eye(3)[j], around, 0.16, 0.11) for j in range(3)]
    checked = 0
    for k, (row, body, distance) in enumerate(zip(rows, contacts.body, contacts.distance, strict=True)):
        if (np.abs(contacts.distance[(rows == row) & (contacts.body == body)] - distance) < 1e-5).sum() > 1:
            continue
        slopes = []
        for j in range(3):
            there = moved[j].distance[(moved[j].row == row) & (moved[j].body == body)]
            slopes.append((there[np.abs(there - distance).argmin()] - distance) / h)
        checked += bool(np.abs(np.array(slopes) - contacts.gradient[k]).max() < 1e-4)
    assert checked > 0.93 * len(found)


def test_a_bodys_ball_holds_its_solids_and_no_more_than_it_must() -> None:
    body = BODIES[0]
    balls = [solid.ball for solid in body.solids]
    np.testing.assert_allclose(body.centre_O, np.mean([c for c, _ in balls], axis=0))
    assert body.radius == pytest.approx(max(np.linalg.norm(c - body.centre_O) + r for c, r in balls))
