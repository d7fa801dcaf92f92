"""What a tracker said of a scene beside what is true: wrong objects, flips, swaps, inventions, losses, claims."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from scene_truth.film import Truth
from scene_truth.script import PERIOD, Script
from twin_diagram.runs.tracking.track_frames import REAL
from twin_diagram.signals import rotations
from twin_diagram.signals.calibration_error import pose_shifts, shared_covariances

Array = npt.NDArray[np.float64]

NEAR = 0.05
"""An object is there within this [m]."""
FLIPPED = np.radians(30.0)
"""A pose is turned wrongly beyond this, up to symmetry."""
OPEN = 0.3
"""A thing of which this share is seen should be known."""
SURE = 0.5
"""What is less probable is not claimed."""
HELD = 22.46
"""Truth is inside a claim below this: χ² of six degrees of freedom, 0.999."""
LATE = 0.5
"""A loss must be said within this [s]."""
REGAINED = 1.0
"""And what is in the open again found within this [s]."""


@dataclass
class Tally:
    """Counts over frames and objects, and errors.

    Attributes:
        counts: by name.
        millimetres, degrees: of each right claim on something that is seen.
        nees: squared errors over what is claimed, per degree of freedom.
        nees_left: the same of what is left of both without the camera's calibration, whose error a scene draws once.
        inside: whether the truth is among the hypotheses.
        until_said: of each loss, how long it was not said [s].
        until_found: of each thing that came into the open, how long it took [s]; inf: never.
        confidence: (probability, right) of each claim.
        lines: what to look at.
    """

    counts: Counter[str] = field(default_factory=Counter)
    millimetres: list[float] = field(default_factory=list)
    degrees: list[float] = field(default_factory=list)
    nees: list[float] = field(default_factory=list)
    nees_left: list[float] = field(default_factory=list)
    inside: list[bool] = field(default_factory=list)
    until_said: list[float] = field(default_factory=list)
    until_found: list[float] = field(default_factory=list)
    confidence: list[tuple[float, bool]] = field(default_factory=list)
    lines: list[str] = field(default_factory=list)

    def merge(self, other: Tally) -> None:
        """Add another one's."""
        self.counts += other.counts
        for name in (
            "millimetres", "degrees", "nees", "nees_left", "inside", "until_said", "until_found", "confidence", "lines",
        ):  # fmt: skip
            getattr(self, name).extend(getattr(other, name))


@dataclass(frozen=True)
class _Claim:
    """One reported object in the camera's frame."""

    track: int
    asset: str
    probability: float
    found: bool
    R: Array
    p: Array
    covariance: Array
    others: list[tuple[Array, Array]]


def _claims(row: dict[str, Any], truth: Truth) -> list[_Claim]:
    """Return what a line of `objects.jsonl` claims, in the camera's frame."""
    turn, place = truth.R_WC.T, truth.p_WC
    both = np.kron(np.eye(2), turn)
    claims = []
    for one in row["objects"]:
        if one["asset"] is None or one["status"] in ("lost", "gone", "unseen") or one["probability"] < SURE:
            continue
        poses = [(one["q_WO"], one["p_WO"]), *((h["q_WO"], h["p_WO"]) for h in one["hypotheses"])]
        moved = [(turn @ rotations.matrix(np.array(q)), turn @ (np.array(p) - place)) for q, p in poses]
        claims.append(
            _Claim(
                one["track"], one["asset"], one["probability"], one["status"] != "stale", *moved[0],
                both @ np.array(one["covariance"]) @ both.T, moved[1:],
            )
        )  # fmt: skip
    return claims


def apart(A: Array, B: Array, symmetric: bool) -> float:
    """Return the angle between two turns, up to any about O's z axis [rad]."""
    if symmetric:
        return float(np.arccos(np.clip(A[:, 2] @ B[:, 2], -1.0, 1.0)))
    return float(np.linalg.norm(rotations.log(rotations.from_matrix(A.T @ B))))


def _error(claim: _Claim, R: Array, p: Array, symmetric: bool) -> Array:
    """Return (6,) what takes a claim to the truth, without a turn that cannot be told."""
    error = np.concatenate([rotations.log(rotations.from_matrix(R @ claim.R.T)), p - claim.p])
    if symmetric:
        axis = np.cross(claim.R[:, 2], R[:, 2])
        error[:3] = apart(claim.R, R, True) * axis / max(float(np.linalg.norm(axis)), 1e-12)
    return error


def _squared(claim: _Claim, R: Array, p: Array, symmetric: bool) -> float:
    """Return the squared error over what is claimed; a turn that cannot be told does not count."""
    error = _error(claim, R, p, symmetric)
    return float(error @ np.linalg.solve(claim.covariance, error))


def _squared_left(claim: _Claim, R: Array, p: Array, symmetric: bool, truth: Truth) -> float:
    """Return the squared error over what is claimed, both without what the camera's calibration makes of them.

    All poses of a scene share that: of a few scenes, the squared errors are mostly what was drawn for their cameras.
    """
    error, covariance, told = _error(claim, R, p, symmetric), claim.covariance, truth.told
    if told is not None:
        p_W = truth.R_WC @ claim.p + truth.p_WC
        view = ((p_W - told.p_WC) @ told.R_WC)[None], told.R_WC, told.fx, told.fy
        into_C = np.kron(np.eye(2), truth.R_WC.T)
        error = error + into_C @ (pose_shifts(*view)[0] @ truth.calibration)
        covariance = covariance - into_C @ shared_covariances(REAL, *view)[0] @ into_C.T
    if symmetric:
        error[:3] -= claim.R[:, 2] * (claim.R[:, 2] @ error[:3])
    return float(error @ np.linalg.solve(covariance, error))


def score(objects: Path, script: Script, truth: Truth, origins: dict[str, Array], label: str) -> Tally:
    """Compare `objects.jsonl` with the truth.

    Args:
        objects: the file.
        script: who was where.
        truth: of the frames.
        origins: where each asset's O is in its thing's frame [m].
        label: of the scene, for what is worth a look.
    """
    tally = Tally()
    actors = script.actors
    names = [one.kind.asset.name for one in actors]
    p_true = truth.p + np.einsum("fkij,kj->fki", truth.R, np.array([origins.get(n, np.zeros(3)) for n in names]))
    who: dict[int, int] = {}
    right = np.zeros(truth.seen.shape, dtype=bool)
    astray = np.zeros(truth.seen.shape, dtype=bool)
    for f, line in enumerate(objects.read_text().splitlines()):
        tally.counts["frames"] += 1
        claims = _claims(json.loads(line), truth)
        for asset in sorted({one.asset for one in claims}):
            mine = [one for one in claims if one.asset == asset]
            there = [k for k, a in enumerate(actors) if names[k] == asset and a.known]
            cost = np.array([[np.linalg.norm(c.p - p_true[f, k]) for k in there] for c in mine])
            of = dict(zip(*linear_sum_assignment(cost), strict=True)) if there else {}
            for j, claim in enumerate(mine):
                k = there[of[j]] if j in of else None
                off = np.inf if k is None else float(cost[j, of[j]])
                if claim.found:
                    _count(tally, claim, k, off, f, p_true, truth, actors, who, right, astray, label)
    _times(tally, truth, actors, right, astray, names, label)
    return tally


def _count(
    tally: Tally, claim: _Claim, k: int | None, off: float, f: int, p_true: Array, truth: Truth, actors: Any,
    who: dict[int, int], right: npt.NDArray[np.bool_], astray: npt.NDArray[np.bool_], label: str,
) -> None:  # fmt: skip
    """Count one claim of a frame."""
    tally.counts["claims"] += 1
    names = [one.kind.asset.name for one in actors]
    if k is None or off > NEAR:
        others = np.linalg.norm(p_true[f] - claim.p, axis=1)
        # A thing that was seen well and now is not may be where it was last: that is no mistake yet.
        hidden = k is not None and truth.seen[f, k] < OPEN
        there = names[int(np.argmin(others))] if others.min() < NEAR else ""
        kind = "hidden" if hidden else ("wrong object" if there else ("invented" if k is None else "left behind"))
        tally.counts[kind] += 1
        if k is not None and not hidden:
            astray[f, k] = True
        tally.confidence.append((claim.probability, False))
        if not hidden:
            tally.lines.append(
                f"{label} frame {f}: {claim.asset} {kind} {there}, {off * 1e3:.0f} mm off, p {claim.probability:.2f}"
            )
        return
    symmetric = actors[k].kind.symmetric == "z"
    angle = apart(claim.R, truth.R[f, k], symmetric)
    if who.setdefault(claim.track, k) != k:
        tally.counts["swap"] += 1
        tally.lines.append(f"{label} frame {f}: track {claim.track}, {claim.asset}, is another one's now")
        who[claim.track] = k
    if truth.seen[f, k] < OPEN:
        return
    flip = angle > FLIPPED
    right[f, k] = not flip
    tally.confidence.append((claim.probability, not bool(flip)))
    true = truth.R[f, k], p_true[f, k], symmetric
    squared = [_squared(replace(claim, R=R, p=p), *true) for R, p in [(claim.R, claim.p), *claim.others]]
    tally.inside.append(bool(min(squared) < HELD))
    if flip:
        tally.counts["flip"] += 1
        astray[f, k] = True
        tally.lines.append(
            f"{label} frame {f}: {claim.asset} flipped by {np.degrees(angle):.0f}°, seen {truth.seen[f, k]:.0%}"
            f"{' carried' if truth.carried[f, k] else ''}, p {claim.probability:.2f}"
        )
        return
    tally.millimetres.append(1e3 * off)
    tally.degrees.append(float(np.degrees(angle)))
    tally.nees.append(squared[0] / (5 if symmetric else 6))
    tally.nees_left.append(_squared_left(claim, *true, truth) / (5 if symmetric else 6))


def _times(
    tally: Tally, truth: Truth, actors: Any, right: npt.NDArray[np.bool_], astray: npt.NDArray[np.bool_],
    names: list[str], label: str,
) -> None:  # fmt: skip
    """Add how long losses went unsaid, and how long things in the open took to be found."""
    for k, actor in enumerate(actors):
        if not actor.known:
            continue
        should = truth.seen[:, k] >= OPEN
        for begin, end in _runs(should):
            found = np.flatnonzero(right[begin:end, k])
            wait = PERIOD * found[0] if len(found) else np.inf
            if len(found) or PERIOD * (end - begin) > REGAINED:
                tally.until_found.append(float(wait))
                if wait > REGAINED:
                    tally.lines.append(
                        f"{label} frames {begin} to {end}: {names[k]} in the open, found after {wait:.1f} s"
                    )
        tally.counts["open"] += int(should.sum())
        tally.counts["open and right"] += int((should & right[:, k]).sum())
        tally.until_said += [PERIOD * (end - begin) for begin, end in _runs(astray[:, k])]


def _runs(flags: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return begin and end of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
