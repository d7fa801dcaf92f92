"""Registration by the twin, and by its peers with the true mask, each tuned."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from pose_truth.trials import Trial, segments
from twin_diagram import scenario
from twin_diagram.native import import_open3d
from twin_diagram.perception.registration.alternatives import PoseHypothesis
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.global_search import nearby
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.registration import claimed, register
from twin_diagram.perception.registration.where_expected import TUNING as TRACKING

o3d = import_open3d()
Array = npt.NDArray[np.float64]
_MODELS: dict[str, ModelCloud] = {}
_PARAMS = scenario.Registration()


def _model(trial: Trial) -> ModelCloud:
    name = trial.thing.asset.name
    if name not in _MODELS:
        _MODELS[name] = ModelCloud.of(trial.thing.asset, _PARAMS.model_points)
    return _MODELS[name]


ALLOWED: list[PoseHypothesis] = []
"""What the last registration by the twin says that the image allows."""


def ours(trial: Trial) -> tuple[Array, Array, Array | None]:
    """Register as the twin does; pose and covariance."""
    ALLOWED.clear()
    taken = segments(trial)
    frame = Frame.of(taken)
    model = _model(trial)
    found = nearby(model, frame, trial.R0, trial.p0, taken.points_W, taken.normals_W, _PARAMS)
    if found is None:
        return trial.R0, trial.p0, None
    ALLOWED.extend(found.hypotheses)
    result = found.registration
    return result.R, result.p, result.covariance


def tracked(trial: Trial) -> tuple[Array, Array, Array | None]:
    """Register as a tracked frame is: near the pose before, without a search."""
    ALLOWED.clear()
    taken = segments(trial)
    frame, model = Frame.of(taken), _model(trial)
    own = taken.points_W[claimed(model, taken, trial.R0, trial.p0, _PARAMS.reach, TRACKING.thin)]
    result = register(model, frame, trial.R0, trial.p0, _PARAMS, points_W=own)
    return result.R, result.p, result.covariance


def _clouds(trial: Trial) -> tuple[Any, Any]:
    """The image's points under the true mask, and the model's with normals."""
    taken = segments(trial)
    image = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(taken.points_W.copy()))
    image.colors = o3d.utility.Vector3dVector(taken.colours.copy())
    asset = trial.thing.asset
    model = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.array(asset.points_O)))
    model.normals = o3d.utility.Vector3dVector(np.array(asset.normals_O))
    model.colors = o3d.utility.Vector3dVector(np.array(asset.colours))
    return image, model


def _open3d(trial: Trial, kind: str) -> tuple[Array, Array, None]:
    """Move the image's points onto the model: three scales, Tukey's loss where there is one."""
    image, model = _clouds(trial)
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = trial.R0, trial.p0
    T = np.linalg.inv(X)
    reg = o3d.pipelines.registration
    for reach, steps in ((0.025, 30), (0.012, 30), (0.006, 30)):
        if kind == "plane":
            estimation = reg.TransformationEstimationPointToPlane(reg.TukeyLoss(reach / 2))
        elif kind == "colour":
            estimation = reg.TransformationEstimationForColoredICP()
        else:
            estimation = reg.TransformationEstimationPointToPoint()
        criteria = reg.ICPConvergenceCriteria(max_iteration=steps)
        try:
            go = reg.registration_colored_icp if kind == "colour" else reg.registration_icp
            T = go(image, model, reach, T, estimation, criteria).transformation
        except RuntimeError:
            break
    X = np.linalg.inv(T)
    return X[:3, :3], X[:3, 3], None


def _small_gicp(trial: Trial) -> tuple[Array, Array, None]:
    import small_gicp  # its own module: an extra

    image, model = _clouds(trial)
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = trial.R0, trial.p0
    T = np.linalg.inv(X)
    target, tree = small_gicp.preprocess_points(np.asarray(model.points), downsampling_resolution=0.002, num_threads=1)
    source, _ = small_gicp.preprocess_points(np.asarray(image.points), downsampling_resolution=0.002, num_threads=1)
    for reach in (0.025, 0.012, 0.006):
        T = small_gicp.align(target, source, tree, T, max_correspondence_distance=reach, num_threads=1).T_target_source
    X = np.linalg.inv(T)
    return X[:3, :3], X[:3, 3], None


METHODS = {
    "ours": ours,
    "ours tracked": tracked,
    "point to point": lambda trial: _open3d(trial, "point"),
    "point to plane": lambda trial: _open3d(trial, "plane"),
    "coloured": lambda trial: _open3d(trial, "colour"),
    "small_gicp": _small_gicp,
}
