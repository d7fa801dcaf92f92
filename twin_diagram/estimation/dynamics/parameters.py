"""The parameters θ that the filter learns, as a list of small blocks behind one interface.

Each block adds torque to the arm's equation of motion, linear in its parameters, relative to the model as given:
τ = rigid body + effects of the model + Σ Y_block(q, v, v̇) θ_block. A block brings its prior, its bounds and its names:
see `parameter_blocks`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from twin_diagram.errors import ScenarioError
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.dynamics.parameter_blocks import BLOCKS, ParameterBlock, PayloadBlock
from twin_diagram.scenario import Filter
from twin_diagram.signals.arrays import Array


class ParameterSet:
    """All blocks of a filter, stacked.

    Attributes:
        blocks: in the order of `Filter.parameters`.
        size: p.
        mean, covariance, scale: (p,), (p, p), (p,) of the prior.
        opening: (p, p) covariance after an abrupt change.
        freeable: (p,) which may be far from where their prior has them, as `opening` says.
        groups: the parameters that change together.
        payload: where the payload's (m, m·c) lie in θ; None where it is not learned.
    """

    def __init__(self, terms: ArmTerms, params: Filter) -> None:
        """Make the blocks.

        Raises:
            ScenarioError: a name that no block has, or one given twice.
        """
        self.blocks = [_make(name, params.parameters, terms, params) for name in params.parameters]
        ends = np.cumsum([0, *(block.size for block in self.blocks)])
        self.slices = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        self.size = int(ends[-1])
        self.mean = np.concatenate([np.zeros(0), *(block.mean for block in self.blocks)])
        self.covariance = self._diagonal([block.covariance for block in self.blocks])
        self.opening = self._diagonal([block.opening for block in self.blocks])
        self.freeable = self.opening.diagonal() > 2.0 * self.covariance.diagonal()
        self.scale = np.sqrt(np.diag(self.covariance))
        self.groups = [
            slice(part.start + group.start, part.start + group.stop)
            for block, part in zip(self.blocks, self.slices, strict=True)
            for group in block.groups()
        ]
        self.payload = next(
            (part for block, part in zip(self.blocks, self.slices, strict=True) if block.name == PayloadBlock.name),
            None,
        )

    def _diagonal(self, parts: list[Array]) -> Array:
        whole = np.zeros((self.size, self.size))
        for part, at in zip(parts, self.slices, strict=True):
            whole[at, at] = part
        return whole

    def labels(self, joints: Sequence[str]) -> list[str]:
        """Return (p,) names with units."""
        return [label for block in self.blocks for label in block.labels(joints)]

    def regressor(
        self, terms: ArmTerms, q: Array, v: Array, a: Array, tau: Array, sliding: Array | None = None
    ) -> Array:
        """Return Y (n, p) of all blocks.

        Args:
            terms: the arm.
            q: (n,) [rad].
            v: (n,) [rad/s].
            a: (n,) [rad/s²].
            tau: (n,) motor torque [N·m].
            sliding: (n,) how sure it is that a joint slides, and which way, from 0 to 1: by so much its friction
                counts. None: all do.
        """
        Y = np.empty((terms.n, self.size))
        for block, part in zip(self.blocks, self.slices, strict=True):
            Y[:, part] = block.regressor(terms, q, v, a, tau)
            if sliding is not None and block.of_sliding:
                Y[:, part] *= sliding[:, None]
        return Y

    def payload_of(self, theta: Array) -> Array:
        """Return (4,) mass [kg] and first moment [kg·m]; zeros where no payload is learned."""
        return theta[self.payload] if self.payload is not None else np.zeros(4)

    def push(self, theta: Array, tau: Array) -> Array | float:
        """Return the torque (n,) that θ adds to the motors', of which τ is measured [N·m]."""
        return sum(block.push(theta[part], tau) for block, part in zip(self.blocks, self.slices, strict=True))

    def viscous(self, theta: Array, damping: Array) -> Array:
        """Return viscous friction (n,) of the plant, `damping`, and θ together; never negative [N·m·s/rad]."""
        total = sum((block.viscous(theta[part]) for block, part in zip(self.blocks, self.slices, strict=True)), damping)
        return np.maximum(total, 0.0)

    def dry(self, theta: Array) -> Array | float:
        """Return what θ adds to the level of dry friction (n,) [N·m]."""
        return sum(block.dry(theta[part]) for block, part in zip(self.blocks, self.slices, strict=True))

    def clip(self, theta: Array) -> None:
        """Move θ (p,) into its bounds, in place."""
        for block, part in zip(self.blocks, self.slices, strict=True):
            block.clip(theta[part])


def _make(name: str, names: Sequence[str], terms: ArmTerms, params: Filter) -> ParameterBlock:
    if name not in BLOCKS or list(names).count(name) > 1:
        why = "given twice" if name in BLOCKS else f"none of {', '.join(BLOCKS)}"
        raise ScenarioError("twin.filter.parameters", f"{name!r} is {why}")
    return BLOCKS[name](terms, params)
