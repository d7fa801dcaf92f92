"""Bins that are drawn from a seed: what lies in them is possible."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from twin_diagram import load_scenario
from twin_diagram.assets import Asset
from twin_diagram.runs.learning.drawn_bins import draw_bin
from twin_diagram.scenario.poses import pose
from twin_diagram.scenario.resources import resolve

GRID = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 13)] * 3), axis=-1).reshape(-1, 3)
"""(M, 3) points of a cube of edge 2."""


def test_nothing_is_let_go_inside_of_something_else() -> None:
    base = load_scenario("bin_picking")
    inside = 0
    for seed in (0, 4, 13, 16):
        boxes = []
        for thing in draw_bin(base, seed, 5).world.objects.values():
            X_WO = pose(thing.X_WO)
            half = 0.5 * np.asarray(Asset.load(resolve(thing.asset, base.packages)).size)
            boxes.append((X_WO.rotation().matrix(), X_WO.translation(), half))
        for (R_a, p_a, half_a), (R_b, p_b, half_b) in combinations(boxes, 2):
            in_b = ((GRID * half_a) @ R_a.T + p_a - p_b) @ R_b
            inside += int((np.abs(in_b) < half_b).all(axis=1).sum())
    assert inside == 0


def test_who_finds_room_lies_on_the_bottom_and_others_fall_upon_what_is_there() -> None:
    base = load_scenario("bin_picking")
    assert base.twin.learning is not None
    low = np.array(base.twin.learning.from_bin[0])
    lowest = []
    for thing in draw_bin(base, 13, 5).world.objects.values():
        R = pose(thing.X_WO).rotation().matrix()
        half = 0.5 * np.asarray(Asset.load(resolve(thing.asset, base.packages)).size)
        lowest.append(thing.X_WO.translation[2] - float(np.abs(R[2]) @ half) - low[2])
    assert min(lowest) > 0.0 and min(lowest) < 0.011 and max(lowest) > 0.03
