"""What was lost and taken again has one asset, told by shape alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.planning.grasps.brute_force import box_triangles
from twin_diagram.assets.building.backends import ColouredSurface
from twin_diagram.runs.learning.record import Learned, LearningRecord
from twin_diagram.runs.learning.taken_again import note_taken_again, same_shape
from twin_diagram.scenario import Scenario
from twin_diagram.signals.arrays import Array

BOX = box_triangles(0.09, 0.04, 0.17)
L_SHAPE = np.concatenate([box_triangles(0.03, 0.04, 0.17), box_triangles(0.06, 0.04, 0.03) + [0.045, 0.0, -0.07]])


def surface(corners: Array, seed: int = 0) -> ColouredSurface:
    """A shape as pictures of an object give it: in any frame, and off by a third of a millimetre."""
    rng = np.random.default_rng(seed)
    turned = corners @ Rotation.random(random_state=seed).as_matrix().T + rng.normal(0.0, 0.1, 3)
    noisy = turned + rng.normal(0.0, 3e-4, turned.shape)
    return ColouredSurface(noisy, np.zeros((len(corners), 3, 2)), np.zeros((4, 4, 3), np.uint8), 0.0, 0.001)


@pytest.mark.parametrize("corners", [BOX, pytest.param(L_SHAPE, marks=pytest.mark.long)])
def test_one_things_shapes_are_the_same_however_it_lay(corners: Array) -> None:
    for seed in range(1, 4):
        assert same_shape(surface(corners), surface(corners, seed))
        assert not same_shape(surface(corners), surface(corners * [1.0, 1.0, 1.08], seed)), "14 mm longer"
    assert not same_shape(surface(BOX), surface(L_SHAPE))


def test_of_what_was_lost_and_taken_again_one_asset_is_left(tmp_path: Path) -> None:
    record = LearningRecord(tmp_path / "run", Scenario())
    state = record.begin()
    away = [0.4, 0.3, 0.05, 0.1]
    state.learned = [
        Learned("object_01", "finished", "no picture shows anything in the hand"),
        Learned("object_02", "finished", standing=away),
        Learned("object_03", "finished", "it was lost"),
        Learned("object_04", "finished", standing=away),
    ]
    for one, corners in zip(state.learned, (BOX, BOX, L_SHAPE, BOX), strict=True):
        folder = record.fresh(one.name)
        shape = surface(corners, int(one.name[-1]))
        told = np.array([shape.unseen, shape.noise])
        np.savez(folder / "shape.npz", corners=shape.corners, uv=shape.uv, texture=shape.texture, told=told)
        (record.library / one.name).mkdir(parents=True)
    note_taken_again(record, state.learned, state.learned[3])
    assert [one.state for one in state.learned] == ["failed", "finished", "finished", "finished"]
    assert state.learned[0].told == "no picture shows anything in the hand; it was taken again as object_04"
    assert (record.library / "object_01").is_dir(), "until the state is kept that says so"
    record.save(state)
    assert sorted(path.name for path in record.library.iterdir()) == ["object_02", "object_03", "object_04"]
    assert (record.of("object_01") / "shape.npz").is_file() and record.resume().learned == state.learned
    # What is still in the hand's way, or has no asset, is nobody's other half.
    state.learned[0].state, state.learned[0].taken_again = "finished", ""
    state.learned[3].standing = []
    note_taken_again(record, state.learned, state.learned[3])
    assert state.learned[0].state == "finished"
