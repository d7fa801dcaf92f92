"""Eases what is set down onto what it is to stand on: on down until that presses back, then fingers open bit by bit.

What is let go in the air, leaning by a degree or two as hand and pictures are off, falls on an edge and rocks over
where its load leaves it 8° to stand by. Pressed on, and held ever less, it settles on its side between the pads.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np

from twin_diagram.runs.learning.cell import RELEASE, Cell
from twin_diagram.runs.learning.motion import Mover, NoWay
from twin_diagram.runs.learning.picking import go
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    speed: float = 0.08
    """Of the way down [m/s]."""

    deepest: float = 0.008
    """Farther down than planned that it is felt for [m]: the gap that is left, and twice what poses and sag are off."""

    step: float = 0.001
    """Between places at which it is felt for [m]: 10 N more once it stands, as stiff as an iiwa's driver is."""

    tick: float = 0.06
    """From one to the next [s]: 12 messages at 200 Hz tell a force to 0.2 N at 0.2 N·m of noise."""

    stands: float = 4.0
    """That presses back from which it stands [N]: what the arm's own weight changes by on the way is 1 N."""

    grazing: float = -0.003
    """Clearance of the hand's balls that is kept meanwhile [m]; see `setting_down`: they stand out by 13 mm."""

    loosened: tuple[float, ...] = (0.3, 0.15, 0.08, 0.04, 0.02)
    """Shares of the fingers' force, one after another: what 75 N hold, of 0.2 to 1.5 kg, slides from 20 to 1 N on."""

    each: float = 0.1
    """That each is kept [s]."""


TUNING = Tuning()


def release(mover: Mover, cell: Cell, line: Array, back: Array) -> Array:
    """Go down a line, let what is held stand there, open the fingers and go back.

    Args:
        mover: knows what is held.
        cell: whose arm holds it.
        line: (W, n) joint angles down to just over where it stands [rad].
        back: (M, n) of the way back from there.

    Returns:
        X_WT (4, 4) of the tool when the fingers opened.
    """
    with cell.about(RELEASE, mover.tool(line[-1])[:3, 3]):
        go(cell, mover.timed_line(line, TUNING.speed))
        cell.wait(0.2)
        _until_it_stands(mover, cell, line[-1])
        X_WT, force = mover.tool(cell.q), cell.force
        for share in TUNING.loosened:
            cell.grip(0.0, TUNING.each, share * force)
        cell.grip(1.0, force=force)
        mover.hold(None)
        go(cell, mover.timed_line(np.vstack([cell.commanded, back]), 2.0 * TUNING.speed))
    return X_WT


def _until_it_stands(mover: Mover, cell: Cell, q: Array) -> None:
    """Go on straight down from joint angles (n,) until what is held is pressed back, as far as the hand keeps clear."""
    X_WT, free = mover.tool(q), _felt(mover, cell, q)
    for deep in np.arange(TUNING.step, TUNING.deepest + 1e-9, TUNING.step):
        lower = X_WT.copy()
        lower[2, 3] -= deep
        with contextlib.suppress(NoWay):
            q_lower = mover.through(cell.commanded, [lower])[-1]
            if mover.bare_free(q_lower[None], TUNING.grazing, standing=True):
                if _felt(mover, cell, q_lower) - free < TUNING.stands:
                    continue
        return


def _felt(mover: Mover, cell: Cell, q: Array) -> float:
    """Go straight to joint angles (n,); return how hard the tool is pressed up on the way, but for the same always [N].

    The arm's own weight is in it, and what it holds: only differences of near places tell anything.
    """
    with cell.recording() as messages:
        cell.follow(np.array([0.0, TUNING.tick]), np.stack([cell.commanded, q]))
    J = mover.scene.chain.tool_jacobian(mover.scene.chain.place(q[None]))[0, 3:]
    return -float(np.linalg.lstsq(J.T, np.mean(messages.torque, axis=0), rcond=None)[0][2])
