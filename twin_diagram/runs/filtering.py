"""Runs the filter over a measured log, without any Diagram."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.filter.arm_messages import TUNING as ARM_MESSAGES
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.logs import Log
from twin_diagram.model.model import Model
from twin_diagram.runtime.threads import one_thread
from twin_diagram.scenario import Filter
from twin_diagram.signals.arrays import Array


@one_thread()
def filter_log(model: Model, log: Log, learn: Sequence[str]) -> tuple[Ekf, Array]:
    """Return a filter that has seen the whole log, and its x̂ = [q, v] at each sample (N, 2n).

    Where the log lacks velocities, of some joints or of all, the filter goes by the encoders alone.

    Args:
        model: with the log's joints, in its order.
        log: checked.
        learn: names of what is learnt: see `parameter_blocks.BLOCKS`.
    """
    ekf = Ekf(ArmTerms.from_model(model), Filter(rate=1.0 / log.period, parameters=list(learn)))
    tau, states = log.motor_torque, np.empty((len(log), 2 * len(model.joints)))
    times = log.time - min(0.0, float(log.time[0]))  # to the filter, what was before 0 was never
    drives = None if log.lacking("velocity_estimated") else log.velocity
    for k, t in enumerate(times):
        if drives is not None:
            ekf.observe(log.position[k], drives[k], tau[k], t)
        elif k == 0 or t - times[k - 1] > ARM_MESSAGES.longest_gap:
            after = min(k + 1, len(log) - 1)
            v = (log.position[after] - log.position[k]) / max(times[after] - t, 1e-6)
            ekf.start(log.position[k], v, tau[k], t)
        else:
            ekf.predict(0.5 * (tau[k - 1] + tau[k]), t - times[k - 1])
            ekf.update("encoder", log.position[k], t)
        states[k] = ekf.belief.x[: states.shape[1]]
    return ekf, states
