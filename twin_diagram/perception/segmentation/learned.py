"""The door for learned segmenters: any function from images to an id image, and networks in ONNX files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from twin_diagram import scenario
from twin_diagram.errors import TwinError
from twin_diagram.perception.pinhole import ColourImage, DepthImage
from twin_diagram.perception.segmentation.segmentation import (
    Apart,
    Grid,
    Near,
    clean,
    gathered,
    level,
    standing_out,
    support_plane,
)
from twin_diagram.perception.segmentation.segments import TUNING as SEGMENTS
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.signals.arrays import Array

Ids = npt.NDArray[np.int32]
Confidence = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Tuning:
    """Constants of what a segmenter is believed, by definition of its confidence."""

    least_confidence: float = 0.5
    """A pixel whose id is less sure than this is nobody's [0 to 1]."""


TUNING = Tuning()


class SegmenterError(TwinError):
    """A segmenter that cannot be loaded, or whose answer is no id image."""


class Segmenter(Protocol):
    """What a learned segmenter has to be: a function of one capture."""

    def __call__(
        self, rgb: ColourImage, depth: DepthImage, K: Array, X_WC: Array, prior_ids: Ids
    ) -> tuple[npt.ArrayLike, npt.ArrayLike]:
        """Tell which thing each pixel shows.

        Args:
            rgb: (H, W, 3)
            depth: (H, W) [m], 0 where there is none.
            K: (3, 3) the camera's matrix [pixel].
            X_WC: (4, 4) its pose in W.
            prior_ids: (H, W) the ids that are expected, from the last image or from known poses; 0: nothing is.

        Returns:
            id image (H, W), integers, 0: no thing; confidence [0 to 1], (H, W) or one number.
        """


def segment_with(
    segmenter: Segmenter,
    rgb: ColourImage,
    depth: DepthImage,
    time: float,
    grid: Grid,
    params: scenario.Perception,
    near_robot: Near | None = None,
    prior_ids: Ids | None = None,
) -> Segments:
    """Take an image apart by a segmenter's ids in the place of hollow edges; table and robot are found as ever.

    Args:
        segmenter: see `Segmenter`.
        rgb: (H, W, 3)
        depth: (H, W) [m], 0 (or not finite) where there is none.
        time: capture time [s].
        grid: of the camera, with the stride of `params`.
        params: tuning.
        near_robot: (points_W (N, 3), margin) to a mask (N,) of the robot's points.
        prior_ids: (H, W) ids that are expected; None: nothing is.

    Returns:
        Segments in the order of their ids.

    Raises:
        SegmenterError: the segmenter's answer is no id image of this size with a confidence.
    """
    depth = clean(depth)
    prior = np.zeros(depth.shape, dtype=np.int32) if prior_ids is None else prior_ids
    K = np.diag([grid.camera.fx, grid.camera.fy, 1.0])
    K[:2, 2] = grid.camera.centre
    ids, confidence = checked(*segmenter(rgb, depth, K, grid.camera.X_WC.GetAsMatrix4(), prior), depth.shape)
    part = (slice(None, None, grid.stride), slice(None, None, grid.stride))
    sure = np.where(confidence[part] >= TUNING.least_confidence, ids[part], 0)
    coarse = np.ascontiguousarray(depth[part])
    apart = apart_by(sure, coarse, grid, params, near_robot)
    return gathered(rgb, depth, time, grid, apart, params.table_height)


def apart_by(ids: Ids, depth: DepthImage, grid: Grid, params: scenario.Perception, near_robot: Near | None) -> Apart:
    """Return the labels that ids on the grid make, of what stands out of the table and is not the robot.

    Args:
        ids: (h, w), 0: no thing.
        depth: (h, w) [m], 0 where there is none.
        grid: of the camera.
        params: tuning.
        near_robot: as of `segment_with`.
    """
    table = support_plane(depth, grid, params)
    standing = standing_out(depth, grid, table or level(params.table_height), params)
    label_image = np.full(depth.shape, SEGMENTS.background, dtype=np.int16)
    if near_robot is not None:
        row, column = np.nonzero(standing)
        points = grid.camera.p_WC + depth[row, column][:, None].astype(float) * grid.rays[row, column]
        robot = near_robot(points, params.robot_clearance)
        label_image[row[robot], column[robot]] = SEGMENTS.robot
        standing[row[robot], column[robot]] = False
    count = 0
    for one in np.unique(ids[standing & (ids > 0)]):
        own = standing & (ids == one)
        if np.count_nonzero(own) >= params.smallest:
            label_image[own] = count
            count += 1
    label_image[depth == 0] = SEGMENTS.no_depth
    return Apart(label_image, count, table)


def checked(ids: npt.ArrayLike, confidence: npt.ArrayLike, shape: tuple[int, ...]) -> tuple[Ids, Confidence]:
    """Return a segmenter's answer as an id image and confidences of the depth image's shape.

    Raises:
        SegmenterError: wrong size, ids that are no integers or too large, confidences outside 0 to 1.
    """
    whole = np.asarray(ids)
    if whole.shape != shape:
        raise SegmenterError(f"a segmenter gave an id image of shape {whole.shape}, not {shape}: one id per pixel")
    if not np.issubdtype(whole.dtype, np.integer):
        raise SegmenterError(f"a segmenter gave ids of type {whole.dtype}: integers are needed, 0 for no thing")
    if whole.max(initial=0) > np.iinfo(np.int32).max:
        raise SegmenterError(f"a segmenter gave the id {whole.max()}: they count up to {np.iinfo(np.int32).max}")
    sure = np.asarray(confidence, dtype=np.float32)
    if sure.shape not in ((), shape):
        raise SegmenterError(f"a segmenter gave confidences of shape {sure.shape}: one number, or {shape}")
    if not ((sure >= 0) & (sure <= 1)).all():
        raise SegmenterError(f"a segmenter gave confidences from {sure.min()} to {sure.max()}: 0 to 1 is needed")
    return whole.astype(np.int32), np.broadcast_to(sure, shape)


class OnnxSegmenter:
    """A network in an ONNX file as a `Segmenter`, run by ONNX Runtime on one thread.

    Its inputs are any of `rgb` (1, 3, H, W) float32 in 0 to 1, `depth` (1, 1, H, W) float32 [m], `K` (3, 3) and `X_WC`
    (4, 4) float32, `prior_ids` (1, 1, H, W) int32; its outputs `id_image` (H, W), with leading ones if it likes, and,
    if it has one, `confidence`.

    Args:
        file: the network.
        providers: of ONNX Runtime, the best first; CPU alone if not told.

    Raises:
        SegmenterError: no such file, ONNX Runtime is missing or refuses it, inputs or outputs of other names.
    """

    def __init__(self, file: str | Path, providers: Sequence[str] = ("CPUExecutionProvider",)) -> None:
        if not Path(file).is_file():
            raise SegmenterError(f"{file}: no such file")
        try:
            import onnxruntime
        except ImportError as error:
            raise SegmenterError(
                "ONNX networks need ONNX Runtime: pip install 'twin-diagram[learned]' (onnxruntime is missing)"
            ) from error
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        try:
            self._session = onnxruntime.InferenceSession(str(file), options, providers=list(providers))
        except Exception as error:  # its exceptions have no common ancestor but this one
            raise SegmenterError(f"{file}: ONNX Runtime cannot load it ({str(error).splitlines()[0]})") from error
        self._inputs = [one.name for one in self._session.get_inputs()]
        outputs = [one.name for one in self._session.get_outputs()]
        known = ("rgb", "depth", "K", "X_WC", "prior_ids")
        strange = [name for name in self._inputs if name not in known]
        if strange:
            raise SegmenterError(f"{file}: input {strange[0]!r} is none of {', '.join(known)}")
        if "id_image" not in outputs:
            raise SegmenterError(f"{file}: it has no output 'id_image', only {', '.join(outputs)}")
        self._outputs = [name for name in ("id_image", "confidence") if name in outputs]

    def __call__(
        self, rgb: ColourImage, depth: DepthImage, K: Array, X_WC: Array, prior_ids: Ids
    ) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        """Run the network; see `Segmenter`."""
        given = {
            "rgb": np.ascontiguousarray(rgb.transpose(2, 0, 1)[None], dtype=np.float32) / np.float32(255.0),
            "depth": np.asarray(depth, dtype=np.float32)[None, None],
            "K": np.asarray(K, dtype=np.float32),
            "X_WC": np.asarray(X_WC, dtype=np.float32),
            "prior_ids": np.asarray(prior_ids, dtype=np.int32)[None, None],
        }
        try:
            found = self._session.run(self._outputs, {name: given[name] for name in self._inputs})
        except Exception as error:  # as above
            raise SegmenterError(f"the network failed ({str(error).splitlines()[0]})") from error
        ids, *more = (_without_leading_ones(np.asarray(one)) for one in found)
        return ids, more[0] if more else np.ones(ids.shape, dtype=np.float32)


def _without_leading_ones(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    while array.ndim > 2 and array.shape[0] == 1:
        array = array[0]
    return array[0] if array.shape == (1,) else array
