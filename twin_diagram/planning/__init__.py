"""Plans the arm's motion in the twin's scene.

From the bottom up: `collision.chain` places links; `collision.convex_solids`, `collision.geometry_to_solids` and
`collision.ball_cover` turn geometry into convex solids and the arm into balls; `collision.solid_batch` puts many into
tables, from which `collision.near_kernels` measures, and `collision.clearance` gives distances with gradients;
`collision.collision_scene` says where things are and will be, `collision.forecast_growth` how uncertain that is;
`paths.inverse_kinematics` finds joint goals; `paths.rrt_connect` finds ways around; `paths.time_optimal` says how fast
they can be travelled; `paths.route` decides on a way; `paths.guide` is what is searched for beside the tick, and
`paths.searching`, `paths.search_process` say where; `mpc.trajectory` is a motion, `mpc.arm_torque` what it takes of the
motors; `mpc.quadratic_program`, `mpc.active_set`, `mpc.motion_program` and `mpc.trajectory_optimisation` make one that
follows a way and keeps clear; `mpc.planner` puts these together as a function from `mpc.planner_state` to memory, and
`mpc_system` makes that a system. `mpc.payload_gravity` gives the torque against the weight that the hand carries;
`collision.held_shape` makes what it holds part of the arm. `tasks` runs a task's steps: `tasks.transitions` says what
to do next, `tasks.picking` and `tasks.placing` how things are taken and put down, and `tasks.task_system` is the
system.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin_diagram.runtime import faces

if TYPE_CHECKING:
    from twin_diagram.planning.mpc.planner import MotionPlanner
    from twin_diagram.planning.mpc_system import Mpc
    from twin_diagram.planning.tasks.task_system import TaskRunner

__all__ = [
    "MotionPlanner",
    "Mpc",
    "TaskRunner",
]

__getattr__, __dir__ = faces.lazy_face(__name__)
