"""The simulated RGB-D camera: rendering, its rate and latency."""

from __future__ import annotations

import numpy as np
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    DepthRange,
    DepthRenderCamera,
    LightParameter,
    MakeRenderEngineVtk,
    RenderCameraCore,
    RenderEngineVtkParams,
    Rgba,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraInfo, RgbdSensorAsync

from twin_diagram.errors import ScenarioError
from twin_diagram.native import require_egl
from twin_diagram.scenario import Camera, CameraDefects
from twin_diagram.station.camera_defects import CameraDefectsSystem

_RENDERER = "camera"


def camera_info(camera: Camera) -> CameraInfo:
    """Drake's intrinsics of a camera: square pixels, the principal point in the image's centre.

    Pixel (0, 0)'s own centre has the coordinates (0, 0), so the image's centre is at ((width − 1)/2, (height − 1)/2).
    """
    return CameraInfo(
        camera.width, camera.height, camera.focal, camera.focal, (camera.width - 1) / 2, (camera.height - 1) / 2
    )


def check_camera(camera: Camera, field: str = "twin.camera") -> None:
    """Refuses a camera that cannot be.

    Raises:
        ScenarioError: names the field.
    """
    for name in ("width", "height", "focal", "rate"):
        if not getattr(camera, name) > 0:
            raise ScenarioError(f"{field}.{name}", f"{getattr(camera, name)} is not positive")
    if not 0 < camera.latency < 1.0 / camera.rate:
        raise ScenarioError(f"{field}.latency", f"{camera.latency} s is not between 0 and the time between frames, {1 / camera.rate:.4g} s")
    if len(camera.depth_range) != 2 or not 0 < camera.depth_range[0] < camera.depth_range[1]:
        raise ScenarioError(f"{field}.depth_range", f"{camera.depth_range} is not [nearest, farthest]")


def lights() -> list[LightParameter]:
    """Daylight from above, softer from two sides: every face that a camera sees is lit and keeps its colour."""

    def sun(direction: list[float], intensity: float) -> LightParameter:
        return LightParameter(type="directional", frame="world", direction=np.array(direction), color=Rgba(1, 1, 1), intensity=intensity)

    return [sun([-0.3, 0.2, -1.0], 0.75), sun([-1.0, 0.9, -0.5], 0.45), sun([-0.8, -1.0, -0.4], 0.35)]


def add_camera(
    builder: DiagramBuilder,
    scene_graph: SceneGraph,
    camera: Camera,
    X_WC: RigidTransform,
    defects: CameraDefects,
    seed: int,
) -> CameraDefectsSystem:
    """Adds a camera that looks at `scene_graph`.

    It captures at k / rate and delivers `latency` later.

    Args:
        builder: of the station.
        scene_graph: the true scene.
        camera: its intrinsics and timing.
        X_WC: its true pose.
        defects: what it does to its images.
        seed: of the scenario.

    Returns:
        The system whose output ports are the camera's.

    Raises:
        NativeLibraryError: EGL is missing.
        ScenarioError: a camera that cannot be.
    """
    check_camera(camera)
    require_egl()
    if not scene_graph.HasRenderer(_RENDERER):
        params = RenderEngineVtkParams(
            default_clear_color=np.array([0.72, 0.76, 0.80]), lights=lights(), default_diffuse=np.array([0.7, 0.7, 0.7, 1.0])
        )
        scene_graph.AddRenderer(_RENDERER, MakeRenderEngineVtk(params))
    near, far = camera.depth_range
    core = RenderCameraCore(_RENDERER, camera_info(camera), ClippingRange(min(0.05, near / 2), max(20.0, 2 * far)), RigidTransform())
    sensor = builder.AddNamedSystem(
        f"{camera.name}_renderer",
        RgbdSensorAsync(
            scene_graph=scene_graph,
            parent_id=scene_graph.world_frame_id(),
            X_PB=X_WC,
            fps=camera.rate,
            capture_offset=0.0,
            output_delay=camera.latency,
            color_camera=ColorRenderCamera(core, False),
            depth_camera=DepthRenderCamera(core, DepthRange(near, far)),
            render_label_image=False,
        ),
    )
    builder.Connect(scene_graph.get_query_output_port(), sensor.get_input_port())
    spoilt = builder.AddNamedSystem(f"{camera.name}_defects", CameraDefectsSystem(camera, defects, seed))
    builder.Connect(sensor.color_image_output_port(), spoilt.GetInputPort("rgb_rendered"))
    builder.Connect(sensor.depth_image_32F_output_port(), spoilt.GetInputPort("depth_rendered"))
    builder.Connect(sensor.image_time_output_port(), spoilt.GetInputPort("time_rendered"))
    return spoilt
