"""Vectors on ports: each number has its place, and comes back from it."""

from __future__ import annotations

import numpy as np

from twin_diagram.signals.layouts import (
    ALARM_SIZE,
    MEASUREMENT_SIZE,
    NEVER,
    POSE_SIZE,
    TRACK_SIZE,
    ObjectStatus,
    PoseMeasurement,
    Track,
)


def test_a_measurement_is_quality_time_pose_covariance() -> None:
    vector = np.arange(1.0, 46.0)
    assert len(vector) == MEASUREMENT_SIZE
    one = PoseMeasurement.unpack(vector)
    assert (one.quality, one.time) == (1.0, 2.0)
    np.testing.assert_array_equal(one.pose, np.arange(3.0, 10.0))
    np.testing.assert_array_equal(one.covariance, np.arange(10.0, 46.0).reshape(6, 6))
    np.testing.assert_array_equal(one.pack(), vector)
    one.pose[:] = one.covariance[:] = 0.0
    np.testing.assert_array_equal(vector, np.arange(1.0, 46.0))  # copies


def test_a_track_is_status_time_pose_velocity_covariance() -> None:
    vector = np.r_[3.0, np.arange(2.0, 52.0)]
    assert len(vector) == TRACK_SIZE
    one = Track.unpack(vector)
    assert one.status is ObjectStatus.STALE and one.last_seen == 2.0
    np.testing.assert_array_equal(one.pose, np.arange(3.0, 10.0))
    np.testing.assert_array_equal(one.velocity, np.arange(10.0, 16.0))
    np.testing.assert_array_equal(one.covariance, np.arange(16.0, 52.0).reshape(6, 6))
    np.testing.assert_array_equal(one.pack(), vector)
    one.pose[:] = one.velocity[:] = one.covariance[:] = 0.0
    np.testing.assert_array_equal(vector, np.r_[3.0, np.arange(2.0, 52.0)])


def test_before_the_first_message_no_time_is_valid() -> None:
    """Recordings and other programs hold this number."""
    assert NEVER < 0.0
    assert f"{NEVER:g}" == "-1"
    assert len(ObjectStatus) == POSE_SIZE == 7 and ALARM_SIZE == 4
