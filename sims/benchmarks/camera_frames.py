"""Rendered frames of the simulated RGB-D camera: how well an object's pose is found, and how the object looked then.

The world is that of `models/scenarios/tabletop.yaml`, seen by its own camera with its own defects, under lights from
dusk to glare, with a box held in the way as often as not. What is found goes through segmentation and registration as
in the twin. Needs EGL.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    DepthRange,
    DepthRenderCamera,
    LightParameter,
    MakeRenderEngineVtk,
    RenderCameraCore,
    RenderEngineVtkParams,
)
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.systems.framework import DiagramBuilder

from twin_diagram.assets import Asset
from twin_diagram.native import require_egl
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.registration import claimed, register
from twin_diagram.perception.registration.rotation import exp, log
from twin_diagram.perception.registration.where_expected import MOVING, believable
from twin_diagram.perception.registration.where_expected import TUNING as TRACKING
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.scenario.file import load_scenario
from twin_diagram.scenario.resources import models_dir
from twin_diagram.station.sim.camera import camera_info
from twin_diagram.station.sim.camera_defects import spoil_colour, spoil_depth
from twin_diagram.station.sim.render_settings import lights
from twin_diagram.station.sim.world_plant import build_appearance, build_world

Array = npt.NDArray[np.float64]
LIGHTS: Final = (0.06, 0.15, 0.4, 1.0, 1.8, 2.8)
"""Times the scenario's own lights."""
TARGETS: Final = ("sugar_box", "cracker_box", "gelatin_box")
"""Objects without symmetry, so that each rotation error counts."""
SCREEN: Final = "mover"
"""What is held in the way."""
AWAY: Final = np.array([0.0, 0.0, -3.0])


@dataclass(frozen=True)
class Seen:
    """One pose found.

    Attributes:
        covered: share of the object's near side that something hides, from the image.
        brightness: mean of the object's pixels, 0 to 1.
        turn, shift: found less true, rotation vector and position in W (3,) [rad], [m].
    """

    covered: float
    brightness: float
    turn: Array
    shift: Array


class Studio:
    """The world and its camera, at any poses of its objects and under any of the lights."""

    def __init__(self) -> None:
        """Builds it once."""
        require_egl()
        plan = load_scenario(models_dir() / "scenarios" / "tabletop.yaml")
        for name in plan.world.objects:
            plan.world.objects[name].path = []
        assert plan.twin.camera is not None
        camera = plan.twin.camera
        builder = DiagramBuilder()
        shown = build_appearance(builder, plan)
        scene_graph = shown.scene_graph
        for k, times in enumerate(LIGHTS):
            dimmed = [_times(light, times) for light in lights()]
            scene_graph.AddRenderer(f"light{k}", MakeRenderEngineVtk(RenderEngineVtkParams(lights=dimmed)))
        builder.ExportInput(shown.poses.get_input_port(), "positions")
        builder.ExportOutput(scene_graph.get_query_output_port(), "query")
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()
        self._frame = scene_graph.world_frame_id()
        self._world = build_world(DiagramBuilder(), plan)
        self._plan, self._camera = plan, camera
        self._pinhole = Pinhole.from_scenario(camera)
        self._grid = Grid.of(self._pinhole, plan.twin.perception.stride)
        self._models = {
            name: ModelCloud.of(Asset.load(models_dir() / "objects" / name), plan.twin.registration.model_points)
            for name in TARGETS
        }

    def frames(self, seed: int, count: int) -> Iterator[Seen]:
        """Poses that registration finds and believes, under all lights.

        Args:
            seed: of poses, noise and what is in the way.
            count: of arrangements; each is seen under every light.
        """
        rng = np.random.default_rng([seed, 51])
        plant, bodies = self._world.plant, self._world.objects
        for _ in range(count):
            name = TARGETS[int(rng.integers(len(TARGETS)))]
            model = self._models[name]
            X_WO = RigidTransform(
                RotationMatrix(RollPitchYaw(0.0, 0.0, rng.uniform(-np.pi, np.pi))),
                [rng.uniform(0.4, 0.75), rng.uniform(-0.35, 0.35), model.asset.size[2] / 2],
            )
            poses = {other: RigidTransform(AWAY) for other in self._plan.world.objects} | {name: X_WO}
            if rng.random() < 0.7:
                poses[SCREEN] = self._in_the_way(X_WO, model.radius, rng)
            plant_context = plant.CreateDefaultContext()
            for other, X in poses.items():
                plant.SetFloatingBaseBodyPoseInWorldFrame(plant_context, plant.get_body(bodies[other]), X)
            self._diagram.GetInputPort("positions").FixValue(self._context, plant.GetPositions(plant_context))
            start = (
                exp(rng.normal(size=(1, 3)) * 0.04)[0] @ X_WO.rotation().matrix(),
                X_WO.translation() + 0.006 * rng.normal(size=3),
            )
            for k in range(len(LIGHTS)):
                seen = self._look(k, model, X_WO, start, rng)
                if seen is not None:
                    yield seen

    def _in_the_way(self, X_WO: RigidTransform, radius: float, rng: np.random.Generator) -> RigidTransform:
        p_WO, p_WC = X_WO.translation(), self._pinhole.p_WC
        between = p_WO + rng.uniform(0.25, 0.5) * (p_WC - p_WO)
        ray = (p_WC - p_WO) / np.linalg.norm(p_WC - p_WO)
        aside = np.cross(ray, [0.0, 0.0, 1.0])
        aside /= np.linalg.norm(aside)
        angle, reach = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.3, 1.5) * radius
        offset = reach * (np.cos(angle) * aside + np.sin(angle) * np.cross(ray, aside))
        return RigidTransform(RotationMatrix(RollPitchYaw(*rng.uniform(-np.pi, np.pi, 3))), between + offset)

    def _look(
        self, light: int, model: ModelCloud, X_WO: RigidTransform, start: tuple[Array, Array], rng: np.random.Generator
    ) -> Seen | None:
        colour, depth = self._render(light, rng)
        plan = self._plan
        segments = segment(colour, depth, 0.0, self._grid, plan.twin.perception)
        thin = segments.points_W[claimed(model, segments, *start, plan.twin.registration.reach, TRACKING.thin)]
        found = register(model, Frame.of(segments), *start, plan.twin.registration, prior=MOVING, points_W=thin)
        if not believable(found, plan.twin.registration, *start):
            return None
        own = claimed(model, segments, found.R, found.p, 0.006)
        if not own.size:
            return None
        return Seen(
            covered=1.0 - found.visible_share,
            brightness=float(segments.colours[own].mean()),
            turn=log(found.R @ X_WO.rotation().matrix().T),
            shift=found.p - X_WO.translation(),
        )

    def _render(self, light: int, rng: np.random.Generator) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
        camera, defects = self._camera, self._plan.world.camera_defects
        near, far = camera.depth_range
        core = RenderCameraCore(f"light{light}", camera_info(camera), ClippingRange(0.05, 20.0), RigidTransform())
        query = self._diagram.GetOutputPort("query").Eval(self._context)
        X_WC = self._pinhole.X_WC
        colour = query.RenderColorImage(ColorRenderCamera(core, False), self._frame, X_WC).data
        depth = query.RenderDepthImage(DepthRenderCamera(core, DepthRange(near, far)), self._frame, X_WC).data[..., 0]
        noise = np.rint(defects.colour_noise * rng.standard_normal(colour.size, dtype=np.float32)).astype(np.int16)
        return spoil_colour(colour, noise, 0)[..., :3], spoil_depth(depth, defects, camera.depth_range, rng)


def _times(light: LightParameter, factor: float) -> LightParameter:
    return LightParameter(
        type=light.type,
        frame=light.frame,
        direction=light.direction,
        color=light.color,
        intensity=factor * light.intensity,
    )
