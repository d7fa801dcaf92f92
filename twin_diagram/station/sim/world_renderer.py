"""Pictures of the simulated world at any positions of its plant, through any lens."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
import numpy.typing as npt
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    DepthRange,
    DepthRenderCamera,
    MakeRenderEngineVtk,
    QueryObject,
    RenderCameraCore,
    RenderEngineVtkParams,
)
from pydrake.math import RigidTransform
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraInfo

from twin_diagram.scenario import Scenario
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.between_pixels import depth_between
from twin_diagram.signals.lens import Lens, unit_rays
from twin_diagram.station.depth_units import Colour, Depth
from twin_diagram.station.sim.drawn_shapes import drawn_shapes
from twin_diagram.station.sim.drawn_world import DrawnWorld
from twin_diagram.station.sim.world_plant import build_appearance

_RENDERER = "camera"
"""The name under which SceneGraph knows the render engine."""


def drakes_intrinsics(lens: Lens) -> CameraInfo:
    """Return Drake's intrinsics of a lens without distortion.

    Drake's VTK renderer puts pixel centres at (u + 0.5, v + 0.5), and not at (u, v) as everywhere in computer vision;
    so it is told a principal point half a pixel further; without that every object is seen 0.7 mm aside at 1 m.
    """
    return CameraInfo(lens.width, lens.height, lens.fx, lens.fy, lens.cx + 0.5, lens.cy + 0.5)


class LensView:
    """A lens and how its pictures are made of those of a lens without distortion, which is what renderers have."""

    def __init__(self, lens: Lens) -> None:
        """Find the straight lens that sees all that `lens` sees."""
        self.lens = self.straight = lens
        self._maps: tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]] | None = None
        if not lens.distortion:
            return
        x, y, _ = np.moveaxis(unit_rays(lens), -1, 0)
        u, v = lens.fx * x, lens.fy * y
        # A pixel of margin on each side, for what lies between pixels.
        left, top = np.floor(u.min()) - 1.0, np.floor(v.min()) - 1.0
        width, height = int(np.ceil(u.max()) - left) + 2, int(np.ceil(v.max()) - top) + 2
        self.straight = Lens(width, height, lens.fx, lens.fy, -left, -top)
        self._maps = ((u - left).astype(np.float32), (v - top).astype(np.float32))

    def colour(self, image: Colour) -> Colour:
        """Return colours of the straight lens as the lens itself shows them."""
        return image if self._maps is None else np.asarray(cv2.remap(image, *self._maps, cv2.INTER_LINEAR))

    def depth(self, image: Depth) -> Depth:
        """Return depth of the straight lens as the lens itself shows it."""
        return image if self._maps is None else depth_between(image, *self._maps)

    def label(self, image: npt.NDArray[np.int16]) -> npt.NDArray[np.int16]:
        """Return labels of the straight lens as the lens itself shows them."""
        return image if self._maps is None else np.asarray(cv2.remap(image, *self._maps, cv2.INTER_NEAREST))


class WorldRenderer:
    """Renders the world of a scenario. Holds a Context of its own, in which every picture sets all positions anew.

    What the project draws itself it draws (see `DrawnWorld`); a world with meshes of another kind goes to Drake's VTK
    renderer as a whole.
    """

    def __init__(
        self, scenario: Scenario, params: RenderEngineVtkParams, clipping: ClippingRange, depth_range: DepthRange
    ) -> None:
        """Build the world's appearance.

        Args:
            scenario: whose world it is.
            params: light and background.
            clipping: what is drawn.
            depth_range: what depth is measured.
        """
        self._clipping, self._depth_range = clipping, depth_range
        builder = DiagramBuilder()
        shown = build_appearance(builder, scenario, merged=False)
        shapes = drawn_shapes(shown.scene_graph)
        self._drawn: DrawnWorld | None = None
        if shapes is None:
            builder = DiagramBuilder()
            shown = build_appearance(builder, scenario)
            shown.scene_graph.AddRenderer(_RENDERER, MakeRenderEngineVtk(params))
        else:
            sky = np.asarray(params.default_clear_color)
            self._drawn = DrawnWorld(shapes, params.lights, sky, clipping.near(), clipping.far())
        builder.ExportInput(shown.poses.get_input_port(), "positions")
        builder.ExportOutput(shown.scene_graph.get_query_output_port(), "query")
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()
        self._world = shown.scene_graph.world_frame_id()
        self._plant, self._plant_context = shown.plant, shown.plant.CreateDefaultContext()
        self.objects = shown.objects
        """Body of each object: its index is its label."""
        self.position_count = int(self._plant.num_positions())
        """nq of the world's plant."""

    def any_state(self) -> Array:
        """Return a state (nq + nv) of the world's plant in which everything moves."""
        plant = self._plant
        positions = plant.GetPositions(plant.CreateDefaultContext())
        return np.concatenate([positions, np.ones(plant.num_velocities())])

    def rates(self, state: Array) -> Array:
        """Return how fast positions change (nq) in a state (nq + nv) of the world's plant."""
        nq = self.position_count
        self._plant.SetPositions(self._plant_context, state[:nq])
        return np.asarray(self._plant.MapVelocityToQDot(self._plant_context, state[nq:]))

    def colour(self, positions: Array, view: LensView, X_WC: RigidTransform) -> Colour:
        """Return the colours (H, W, 4) that a camera at X_WC sees at positions (nq,)."""
        query = self._at(positions)
        if self._drawn is not None:
            return view.colour(self._drawn.colour(query, view.straight, X_WC))
        image = query.RenderColorImage(ColorRenderCamera(self._core(view), False), self._world, X_WC)
        return view.colour(image.data)

    def colours(self, first: Array, second: Array, view: LensView, X_WC: RigidTransform) -> tuple[Colour, Colour]:
        """Return the colours (H, W, 4) that a camera at X_WC sees at two positions (nq,) near to each other."""
        if self._drawn is None:
            # A renderer's image is its own until the next: copied.
            return self.colour(first, view, X_WC).copy(), self.colour(second, view, X_WC)
        poses = self._drawn.poses(self._at(first))
        image = self._drawn.coloured(poses, view.straight, X_WC)
        again = self._drawn.again(image, poses, self._at(second), view.straight, X_WC)
        return view.colour(image), view.colour(again)

    def depth(self, positions: Array, view: LensView, X_WD: RigidTransform) -> Depth:
        """Return the depth (H, W) [m] that a camera at X_WD sees at positions (nq,), 0 or infinite beyond its range."""
        query, reach = self._at(positions), self._depth_range
        if self._drawn is not None:
            least, most = reach.min_depth(), reach.max_depth()
            return view.depth(self._drawn.depth(query, view.straight, X_WD, least, most))
        image = query.RenderDepthImage(DepthRenderCamera(self._core(view), reach), self._world, X_WD)
        return view.depth(image.data[..., 0])

    def shows(
        self, positions: Array, view: LensView, X_WD: RigidTransform, labels: Iterable[int]
    ) -> npt.NDArray[np.bool_]:
        """Return (H, W) where a camera at X_WD sees bodies with any of some labels at positions (nq,)."""
        query = self._at(positions)
        if self._drawn is not None:
            seen = self._drawn.labels(query, view.straight, X_WD).astype(np.int16)
        else:
            core = ColorRenderCamera(self._core(view), False)
            seen = query.RenderLabelImage(core, self._world, X_WD).data[..., 0]
        return np.isin(view.label(seen), list(labels))

    def _core(self, view: LensView) -> RenderCameraCore:
        return RenderCameraCore(_RENDERER, drakes_intrinsics(view.straight), self._clipping, RigidTransform())

    def _at(self, positions: Array) -> QueryObject:
        self._diagram.GetInputPort("positions").FixValue(self._context, positions)
        found: QueryObject = self._diagram.GetOutputPort("query").Eval(self._context)
        return found
