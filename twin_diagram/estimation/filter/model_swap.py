"""What a filter knew, carried over to a filter of a corrected model, while the arm runs on.

Position, speed and the sensors' own states are about the arm and stay, with what they have to do with each other. The
parameters θ were learnt against the old model, and a gap is found against that model with θ left out: whatever they
had taken on is now either in the corrected model or was never there. They begin anew at their prior, as does the
disturbance, which held what neither explained.
"""

from __future__ import annotations

import numpy as np

from twin_diagram.estimation.filter.belief import Belief, Entry
from twin_diagram.estimation.filter.disturbance import disturbance_std
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.estimation.filter.sensor_registry import FilterError


def hand_over(belief: Belief, to: Ekf) -> None:
    """Make what a filter knew the belief of another one, whose model is a corrected one.

    Args:
        belief: of the old filter; not changed.
        to: the new one, of the same arm, parameters and sensors.

    Raises:
        FilterError: it has other joints, parameters or sensors.
    """
    new, n, p = to.belief, to.terms.n, to.parameters.size
    if len(belief.vector) != len(new.vector) or (belief.n, belief.p) != (n, p):
        raise FilterError(
            f"a filter of {belief.n} joints and {belief.p} parameters cannot hand over to one of {n} and {p}"
        )
    new.vector[:] = belief.vector
    new.theta[:] = to.parameters.mean
    new.model[:], new.gradient[:], new.score[:], new.freed[:] = new.theta, 0.0, 0.0, 0.0
    new.disturbance[:], new.innovation[:] = 0.0, 0.0
    afresh = slice(2 * n, 3 * n + p)
    new.P[afresh, :], new.P[:, afresh] = 0.0, 0.0
    dry = to.terms.dry(to.terms.true_position(new.q), new.v, new.torque)
    at = np.arange(2 * n, 3 * n)
    new.P[at, at] = disturbance_std(to.params, new.regime != 0.0, 0.5 * (dry[0] + dry[1])) ** 2
    learnt = slice(3 * n, 3 * n + p)
    new.P[learnt, learnt] = to.parameters.covariance if to.params.rule == "covariance" else 0.0
    if new.valid:
        new.header[Entry.NIS], new.header[Entry.NIS_MEAN] = 2.0 * n, 1.0
        new.header[[Entry.QUIET, Entry.ALARM]] = np.minimum(new.header[[Entry.QUIET, Entry.ALARM]], new.time)
    to.load(new.vector.copy())
