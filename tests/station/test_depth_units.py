"""Depth as whole units: rounded to the nearest, held at what 16 bits hold, the same bits again."""

from __future__ import annotations

import numpy as np

from twin_diagram.station.depth_units import depth_to_units, units_to_depth, whole_units


def test_depth_is_rounded_to_the_nearest_unit() -> None:
    depth = np.array([[0.0, 0.00049, 0.00051, 1.2344, 1.2346, 3.0]], dtype=np.float32)
    np.testing.assert_array_equal(depth_to_units(depth, 0.001), [[0, 0, 1, 1234, 1235, 3000]])
    np.testing.assert_allclose(whole_units(depth, 0.001), [[0.0, 0.0, 0.001, 1.234, 1.235, 3.0]], rtol=1e-7)


def test_beyond_sixteen_bits_depth_stays_at_their_end() -> None:
    depth = np.array([6.5534, 6.5535, 6.6, 100.0], dtype=np.float32)
    np.testing.assert_array_equal(depth_to_units(depth, 1e-4), [65534, 65535, 65535, 65535])
    np.testing.assert_array_equal(units_to_depth(np.array([65535], np.uint16), 1e-4), [np.float32(65535 * 1e-4)])


def test_each_count_has_its_depth_and_comes_back() -> None:
    counts = np.arange(65536).astype(np.uint16)
    for unit in (1e-3, 2.5e-4, 1e-4):
        depth = units_to_depth(counts, unit)
        np.testing.assert_array_equal(depth, (np.arange(65536) * unit).astype(np.float32))
        np.testing.assert_array_equal(depth_to_units(depth, unit), counts)
        np.testing.assert_array_equal(whole_units(depth, unit), depth)
