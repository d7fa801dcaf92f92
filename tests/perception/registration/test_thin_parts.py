"""Parts of a thing that are too small for a segment, as a handle that a strip without depth parts from its mug."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
import trimesh

from tests.synthetic_scene import camera, yawed
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.native import import_open3d
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.registration import register
from twin_diagram.perception.registration.shape_evidence import ShapeEvidence, shape_evidence
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.arrays import Array

MUG = Asset.load(models_dir() / "objects" / "mug")
R, STRIP = yawed(-2.0), 0.006


def rays_of_camera() -> Array:
    return np.concatenate([np.broadcast_to(camera().p_WC, camera().rays().shape), camera().rays()], axis=2)


def pictured(handle: bool, parted: bool, p: Array) -> npt.NDArray[np.float32]:
    """Depth (H, W) of the mug on a table, as wide as a strip beside the body without depth, where it is parted."""
    o3d = import_open3d()
    mesh = trimesh.load(MUG.folder / "visual.obj", force="mesh", process=False)
    if not handle:
        body = float(-mesh.vertices[:, 0].min())
        keep = (mesh.vertices[mesh.faces][..., 0] <= body).all(axis=1)
        mesh.update_faces(keep)
    mesh.apply_transform(np.block([[R, p[:, None]], [np.zeros(3), 1.0]]))
    floor = trimesh.creation.box((4.0, 4.0, 0.02))
    floor.apply_translation([0.0, 0.0, -0.01])
    scene = o3d.t.geometry.RaycastingScene()
    for one in (mesh, floor):
        scene.add_triangles(one.vertices.astype(np.float32), one.faces.astype(np.uint32))
    depth = scene.cast_rays(rays_of_camera().astype(np.float32))["t_hit"].numpy().astype(np.float32)
    depth[~np.isfinite(depth)] = 0.0
    if parted:
        points = (camera().p_WC + depth[..., None] * camera().rays() - p) @ R
        edge = float(-MUG.points_O[:, 0].min())
        strip = (points[..., 0] > edge - STRIP / 2) & (points[..., 0] < edge + STRIP) & (abs(points[..., 1]) < 0.012)
        depth[strip & ((points @ R.T + p)[..., 2] > 0.004)] = 0.0
    return depth


def told(handle: bool, parted: bool) -> ShapeEvidence:
    p = np.array([0.5, 0.0, -float(MUG.points_O[:, 2].min())])
    depth = pictured(handle, parted, p)
    room = scenario.Perception(workspace=[[-1.0, -1.0, -0.02], [1.2, 1.0, 1.0]])
    segments = segment(np.full((*depth.shape, 3), 128, np.uint8), depth, 1.0, Grid.of(camera(), 2), room)
    model, frame = ModelCloud.of(MUG, 1500), Frame.of(segments)
    one = register(model, frame, R, p, scenario.Registration(), points_W=segments.points_W[::10])
    evidence = shape_evidence(model, frame, segments, replace(one, R=R, p=p))
    assert evidence is not None
    return evidence


@pytest.mark.parametrize("parted", [False, True])
def test_a_handle_that_is_no_segment_is_there_nonetheless(parted: bool) -> None:
    """A mug was denied its name in two images of three, as if it were 12 % narrower along its handle."""
    evidence = told(handle=True, parted=parted)
    assert np.abs(evidence.stretch).max() < 0.02 and evidence.odds > 6.0 and evidence.missed < 0.1


def test_a_handle_that_is_not_there_is_missed() -> None:
    evidence = told(handle=False, parted=False)
    assert evidence.stretch[0] < -0.03 and evidence.odds < 2.0 and evidence.missed > 0.1
