"""Effects in a simulator's plant.

Importing this package makes each effect's realisation known; one for an effect of one's own needs `@realises`.
"""

from __future__ import annotations

from twin_diagram.model.effects.simulated import bodies, friction, joint_torques, split_joints

__all__ = ["bodies", "friction", "joint_torques", "split_joints"]
