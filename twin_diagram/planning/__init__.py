"""Plans the arm's motion in the twin's scene.

From the bottom up: `kinematics` places links; `convex`, `shapes` and `cover` turn geometry into convex solids and the
arm into balls; `clearance` gives distances with gradients; `scene` says where things are and will be; `ik` finds
joint goals; `guide` finds ways around; `trajectory` is a motion; `qp` and `optimiser` make one that follows a way and
keeps clear; `route` decides on a way; `mpc` puts these together as a function from `memory` to memory, and
`mpc_system` makes that a system. `payload` gives the torque against the weight that the hand carries.
"""
