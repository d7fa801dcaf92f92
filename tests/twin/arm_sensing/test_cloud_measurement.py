"""What a camera's and a lidar's measurement have in common: its size, its moment, its points."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from twin_diagram.signals.arrays import Array
from twin_diagram.twin.arm_sensing.cloud_measurement import SIZE, feed, measured, near


def found(q: Array) -> tuple[Array, Array]:
    return np.concatenate([[1.0, 0.0, 0.0, 0.0], q[:3]]), np.arange(36.0).reshape(6, 6)


def test_a_measurement_is_a_pose_and_its_noise_row_by_row() -> None:
    assert SIZE == 43
    z = measured(0.5, 0.7, np.array([1.0, 2.0, 3.0, 0.1, -0.2, 0.3]), found)
    np.testing.assert_allclose(z[:7], [1.0, 0.0, 0.0, 0.0, 0.98, 2.04, 2.94])
    np.testing.assert_array_equal(z[7:], np.arange(36.0))


def test_a_cloud_taken_at_zero_is_one_and_before_that_there_is_none() -> None:
    state = np.array([1.0, 2.0, 3.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(measured(0.0, 0.25, state, found)[4:7], [0.75, 1.75, 2.75])
    nothing = measured(-1e-9, 0.25, state, found)
    assert nothing.shape == (43,) and np.isnan(nothing[:7]).all() and not nothing[7:].any()


def test_near_is_nearer_than_the_radius_and_no_more_than_asked() -> None:
    line = np.stack([np.arange(-10.0, 11.0), np.full(21, 2.0), np.full(21, -1.0)], axis=1)
    middle = np.array([3.0, 2.0, -1.0])
    np.testing.assert_array_equal(near(line, middle, 4.0, 100)[:, 0], np.arange(0.0, 7.0))
    np.testing.assert_array_equal(near(line, middle, 4.0, 3)[:, 0], [0.0, 2.0, 4.0])
    np.testing.assert_array_equal(near(line, middle, 4.0, 5)[:, 0], [0.0, 1.0, 2.0, 4.0, 5.0])  # of seven
    np.testing.assert_array_equal(near(line, middle, 4.0, 7)[:, 0], np.arange(0.0, 7.0))


class Filter:
    """Stands for a filter: the ports that a sensor's reading and noise come in by."""

    def __init__(self, builder: DiagramBuilder) -> None:
        from pydrake.systems.primitives import PassThrough

        self.reading, self.noise = builder.AddSystem(PassThrough(7)), builder.AddSystem(PassThrough(36))

    def GetInputPort(self, name: str) -> object:
        part = {"hand.reading": self.reading, "hand.noise": self.noise}[name]
        return part.get_input_port()


def test_the_filter_is_given_pose_and_noise_apart() -> None:
    builder = DiagramBuilder()
    source = builder.AddSystem(ConstantVectorSource(np.arange(43.0)))
    ekf = Filter(builder)
    feed(builder, source.get_output_port(), ekf, "hand")  # type: ignore[arg-type]
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    for system, wanted in ((ekf.reading, np.arange(7.0)), (ekf.noise, np.arange(7.0, 43.0))):
        value = system.get_output_port().Eval(system.GetMyContextFromRoot(context))
        np.testing.assert_array_equal(value, wanted)
