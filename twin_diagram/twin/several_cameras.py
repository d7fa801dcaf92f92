"""Wires several cameras into the twin: each image is taken apart by its own, and all see one set of objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, cast

from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem, System

from twin_diagram import scenario
from twin_diagram.assets.asset import Asset
from twin_diagram.perception.segmentation.learned import Segmenter
from twin_diagram.perception.segmentation.segmentation_system import PerceptionSystem
from twin_diagram.perception.several_views.pose_system import SeveralCamerasEstimator
from twin_diagram.scenario.lenses import calibration_error
from twin_diagram.station import ports
from twin_diagram.twin.arm_sensing.camera_calibrator import add_calibrator
from twin_diagram.twin.given_files import Packages


class NewestImage(LeafSystem):
    """Says when the newest image of any camera was taken.

    .. pydrake_system::

        name: NewestImage
        input_ports:
        - <camera>.image_time
        output_ports:
        - image_time

    All [s], `NEVER` before the first. Computed when asked for; no state, no latency.
    """

    def __init__(self, names: Sequence[str]) -> None:
        """Size the ports; `names` of the cameras."""
        super().__init__()
        self._times: Final = [self.DeclareVectorInputPort(ports.image_time(name), 1) for name in names]

        def calc(context: Context, output: BasicVector) -> None:
            output[0] = max(float(cast(Any, port.Eval(context))[0]) for port in self._times)

        self.DeclareVectorOutputPort(
            "image_time", 1, calc, prerequisites_of_calc={port.ticket() for port in self._times}
        )


def add_several_cameras(
    builder: DiagramBuilder,
    twin: scenario.Twin,
    library: Mapping[str, Asset],
    packages: Packages | None,
    arm_state: System,
    timed: Sequence[System],
    health: System,
    segmenter: Segmenter | None = None,
) -> SeveralCamerasEstimator:
    """Add what leads from several cameras' images to the objects' poses, and connect whoever wants their times.

    Inputs of the twin are each camera's `rgb_image`, `depth_image` and `image_time` under its name, an output each
    one's `calibration` where it is estimated.

    Args:
        builder: of the twin.
        twin: what it is told.
        library: the known objects.
        packages: local folders for `package://` names.
        arm_state: the system with this output port.
        timed: systems that are told of the newest image of any camera, by their input port `image_time`.
        health: the system that is told of each camera's newest image.
        segmenter: a user's own, see `make_twin`.
    """
    cameras = twin.perceiving
    estimator = builder.AddNamedSystem("icp_pose_estimator", SeveralCamerasEstimator(library, cameras, twin))
    newest = builder.AddNamedSystem("newest_image", NewestImage(list(cameras)))
    for name, camera in cameras.items():
        parting = PerceptionSystem(twin.arm, camera, twin.perception, packages, segmenter=segmenter)
        eye = builder.AddNamedSystem(f"perception_{name}", parting)
        builder.ExportInput(eye.GetInputPort("rgb_image"), ports.rgb_image(name))
        builder.ExportInput(eye.GetInputPort("depth_image"), ports.depth_image(name))
        time = builder.ExportInput(eye.GetInputPort("image_time"), ports.image_time(name))
        for system in (newest, health):
            builder.ConnectInput(time, system.GetInputPort(ports.image_time(name)))
        builder.Connect(arm_state.GetOutputPort("arm_state"), eye.GetInputPort("arm_state"))
        builder.Connect(eye.GetOutputPort("segments"), estimator.GetInputPort(f"{name}.segments"))
        if not calibration_error(camera).variances.any():
            continue
        calibrator = add_calibrator(builder, twin.arm, camera, twin.perception, packages, beside=True)
        builder.Connect(arm_state.GetOutputPort("arm_state"), calibrator.GetInputPort("arm_state"))
        out = calibrator.GetOutputPort("calibration")
        builder.Connect(out, eye.GetInputPort("calibration"))
        builder.Connect(out, estimator.GetInputPort(f"{name}.calibration"))
    for system in timed:
        builder.Connect(newest.get_output_port(), system.GetInputPort("image_time"))
    return estimator
