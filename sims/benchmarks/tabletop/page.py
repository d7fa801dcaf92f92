"""A page of pictures: what a thing is by the published labels, and what was made of it."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from tabletop.kinect import Scene
from twin_diagram.perception.segmentation.segments import Segments


def write_page(out: Path, failures: Sequence[tuple[Scene, Segments, int, float]]) -> Path:
    """Write `page.html` with one row of pictures a failure, and return its path."""
    rows = [
        f"<h2>{scene.name}: thing {thing}, IoU {score:.2f}</h2>\n"
        f'<img alt="colours, published label, ours" src="data:image/png;base64,{_picture(scene, found, thing)}">'
        for scene, found, thing, score in failures
    ]
    head = "<!doctype html><meta charset=utf-8><title>Kinect tabletops</title><h1>Colours, published label, ours</h1>"
    out.mkdir(parents=True, exist_ok=True)
    file = out / "page.html"
    file.write_text("\n".join([head, *(rows or ["<p>No failures.</p>"])]), encoding="utf-8")
    return file


def _picture(scene: Scene, found: Segments, thing: int) -> str:
    step = found.stride
    colours = scene.rgb[::step, ::step]
    published = np.where((scene.truth == thing)[::step, ::step, None], np.uint8([255, 80, 0]), colours // 3)
    ours = colours // 3
    paints = np.random.default_rng(1).integers(80, 256, (max(found.count, 1), 3)).astype(np.uint8)
    labelled = found.label_image >= 0
    ours[labelled] = paints[found.label_image[labelled]]
    row, column = np.nonzero(scene.truth[::step, ::step] == thing)
    part = (
        slice(max(0, row.min() - 30), row.max() + 30),
        slice(max(0, column.min() - 30), column.max() + 30),
    )
    whole: npt.NDArray[np.uint8] = np.hstack([one[part] for one in (colours, published.astype(np.uint8), ours)])
    whole = cv2.resize(whole, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST)
    return base64.b64encode(cv2.imencode(".png", whole[..., ::-1])[1].tobytes()).decode()
