"""Flat faces: found through a measured surface's noise, and stood on; what is round or bumpy has none."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from twin_diagram.assets.building.flat_faces import flat_faces, flattened
from twin_diagram.assets.building.write_asset import feet
from twin_diagram.assets.description import TUNING as SDF
from twin_diagram.signals.arrays import Array

sys.path.append(str(Path(__file__).resolve().parents[3] / "sims" / "benchmarks"))

from foreign_truth import shapes

NOISE = 3e-5
"""Of a surface that `learn` measured [m]."""


def measured(mesh: trimesh.Trimesh, seed: int = 0, noise: float = NOISE) -> trimesh.Trimesh:
    """Return a mesh cut into triangles of some 3 mm with corners off, a few by ten times as much, as learned ones."""
    vertices, faces = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, 0.003)
    fine = trimesh.Trimesh(vertices, faces)
    rng = np.random.default_rng(seed)
    fine.vertices = fine.vertices + rng.normal(0.0, noise, (len(fine.vertices), 3))
    few = rng.choice(len(fine.vertices), len(fine.vertices) // 200)
    fine.vertices[few] += rng.normal(0.0, 10.0 * noise, (len(few), 3)).clip(-20.0 * noise, 20.0 * noise)
    return fine


def sides(planes: Array) -> list[tuple[int, ...]]:
    return sorted(tuple(int(x) for x in np.rint(plane[:3])) for plane in planes)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_measured_box_stands_on_its_corners(seed: int) -> None:
    size = np.array([0.17, 0.09, 0.045])
    box = measured(trimesh.creation.box(size), seed)
    planes = flat_faces(np.asarray(box.triangles))
    assert len(planes) == 6 and len(set(sides(planes))) == 6
    stands = feet(np.asarray(box.vertices), planes)
    for plane in planes:
        off = stands @ plane[:3] + plane[3] + SDF.foot
        assert off.max() < 1e-6  # none is proud of the others
        across = np.abs(np.rint(plane[:3])) < 0.5
        own = stands[np.abs(off) < 1e-6][:, across]
        half = size[across] / 2 - SDF.foot
        for corner in np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]]) * half:
            assert np.linalg.norm(own - corner, axis=1).min() < 0.002


@pytest.mark.long
def test_what_is_round_is_not_flat() -> None:
    can = flat_faces(np.asarray(measured(trimesh.creation.cylinder(0.034, 0.1, sections=64)).triangles))
    assert sides(can) == [(0, 0, -1), (0, 0, 1)]
    # A drawn one has facets 9° apart, of which three look much the same way.
    drawn = flat_faces(np.asarray(trimesh.creation.cylinder(0.034, 0.1, sections=40).triangles))
    assert sides(drawn) == [(0, 0, -1), (0, 0, 1)]
    assert len(flat_faces(np.asarray(trimesh.creation.icosphere(4, 0.04).triangles))) == 0


def test_faces_of_a_recess_are_none() -> None:
    """Of an L only the outer ones."""
    upright, foot = trimesh.creation.box([0.03, 0.1, 0.04]), trimesh.creation.box([0.07, 0.03, 0.04])
    upright.apply_translation([0.015, 0.05, 0.0])
    foot.apply_translation([0.065, 0.015, 0.0])
    planes = flat_faces(np.asarray(measured(trimesh.util.concatenate([upright, foot])).triangles))
    assert sides(planes) == sorted([(-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1)])
    assert {round(-float(plane[3]), 3) for plane in planes if plane[0] > 0.5} == {0.1}


def test_a_true_bump_is_kept() -> None:
    """Of a drawn box, without noise, with a foot of a millimetre under it."""
    box = trimesh.creation.box([0.1, 0.08, 0.06])
    bump = trimesh.creation.box([0.01, 0.01, 0.002])
    bump.apply_translation([0.0, 0.0, -0.03])
    planes = flat_faces(np.asarray(trimesh.util.concatenate([box, bump]).triangles))
    assert (0, 0, -1) not in sides(planes) and len(planes) == 5


def test_pieces_are_cut_at_flat_faces() -> None:
    box = measured(trimesh.creation.box([0.17, 0.09, 0.045]))
    planes = flat_faces(np.asarray(box.triangles))
    flat = flattened(np.asarray(box.vertices), planes)
    assert (np.asarray(box.vertices) @ planes[:, :3].T + planes[:, 3]).max() > 3e-4
    assert (flat @ planes[:, :3].T + planes[:, 3]).max() < 1e-6
    assert np.linalg.norm(flat - box.vertices, axis=1).max() < 1e-3


@pytest.mark.parametrize("seed", [5, 18, 27])
def test_a_handles_outermost_strip_is_no_face_across_the_mug(seed: int) -> None:
    """A plane through the middle of a mug was taken for one, and the pieces beyond it were pressed onto it."""
    mug = shapes.library(np.random.default_rng([seed, 1]))[0].whole()
    planes = flat_faces(np.asarray(mug.vertices)[np.asarray(mug.faces)])
    assert {(0, 0, -1)} <= set(sides(planes)) <= {(0, 0, -1), (0, 0, 1)}
    assert float((mug.vertices @ planes[:, :3].T + planes[:, 3]).max()) < 1e-6
