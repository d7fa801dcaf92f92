"""Which share of an object an image shows: of what faces the camera, hidden or not."""

from __future__ import annotations

import numpy as np
from pydrake.math import RigidTransform

from twin_diagram.runs.trial import TUNING, _seen_share
from twin_diagram.signals.lens import Lens


def test_the_share_seen_is_of_what_faces_the_camera() -> None:
    lens, depth = Lens.centred(64, 48, 60.0), np.ones((48, 64), dtype=np.float32)
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-0.19, 0.19, 20), np.linspace(-0.09, 0.09, 10)))
    front, back = (np.column_stack([x, y, np.full(200, z)]) for z in (0.0, 0.1))
    side = np.column_stack([np.full(20, 0.19), np.linspace(-0.09, 0.09, 20), np.full(20, 0.05)])
    points = np.concatenate([front, back, side])
    # A plate 10 cm thick; its sides, seen nearly edge on, do not count.
    normals = np.repeat([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], [200, 200, 20], axis=0)
    X_DO = RigidTransform(np.array([0.0, 0.0, 1.0]))
    assert _seen_share(points, normals, X_DO, depth, lens) == 1.0
    depth[:, :32] = 0.5  # something before its left half
    assert _seen_share(points, normals, X_DO, depth, lens) == 0.5
    depth[:] = 1.0 + 2.0 * TUNING.depth_tolerance
    assert _seen_share(points, normals, X_DO, depth, lens) == 0.0
    beside = RigidTransform(np.array([0.6, 0.0, 1.0]))  # a quarter of it within the image's right edge
    assert 0.1 < _seen_share(points, normals, beside, np.ones_like(depth), lens) < 0.4
    assert _seen_share(points[:400], -normals[:400], RigidTransform(np.array([0.0, 0.0, -1.0])), depth, lens) == 0.0
