"""Ids from outside become segments; a tiny network made here goes through ONNX Runtime; bad answers are refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tests.perception.segmentation.test_segmentation_laws import DOWN, PARAMS, image
from twin_diagram.perception.segmentation.learned import OnnxSegmenter, SegmenterError, segment_with
from twin_diagram.perception.segmentation.segmentation import Grid

GRID = Grid.of(DOWN, 2)


def ids_of(rgb: Any = None, depth: Any = None, *rest: Any) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float32]]:
    """The two blocks of `image`, and some of the table about them; the right half of the first is another's."""
    ids = np.zeros((44, 60), dtype=np.int64)
    ids[8:22, 8:16], ids[8:22, 16:22], ids[28:38, 38:50] = 7, 3, 12
    return ids, np.ones((44, 60), dtype=np.float32)


def test_ids_become_segments_of_what_stands() -> None:
    rgb, depth = image()
    found = segment_with(ids_of, rgb, depth, 2.5, GRID, PARAMS)
    label = np.full((22, 30), -1)
    label[5:10, 5:8], label[5:10, 8:10], label[15:18, 20:24] = 1, 0, 2  # in the order of their ids
    label[7, 7] = label[12, 12] = -3
    np.testing.assert_array_equal(found.label_image, label)
    assert found.count == 3 and found.time == 2.5
    row, column = np.nonzero(label >= 0)
    np.testing.assert_array_equal(found.labels, label[row, column])


def test_the_segmenter_is_given_the_capture() -> None:
    rgb, depth = image()
    given: list[Any] = []

    def asked(*args: Any) -> Any:
        given[:] = args
        return ids_of()

    segment_with(asked, rgb, depth, 0.0, GRID, PARAMS)
    np.testing.assert_array_equal(given[0], rgb)
    assert given[1][14, 14] == 0.0 and given[1][0, 0] == 1.0 and given[4].shape == (44, 60) and not given[4].any()
    np.testing.assert_allclose(given[2], [[200.0, 0.0, 29.5], [0.0, 200.0, 21.5], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(given[3], [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 1], [0, 0, 0, 1]])
    prior = ids_of()[0].astype(np.int32)
    segment_with(asked, rgb, depth, 0.0, GRID, PARAMS, prior_ids=prior)
    np.testing.assert_array_equal(given[4], prior)


def test_doubtful_pixels_small_things_and_the_robot_are_left_out() -> None:
    rgb, depth = image()
    sure = np.full((44, 60), 0.5, dtype=np.float32)
    sure[:, 16:22] = 0.49
    found = segment_with(lambda *_: (ids_of()[0], sure), rgb, depth, 0.0, GRID, PARAMS)
    assert found.count == 2 and (found.label_image[5:10, 8:10] == -1).all()
    small = PARAMS.__class__(**{**vars(PARAMS), "smallest": 13})
    assert segment_with(ids_of, rgb, depth, 0.0, GRID, small).count == 1
    margins: list[float] = []

    def near(points: Any, margin: float) -> Any:
        margins.append(margin)
        return points[:, 0] > 0.0

    found = segment_with(ids_of, rgb, depth, 0.0, GRID, PARAMS, near)
    assert found.count == 2 and (found.label_image[15:18, 20:24] == -2).all() and margins == [PARAMS.robot_clearance]


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ((np.zeros((22, 30), int), 1.0), "shape"),
        ((np.zeros((44, 60)), 1.0), "integers"),
        ((np.full((44, 60), 2**31, np.uint32), 1.0), "2147483648"),  # a hash: it had become -2147483648, no thing
        ((np.zeros((44, 60), int), 1.5), "0 to 1"),
        ((np.zeros((44, 60), int), np.nan), "0 to 1"),
        ((np.zeros((44, 60), int), np.zeros((3, 2))), "confidences of shape"),
    ],
)
def test_what_is_no_id_image_is_refused(answer: Any, said: str) -> None:
    rgb, depth = image()
    with pytest.raises(SegmenterError, match=said):
        segment_with(lambda *_: answer, rgb, depth, 0.0, GRID, PARAMS)


def network(file: Path, name: str = "depth", output: str = "id_image") -> Path:
    """Things are what is nearer than 0.97 m, in two halves: 1 left of the middle column, 2 right of it."""
    onnx = pytest.importorskip("onnx")
    helper, kinds = onnx.helper, onnx.TensorProto
    side = np.where(np.arange(60) < 30, 1, 2).astype(np.int32).reshape(1, 1, 1, 60)
    nodes = [
        helper.make_node("Less", [name, "limit"], ["near"]),
        helper.make_node("Greater", [name, "none"], ["there"]),
        helper.make_node("And", ["near", "there"], ["thing"]),
        helper.make_node("Cast", ["thing"], ["mask"], to=kinds.INT32),
        helper.make_node("Mul", ["mask", "side"], [output]),
        helper.make_node("Cast", ["thing"], ["sure"], to=kinds.FLOAT),
        helper.make_node("Mul", ["sure", "share"], ["confidence"]),
    ]
    constants = [
        onnx.numpy_helper.from_array(np.float32(0.97), "limit"),
        onnx.numpy_helper.from_array(np.float32(0.0), "none"),
        onnx.numpy_helper.from_array(np.float32(0.75), "share"),
        onnx.numpy_helper.from_array(side, "side"),
    ]
    graph = helper.make_graph(
        nodes,
        "halves",
        [helper.make_tensor_value_info(name, kinds.FLOAT, [1, 1, 44, 60])],
        [
            helper.make_tensor_value_info(output, kinds.INT32, [1, 1, 44, 60]),
            helper.make_tensor_value_info("confidence", kinds.FLOAT, [1, 1, 44, 60]),
        ],
        constants,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, str(file))
    return file


def test_a_network_takes_an_image_apart(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    rgb, depth = image()
    segmenter = OnnxSegmenter(network(tmp_path / "halves.onnx"))
    ids, sure = segmenter(rgb, np.nan_to_num(depth), np.eye(3), np.eye(4), np.zeros((44, 60), np.int32))
    assert ids.shape == sure.shape == (44, 60) and set(np.unique(ids)) == {0, 1, 2} and sure.max() == 0.75
    found = segment_with(segmenter, rgb, depth, 0.0, GRID, PARAMS)
    assert found.count == 2
    assert (found.label_image[15:18, 20:24] == 1).all() and found.label_image[5, 5] == 0


def test_files_that_are_no_such_network_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SegmenterError, match="no such file"):
        OnnxSegmenter(tmp_path / "none.onnx")
    pytest.importorskip("onnxruntime")
    (tmp_path / "text.onnx").write_text("no network")
    with pytest.raises(SegmenterError, match="cannot load"):
        OnnxSegmenter(tmp_path / "text.onnx")
    with pytest.raises(SegmenterError, match="'range' is none of rgb"):
        OnnxSegmenter(network(tmp_path / "a.onnx", name="range"))
    with pytest.raises(SegmenterError, match="no output 'id_image', only mask_image"):
        OnnxSegmenter(network(tmp_path / "b.onnx", output="mask_image"))
    segmenter = OnnxSegmenter(network(tmp_path / "c.onnx"))
    with pytest.raises(SegmenterError, match="the network failed"):
        segmenter(
            np.zeros((2, 2, 3), np.uint8),
            np.zeros((2, 2), np.float32),
            np.eye(3),
            np.eye(4),
            np.zeros((2, 2), np.int32),
        )


def test_without_the_runtime_it_is_said_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "some.onnx").write_text("")
    monkeypatch.setitem(__import__("sys").modules, "onnxruntime", None)
    with pytest.raises(SegmenterError, match="learned"):
        OnnxSegmenter(tmp_path / "some.onnx")
