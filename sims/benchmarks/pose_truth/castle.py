"""ViSP's simulated castle as an outsider would have it: a mesh, a BOP folder of frames, the pose in the first.

Its depth camera stands 5 cm beside that of the colours (`SOURCE.md` there); the tracker that it was made for keeps
every frame inside 2 mm and 0.4°.
"""

from __future__ import annotations

import csv
import json
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
K = [700.0, 0.0, 320.0, 0.0, 700.0, 240.0, 0.0, 0.0, 1.0]
BESIDE = [50.0, 0.0, 0.0]
"""Where the depth camera is in the frame of that of the colours [mm]."""
DEPTH_UNIT = 0.030518
"""[mm]"""
PERIOD = 0.04
"""Between frames [s]; not told by the source."""


@dataclass(frozen=True)
class Score:
    """Errors of each frame that has a pose, of the mesh's frame in the camera's: (n,) [mm] and [deg]."""

    frames: list[int]
    millimetres: Array
    degrees: Array


def write_mesh(source: Path, obj: Path) -> None:
    """Write the polygons of the VRML scene as triangles."""
    text = re.sub(r"#(?! Object).*", "", (source / "Models" / "chateau.wrl").read_text())
    corners, faces = [], []
    for shape in text.split("# Object")[1:]:
        if "IndexedFaceSet" not in shape:
            continue
        found = re.search(r"point \[(.*?)\]", shape, re.S), re.search(r"coordIndex \[(.*?)\]", shape, re.S)
        assert found[0] is not None and found[1] is not None
        points = [[float(x) for x in one.split()] for one in found[0].group(1).split(",") if one.strip()]
        for polygon in found[1].group(1).replace(",", " ").split("-1"):
            at = [int(x) + len(corners) + 1 for x in polygon.split()]
            faces += [(at[0], at[k], at[k + 1]) for k in range(1, len(at) - 1)]
        corners += points
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in corners] + [f"f {a} {b} {c}" for a, b, c in faces]
    obj.write_text("\n".join(lines) + "\n")


def pose(source: Path, frame: int) -> Array:
    """Return the true X_CM (4, 4) of a frame, from 1."""
    return np.loadtxt(source / "CameraPose" / f"Camera_{frame:03d}.txt")


def write_frames(source: Path, folder: Path, count: int = 40) -> None:
    """Write the first frames as a BOP scene without extrinsics."""
    for kind, stem in (("rgb", "Images/Image"), ("depth", "Depth/Depth")):
        (folder / kind).mkdir(parents=True)
        for k in range(1, count + 1):
            shutil.copyfile(source / f"{stem}_{k:04d}.png", folder / kind / f"{k:06d}.png")
    entry = {"cam_K": K, "depth_scale": DEPTH_UNIT}
    (folder / "scene_camera.json").write_text(json.dumps({str(k): entry for k in range(1, count + 1)}))
    (folder / "times.json").write_text(json.dumps([PERIOD * k for k in range(count)]))
    own = {"cam_K": K, "R_CD": np.eye(3).ravel().tolist(), "t_CD": BESIDE}
    (folder / "camera_extra.json").write_text(json.dumps({"depth_camera": own}))


def write_first(source: Path, path: Path, origin: Array) -> None:
    """Write the first frame's pose as BOP results; `origin` (3,) is the asset's O in the mesh [m]."""
    X = pose(source, 1)
    R, t = (
        " ".join(f"{x:.9g}" for x in values) for values in (X[:3, :3].ravel(), 1000 * (X[:3, :3] @ origin + X[:3, 3]))
    )
    path.write_text(f"scene_id,im_id,obj_id,score,R,t,time\n0,1,1,1,{R},{t},0\n")


def score(source: Path, results: Path, origin: Array) -> Score:
    """Compare BOP results with the truth."""
    frames, apart, turned = [], [], []
    for row in csv.DictReader(results.read_text().splitlines()):
        X, R = pose(source, int(row["im_id"])), np.array(row["R"].split(), dtype=float).reshape(3, 3)
        p = np.array(row["t"].split(), dtype=float) / 1000 - R @ origin
        frames.append(int(row["im_id"]))
        apart.append(1000 * float(np.linalg.norm(p - X[:3, 3])))
        turned.append(float(np.degrees(np.arccos(np.clip((np.trace(R.T @ X[:3, :3]) - 1) / 2, -1, 1)))))
    return Score(frames, np.array(apart), np.array(turned))
