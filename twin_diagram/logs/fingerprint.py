"""Tells one log from another."""

from __future__ import annotations

import hashlib

import numpy as np

from twin_diagram.logs.measured_log import Log


def fingerprint(log: Log) -> str:
    """Return a short text that two logs share if they hold the same times and positions of the same joints.

    In any order.

    Resampling keeps it.
    """
    if log.identity:
        return log.identity
    digest = hashlib.sha256()
    digest.update(np.round(log.time * 1e6).astype(np.int64).tobytes())
    for joint in sorted(log.joints):
        digest.update(joint.encode())
        digest.update(np.round(log.position[:, log.joints.index(joint)] * 1e7).astype(np.int64).tobytes())
    return digest.hexdigest()[:16]
