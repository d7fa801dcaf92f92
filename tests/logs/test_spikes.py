"""Garbled samples are taken as lost; what an arm does, dry friction and rests among it, stays as it is."""

from __future__ import annotations

import numpy as np

from twin_diagram.logs import Log, fingerprint
from twin_diagram.logs.spikes import spikes, unspiked


def swung(noise: float) -> Log:
    """A joint that swings, one that rests for half of the time, with steps of dry friction in their torque."""
    rng = np.random.default_rng(1)
    time = 0.002 * np.arange(4000)
    position = np.stack([np.sin(2.0 * time), np.sin(2.0 * np.maximum(time - 4.0, 0.0))], axis=1)
    velocity = np.gradient(position, time, axis=0)
    torque = 30.0 * position + 20.0 * np.sign(velocity) + noise * rng.normal(size=position.shape)
    return Log(time, ("a", "b"), position + 1e-5 * rng.normal(size=position.shape), velocity, torque)


def test_what_an_arm_does_stays() -> None:
    for noise in (0.0, 0.5):
        log = swung(noise)
        same, said = unspiked(log)
        assert same is log and said == []


def test_garbled_samples_are_what_their_neighbours_say() -> None:
    log = swung(0.5)
    position, torque = log.position.copy(), log.motor_torque.copy()
    position[700, 0], position[900, 0], torque[1500, 1], torque[2500, 1] = -3.0, position[899, 0] + 0.05, 900.0, -900.0
    found, said = unspiked(Log(log.time, log.joints, position, log.velocity, torque))
    np.testing.assert_allclose(found.position, log.position, atol=2e-4)
    np.testing.assert_allclose(found.motor_torque, log.motor_torque, atol=4.0)
    assert [warning.message for warning in said] == [
        "log: 2 sample(s) of position_measured of a leap away and back; they are taken as lost",
        "log: 2 sample(s) of torque_measured of b leap away and back; they are taken as lost",
    ]
    assert fingerprint(found) == fingerprint(Log(log.time, log.joints, position, log.velocity, torque))


def test_more_leaps_than_a_few_are_what_the_signal_does() -> None:
    """A brake that chatters, say: 12 of 4000 samples are lost messages, 15 are not."""
    log = swung(0.5)
    for count, kept in ((12, False), (15, True)):
        torque = log.motor_torque.copy()
        torque[100 : 100 + 120 * count : 120, 0] += 900.0
        garbled = Log(log.time, log.joints, log.position, log.velocity, torque)
        assert (unspiked(garbled)[0] is garbled) == kept


def test_a_good_sample_between_two_garbled_ones_is_not_the_one_that_leaps() -> None:
    values = swung(0.5).motor_torque.copy()
    values[[1000, 1002], 0] = 900.0, 800.0
    assert spikes(values)[1000, 0] and not spikes(values)[1001, 0]


def test_two_that_stand_close_are_both_taken_as_lost() -> None:
    log = swung(0.5)
    for apart, second in ((2, 800.0), (1, -700.0)):
        torque = log.motor_torque.copy()
        torque[[1000, 1000 + apart], 0] = 900.0, second
        found, said = unspiked(Log(log.time, log.joints, log.position, log.velocity, torque))
        np.testing.assert_allclose(found.motor_torque, log.motor_torque, atol=4.0)
        assert said[0].message.startswith("log: 2 sample(s)")
