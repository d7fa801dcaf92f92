"""Assets that come into use while the twin runs: no port, plant or state is made anew.

The ports are sized when the twin is built. What comes later gets one of the slots for further instances: the systems
know its shape by a number that follows the library's, and which Contexts look for it, their own state says.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Final, cast

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, Diagram

from twin_diagram.assets.asset import Asset
from twin_diagram.errors import TwinError
from twin_diagram.perception.registration.pose_system import IcpPoseEstimator, NewestLook
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.perception.several_views.pose_system import SeveralCamerasEstimator
from twin_diagram.planning.braking.stop_monitor import StopMonitor
from twin_diagram.planning.mpc_system import Mpc
from twin_diagram.planning.tasks.task_system import TaskRunner
from twin_diagram.scene.object_events import Names
from twin_diagram.scene.twin_scene import TwinScene

Sight = IcpPoseEstimator | SeveralCamerasEstimator
"""What finds objects, through one camera or several."""
Mover = Mpc | StopMonitor | TaskRunner
"""What must know of them where it moves the arm."""


class AddedAssets:
    """Those of one twin, and the systems that must know them.

    Attributes:
        assets: by name, in the order of their numbers.
    """

    def __init__(
        self, scene: TwinScene, sight: Sight | None, movers: Sequence[Mpc | StopMonitor | TaskRunner | None]
    ) -> None:
        """Begin with none.

        Args:
            scene: the twin's.
            sight: what finds objects; None where there is no camera, or the user's own perception.
            movers: what keeps clear of them.
        """
        self.assets: dict[str, Asset] = {}
        self._scene: Final = scene
        self._sight: Final = sight
        self._movers: Final = [system for system in movers if system is not None]

    def add(self, asset: Asset | str | Path, name: str | None = None) -> int:
        """Take in an asset; see `TwinDiagram.add_asset`."""
        if not isinstance(asset, Asset):
            asset = Asset.load(asset)
        name = asset.name if name is None else name
        if not name.strip():
            raise TwinError(f"{asset.folder}: an asset must have a name, not {name!r}")
        if name in self._scene.object_names or name in self.assets:
            raise TwinError(f"asset {name}: the twin knows an object of this name already; choose another")
        sight = self.check(f"asset {name}: ")
        number = self._scene.add_kind(name, asset.folder)
        try:
            found = sight.add_asset(asset)
        except BaseException:  # numbers would no longer be the same in all systems
            del self._scene.kinds[number:]
            raise
        assert found == number
        for system in self._movers:
            system.add_asset(asset)
        self.assets[name] = asset
        return number

    def check(self, whose: str = "") -> Sight:
        """Return what finds objects; raise TwinError where there are no eyes, or no slots for what comes later."""
        if self._sight is None:
            raise TwinError(f"{whose}the twin has no perception of its own that could find it")
        self._sight.check_slots()
        return self._sight

    def looking_beside(self) -> AbstractContextManager[Callable[[], None]]:
        """Have a process of its own look at images; see `IcpPoseEstimator`. Several cameras' are looked at here."""
        return self._sight.looking_beside() if isinstance(self._sight, IcpPoseEstimator) else nullcontext(lambda: None)

    def looked_at(self, diagram: Diagram, context: Context) -> float:
        """Return when the newest image that was looked at was taken [s], in a Context of the twin."""
        sight = self.check()
        return sight.looked_at(diagram.GetSubsystemContext(sight, context))

    def looked(self, diagram: Diagram, context: Context) -> NewestLook:
        """Return what the newest image that was looked at showed of known objects, in a Context of the twin."""
        sight = self.check()
        return sight.looked(diagram.GetSubsystemContext(sight, context))

    def segments(self, diagram: Diagram, context: Context) -> Segments:
        """Return the newest image taken apart, in a Context of the twin."""
        sight = self.check()
        if isinstance(sight, SeveralCamerasEstimator):
            return sight.segments(diagram.GetSubsystemContext(sight, context))
        port = sight.GetInputPort("segments")
        return cast(Segments, port.Eval(diagram.GetSubsystemContext(sight, context)))

    def use(self, diagram: Diagram, context: Context, number: int, X_WO: RigidTransform | None) -> None:
        """Look for an asset in one Context; see `TwinDiagram.use_asset`."""
        if self._sight is None:
            raise IndexError(f"asset {number}: none was added")
        pose = None if X_WO is None else np.concatenate([X_WO.rotation().ToQuaternion().wxyz(), X_WO.translation()])
        if pose is not None and not np.isfinite(pose).all():
            raise TwinError(f"asset {number}: X_WO is not finite: {pose}")
        self._sight.use_asset(diagram.GetMutableSubsystemContext(self._sight, context), number, pose)

    def names(self, diagram: Diagram, context: Context) -> Names:
        """Return what objects and things are called in a Context."""
        own: dict[int, int] = {}
        if self._sight is not None:
            own = self._sight.own_slots(diagram.GetSubsystemContext(self._sight, context))
        return Names(self._scene.object_names, tuple(self.assets), frozenset(own))
