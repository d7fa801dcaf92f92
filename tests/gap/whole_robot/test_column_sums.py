"""Sums over groups of samples: worked out again for new columns alone, they are what all of them would be."""

from __future__ import annotations

import numpy as np

from twin_diagram.gap.whole_robot.column_sums import summed, summed_again


def test_sums_with_new_columns_are_those_of_all_columns() -> None:
    rng = np.random.default_rng(6)
    columns, weights, group = rng.normal(size=(40, 3, 7)), rng.random((40, 3)), rng.permutation(40) % 4
    before = summed(columns, weights, group)
    was = [0, 1, -1, 4, 5, -1, 2, 6]  # the fourth is gone
    more = np.stack([rng.normal(size=(40, 3)) if k < 0 else columns[:, :, k] for k in was], axis=2)
    np.testing.assert_allclose(
        summed_again(before, was, more, weights, group), summed(more, weights, group), atol=1e-12
    )
    none_new = summed_again(before, [3, 1], columns[:, :, [3, 1]], weights, group)
    np.testing.assert_array_equal(none_new, before[:, :, [[3], [1]], [3, 1]])
