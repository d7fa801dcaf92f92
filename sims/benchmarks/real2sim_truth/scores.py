"""Holds learned assets against the true objects of the world that they were learned in."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from display_truth.shown import Shown
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial import cKDTree

from real2sim_truth.run_figures import extras_of, final_positions, run_row
from twin_diagram.assets.building.inertia import solid_of
from twin_diagram.assets.building.measured import SIX
from twin_diagram.assets.building.surface import weld
from twin_diagram.assets.description import AssetSpec, read_spec
from twin_diagram.assets.mesh import parse_obj
from twin_diagram.logs.frames.transforms_folder import TransformsFolder
from twin_diagram.model import Model
from twin_diagram.runs.learning.following import register
from twin_diagram.runs.learning.gallery import TrueCloud
from twin_diagram.runs.learning.record import LIBRARY, OBJECTS, STATE
from twin_diagram.runs.learning.seen_map import TUNING as SEEN
from twin_diagram.runs.learning.seen_map import looked_at
from twin_diagram.runs.learning.shape_worker import FRAMES
from twin_diagram.scenario import Scenario
from twin_diagram.scenario.resources import resolve
from twin_diagram.station.sim.world_plant import build_world

Array = npt.NDArray[np.float64]
ALIKE = 0.3
"""Axes are compared where moments differ by this share."""


@dataclass(frozen=True)
class TrueObject:
    """One object of the world: its name, folder, X_WO, surface in O, and its inertia about its centre."""

    name: str
    folder: Path
    X_WO: Array
    corners: Array
    mass: float
    centre: Array
    inertia: Array


class TruthNotes:
    """Writes down where everything truly was as an object was held, beside the run's folder; see `cell.Observer`."""

    def __init__(self, out: Path) -> None:
        """`out`: the run's folder."""
        self._file = out.with_suffix(".truth.jsonl")

    def moment(self, name: str, positions: Array) -> None:
        """Add a line."""
        with self._file.open("a") as file:
            file.write(json.dumps({"object": name, "positions": positions.tolist()}) + "\n")

    def ticked(self, station: Any, context: Any, doing: Any) -> None:
        """Write nothing: contacts are counted by the run itself."""


def true_objects(scenario: Scenario, positions: Array) -> list[TrueObject]:
    """Return the world's objects at positions (nq,) of its plant."""
    builder = DiagramBuilder()
    world = build_world(builder, scenario)
    diagram = builder.Build()
    context = world.plant.GetMyContextFromRoot(diagram.CreateDefaultContext())
    world.plant.SetPositions(context, positions)
    found = []
    for name, index in world.objects.items():
        body = world.plant.get_body(index)
        bodies = world.plant.GetBodyIndices(body.model_instance())
        inertia = world.plant.CalcSpatialInertia(context, body.body_frame(), bodies)
        X_WO = world.plant.EvalBodyPoseInWorld(context, body).GetAsMatrix4()
        folder = resolve(scenario.world.objects[name].asset, scenario.packages)
        centre = np.asarray(inertia.get_com())
        about = inertia.Shift(centre).CalcRotationalInertia().CopyToFullMatrix3()
        found.append(
            TrueObject(name, folder, X_WO, triangles(folder / "visual.obj"), inertia.get_mass(), centre, about)
        )
    return found


def triangles(path: Path) -> Array:
    """Return the corners (F, 3, 3) of an OBJ file's triangles."""
    text = parse_obj(path)
    return np.asarray(text.v)[text.corners[:, :, 0]]


def sampled(corners: Array, count: int, seed: int = 0) -> tuple[Array, Array]:
    """Return points and outward normals (N, 3), evenly over triangles (F, 3, 3)."""
    rng = np.random.default_rng(seed)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    which = rng.choice(len(corners), count, p=area / area.sum())
    a, b = np.sort(rng.uniform(size=(2, count)), axis=0)
    share = np.stack([a, b - a, 1.0 - b], axis=1)
    return np.einsum("nk,nki->ni", share, corners[which]), cross[which] / area[which, None]


def off_surface(points: Array, surface: Array, normals: Array) -> Array:
    """Return how far points (M, 3) are from a surface that is sampled (N, 3) with its normals (N, 3).

    Across the plane of the nearest sample, so that the distance between samples does not count; beyond an edge to it.
    """
    distance, index = cKDTree(surface).query(points)
    across = np.abs(np.einsum("ni,ni->n", normals[index], points - surface[index]))
    spacing = float(np.median(cKDTree(surface).query(surface, k=2)[0][:, 1]))
    return np.where(distance < across + 3.0 * spacing, across, distance)


def registered(points: Array, normals: Array, true: TrueObject, X_WO: Array) -> Array:
    """Return the pose X_OA (4, 4) of a learned asset in the true object's O, by their surfaces.

    Args:
        points: (N, 3) of the asset's surface, in random order [m], with normals (N, 3).
        normals: of them.
        true: the object.
        X_WO: (4, 4) where the asset's O was last told to be, which is a first guess alone.
    """
    truth, outward = sampled(true.corners, 20000)
    X = np.linalg.solve(true.X_WO, X_WO)
    for reach, prior in ((0.03, (0.05, 0.5)), (0.012, (0.02, 0.2)), (0.006, (0.02, 0.2)), (0.004, (0.02, 0.2))):
        X, _ = register(truth, outward, points[:2500], normals[:2500], X, prior, reach)
    return X


def seen_share(true: TrueObject, X_OS: Array, frames: Path) -> float:
    """Return how much of the true surface the kept pictures show, of what some pose would show by rays past it.

    Args:
        true: the object.
        X_OS: (4, 4) of the frame S of the pictures' poses in the true object's O.
        frames: folder of the pictures, with masks.
    """
    folder = TransformsFolder(frames)
    whole = Shown.of_surface(true.corners, 0)
    points, normals = (whole.points - X_OS[:3, 3]) @ X_OS[:3, :3], whole.normals @ X_OS[:3, :3]
    count = looked_at(points, normals, [folder.read(k) for k in range(len(folder))])[0]
    seen, reachable = count >= SEEN.frames, whole.reachable()
    return float(seen[reachable].mean())


def pose_of(figures: dict[str, Any]) -> Array:
    """Return the pose X_OS (4, 4) of the pictures' frame in the asset's, by an object's figures."""
    X_OS = np.eye(4)
    X_OS[:3, :3], X_OS[:3, 3] = figures["R_OS"], figures["p_OS"]
    return X_OS


def scored(one: dict[str, Any], out: Path, true: TrueObject, X_WO: Array) -> dict[str, Any]:
    """Return how far a learned asset is off the true object.

    Args:
        one: its entry in the run's state.
        out: folder of the run.
        true: the object.
        X_WO: (4, 4) where the asset's O was last told to be, which is a first guess alone.
    """
    folder = out / LIBRARY / one["name"]
    learned = triangles(folder / "visual.obj")
    points, normals = sampled(learned, 20000)
    truth, outward = sampled(true.corners, 20000)
    X = registered(points, normals, true, X_WO)
    placed = points @ X[:3, :3].T + X[:3, 3]
    there, back = off_surface(placed, truth, outward), off_surface(truth, placed, normals @ X[:3, :3].T)
    spec = read_spec(folder)
    xx, yy, zz, xy, xz, yz = spec.inertia or [0.0] * 6
    inertia = X[:3, :3] @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ X[:3, :3].T
    even = solid_of(weld(learned)).inertia(spec.mass)
    want = np.linalg.eigvalsh(true.inertia)

    def worst(moments: Array) -> float:
        return float(np.abs(moments / want - 1.0).max())

    off = X[:3, :3].T @ (X[:3, 3] - true.centre)
    return {
        "object": one["name"],
        "true": true.name,
        "axis_deg": worst_axis(true.inertia, inertia),
        "held": intervals_hold(spec, true, off, X[:3, :3].T @ true.inertia @ X[:3, :3]),
        "to_truth_mm": 1e3 * float(there.mean()),
        "to_mesh_mm": 1e3 * float(back.mean()),
        "within_3mm": float((back < 3e-3).mean()),
        "seen": seen_share(true, X @ pose_of(one["figures"]), out / OBJECTS / one["name"] / FRAMES),
        "unseen": spec.unseen,
        "true_mass": true.mass,
        "mass": spec.mass / true.mass - 1.0,
        "centre_mm": 1e3 * float(np.linalg.norm(X[:3, 3] - true.centre)),
        "moments": worst(np.linalg.eigvalsh(inertia)),
        "even_moments": worst(np.linalg.eigvalsh(even)),
        "by": spec.inertial_by,
        "mass_z": None if not spec.mass_std else (spec.mass - true.mass) / spec.mass_std,
    }


def worst_axis(want: Array, found: Array) -> float | None:
    """Return by how much the worst principal axis is off [deg], of those whose moment no other is near to; None: none.

    Args:
        want: (3, 3) true inertia.
        found: (3, 3) that was found.
    """
    moments, axes = np.linalg.eigh(want)
    angles = np.degrees(np.arccos(np.clip(np.abs(np.sum(axes * np.linalg.eigh(found)[1], axis=0)), 0.0, 1.0)))
    gap = np.diff(moments) / moments[:-1] >= ALIKE
    return max(
        (float(angle) for angle, apart in zip(angles, (gap[0], gap.all(), gap[1]), strict=True) if apart), default=None
    )


def intervals_hold(spec: AssetSpec, true: TrueObject, off: Array, inertia: Array) -> list[bool] | None:
    """Return whether the told 95 % intervals of mass, centre (3) and inertia (6) hold the truth; None: none are told.

    Args:
        spec: of the asset.
        true: the object.
        off: (3,) from the true centre to the asset's, along the asset's axes [m].
        inertia: (3, 3) true one along them.
    """
    if not (spec.mass_std and spec.centre_std and spec.inertia_std and spec.inertia):
        return None
    errors = [spec.mass - true.mass, *off, *(own - inertia[at] for own, at in zip(spec.inertia, SIX, strict=True))]
    stds = [spec.mass_std, *spec.centre_std, *spec.inertia_std]
    return [bool(abs(error) <= 1.96 * std) for error, std in zip(errors, stds, strict=True)]


@dataclass(frozen=True)
class Matched:
    """A learned object, and the true one that it is; None: it was not finished, or lost on its way to the other bin.

    Attributes:
        one: its entry in the run's state.
        true: the object that it is.
        X_WO: (4, 4) where its O was told to be when the true object was there.
    """

    one: dict[str, Any]
    true: TrueObject | None = None
    X_WO: Array | None = None


def matched(scenario: Scenario, out: Path) -> list[Matched]:
    """Return each object of a run beside the true one that was in the hand."""
    with np.load(out / STATE, allow_pickle=False) as data:
        told = json.loads(str(data["told"]))
    lines = out.with_suffix(".truth.jsonl").read_text().splitlines() if out.with_suffix(".truth.jsonl").exists() else []
    truth = {line["object"]: np.array(line["positions"]) for line in map(json.loads, lines)}
    found: list[Matched] = []
    for one in told["learned"]:
        figures, away = one["figures"], bool(one["standing"])
        if one["state"] != "finished" or not away or "X_WS" not in figures or one["name"] not in truth:
            found.append(Matched(one))
            continue
        X_WO = np.array(figures["X_WS"]) @ np.linalg.inv(pose_of(figures))
        every = true_objects(scenario, truth[one["name"]])
        true = min(every, key=lambda t: float(np.linalg.norm(t.X_WO[:3, 3] - X_WO[:3, 3])))
        found.append(Matched(one, true, X_WO))
    return found


def score_run(scenario: Scenario, out: Path) -> list[dict[str, Any]]:
    """Return the scores of each finished object of a run, and a row for each other one."""
    rows: list[dict[str, Any]] = []
    model = Model.load(scenario.twin.arm, dict(scenario.packages), torque_side=scenario.twin.driver.torque_side)
    for each in matched(scenario, out):
        one = each.one
        own = extras_of(model, out, one["name"])
        if each.true is None or each.X_WO is None:
            rows.append(
                own | {"object": one["name"], "state": one["state"], "why": one["why"] or one.get("no_asset", "")}
            )
        else:
            scores = scored(one, out, each.true, each.X_WO)
            loaded = scenario.world.objects[each.true.name].load_at is not None
            rows.append(own | {"state": "finished", "why": one["why"], "loaded": loaded, **scores})
    return rows


def true_clouds(scenario: Scenario, out: Path) -> dict[str, TrueCloud]:
    """Return the true object of each finished one, in the learned asset's O, grey, with its true figures."""
    found = {}
    for each in matched(scenario, out):
        if each.true is None or each.X_WO is None:
            continue
        name = each.one["name"]
        points, normals = sampled(triangles(out / LIBRARY / name / "visual.obj"), 20000)
        X_OA = registered(points, normals, each.true, each.X_WO)
        truth, outward = sampled(each.true.corners, 3000)
        grey = np.full((len(truth), 3), 0.7)
        dense, across = sampled(each.true.corners, 20000)
        found[name] = TrueCloud(
            (truth - X_OA[:3, 3]) @ X_OA[:3, :3],
            grey,
            outward @ X_OA[:3, :3],
            each.true.mass,
            (each.true.centre - X_OA[:3, 3]) @ X_OA[:3, :3],
            np.linalg.eigvalsh(each.true.inertia),
            float(off_surface(points @ X_OA[:3, :3].T + X_OA[:3, 3], dense, across).mean()),
        )
    return found


def left_behind(scenario: Scenario, out: Path) -> dict[str, Any]:
    """Return where a run left its objects; see `run_row`."""
    return run_row(scenario, out, {t.name: t.X_WO[:3, 3] for t in true_objects(scenario, final_positions(out))})
