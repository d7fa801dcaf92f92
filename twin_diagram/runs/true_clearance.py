"""How near the real arm truly came to anything: for scores, plots and tests alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

from pydrake.geometry import CollisionFilterDeclaration, FramePoseVector, GeometrySet, Role
from pydrake.systems.framework import Context, Diagram

from twin_diagram.station import ports
from twin_diagram.station.sim.world_plant import WorldPlant


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    horizon: float = 0.3
    """Distances beyond this are not told apart [m]."""

    closer: tuple[float, ...] = (0.05, 0.15)
    """Looked within first [m]: most of the time something is so near, and of seven objects on a table 1700 pairs of
    shapes are within 30 cm, 70 within 5 cm."""

    approach: float = 0.01
    """Before that, so much beyond the distance of the time before [m]: an arm at 0.5 m/s comes so near in a sample."""


TUNING = Tuning()


class TrueClearance:
    """Distance and contacts of a simulated station's arm, gripper included, with everything that is not the arm.

    The base, which stands on its fixture, does not count against fixtures. Shapes of the arm among themselves, and of
    all else, are left out before distances are worked out: Drake ends the program where two boxes just meet.
    """

    def __init__(self, station: Diagram) -> None:
        """Sort the geometry of a `sim` station into arm and others."""
        world: WorldPlant = cast(Any, station).world
        plant, self._station = world.plant, station
        self._before = TUNING.closer[0]
        arm = world.arm.arm
        arm_bodies = [body for instance in arm.instances for body in plant.GetBodyIndices(instance)]
        self._arm_bodies = {int(body) for body in arm_bodies}
        self._arm = {g for body in arm_bodies for g in plant.GetCollisionGeometriesForBody(plant.get_body(body))}
        fixed = {int(body.index()) for body in plant.GetBodiesWeldedTo(plant.world_body())}
        self._base = {g for body in arm_bodies if int(body) in fixed
                      for g in plant.GetCollisionGeometriesForBody(plant.get_body(body))}  # fmt: skip
        self._still = {g for body in fixed if body not in self._arm_bodies
                       for g in plant.GetCollisionGeometriesForBody(plant.get_body(_index(body)))}  # fmt: skip
        self._scene_graph = world.scene_graph
        every = self._scene_graph.model_inspector().GetAllGeometryIds(Role.kProximity)
        self._shapes = self._scene_graph.CreateDefaultContext()
        filters = self._scene_graph.collision_filter_manager(self._shapes)
        for one_side in (list(self._arm), [g for g in every if g not in self._arm]):
            filters.Apply(CollisionFilterDeclaration().ExcludeWithin(GeometrySet(one_side)))
        self._poses = self._scene_graph.get_source_pose_port(cast(Any, plant.get_source_id()))
        bodies = [body for body in map(_index, range(plant.num_bodies())) if body != plant.world_body().index()]
        self._frames = [plant.GetBodyFrameIdOrThrow(body) for body in bodies]

    def evaluate(self, context: Context, horizon: float = TUNING.horizon) -> tuple[float, int]:
        """Return the least distance [m], no more than `horizon` [m], and number of contacts now.

        Args:
            context: the station's.
            horizon: distances beyond this are not told apart [m].
        """
        query: Any = self._apart(self._station.GetOutputPort(ports.QUERY_OBJECT).Eval(context))
        nearest, likely = horizon, min(max(self._before, 0.0) + TUNING.approach, horizon)
        for reach in (likely, *(closer for closer in (*TUNING.closer, horizon) if likely < closer <= horizon)):
            nearest = self._nearest(query, reach)
            if nearest < reach:
                break
        self._before = nearest
        results: Any = self._station.GetOutputPort(ports.CONTACT_RESULTS).Eval(context)
        contacts = 0
        for i in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(i)
            contacts += (int(info.bodyA_index()) in self._arm_bodies) != (int(info.bodyB_index()) in self._arm_bodies)
        for i in range(results.num_hydroelastic_contacts()):
            surface = results.hydroelastic_contact_info(i).contact_surface()
            contacts += (surface.id_M() in self._arm) != (surface.id_N() in self._arm)
        return nearest, contacts

    def _apart(self, query: Any) -> Any:
        """Return a query of the same poses that pairs shapes of the arm with others alone."""
        poses = FramePoseVector()
        for frame in self._frames:
            poses.set_value(id=frame, value=query.GetPoseInWorld(frame))
        self._poses.FixValue(self._shapes, poses)
        return self._scene_graph.get_query_output_port().Eval(self._shapes)

    def _nearest(self, query: Any, horizon: float) -> float:
        """Return the least distance [m], or `horizon` [m] where nothing is so near."""
        nearest = horizon
        for pair in query.ComputeSignedDistancePairwiseClosestPoints(horizon):
            if not pair.distance < nearest:
                continue
            a, b = pair.id_A, pair.id_B
            if (a in self._arm) == (b in self._arm):
                continue
            mine, other = (a, b) if a in self._arm else (b, a)
            if mine in self._base and other in self._still:
                continue
            nearest = pair.distance
        return nearest


def _index(body: int) -> Any:
    from pydrake.multibody.tree import BodyIndex

    return BodyIndex(body)
