"""Noise that depends on seed, sensor and message alone."""

from __future__ import annotations

import itertools

import numpy as np

from twin_diagram.station.sim.noise import MessageStreams, Stream, generator


def test_every_seed_sensor_and_message_has_its_own_and_always_the_same() -> None:
    seeds, ticks = (0, 1, 2, 3, 5, 2**40, -1, -2, 2**64 - 3), (0, 1, 2, 3, 2**33, 2**63)
    drawn = {}
    for key in itertools.product(seeds, Stream, ticks):
        drawn[key] = tuple(generator(*key).integers(0, 2**62, 4))
        assert drawn[key] == tuple(generator(*key).integers(0, 2**62, 4))
    assert len(set(drawn.values())) == len(drawn)


def test_seeds_are_of_64_bits() -> None:
    for one, same in ((-1, 2**64 - 1), (3, 3 + 2**64)):
        np.testing.assert_array_equal(*(generator(seed, Stream.ARM, 7).random(4) for seed in (one, same)))


def test_neighbouring_messages_are_no_shifted_copies() -> None:
    """A counter that ran on from message to message would give the same numbers a few places later."""
    series = [generator(1, Stream.CAMERA, tick).random(64) for tick in range(4)]
    assert len(np.unique(np.concatenate(series))) == 4 * 64


def test_messages_draw_what_a_generator_of_their_own_would() -> None:
    """In whatever order they come, and whatever was drawn before."""
    messages = MessageStreams(7, Stream.ARM)
    for tick in (5, 2, 2**40, 0, 9):
        assert np.array_equal(messages.of(tick).standard_normal(13), generator(7, Stream.ARM, tick).standard_normal(13))
        messages.of(tick).integers(0, 5, 3, dtype=np.uint32)  # half of a number is left over
