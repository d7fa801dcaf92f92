"""Takes commands that nobody executes, so that every station has every input port."""

from __future__ import annotations

from collections.abc import Mapping

from pydrake.systems.framework import LeafSystem


class IgnoredCommands(LeafSystem):
    """Input ports and nothing behind them.

    .. pydrake_system::

        name: IgnoredCommands
        input_ports:
        - (as named)
    """

    def __init__(self, sizes: Mapping[str, int]) -> None:
        """`sizes` by port."""
        super().__init__()
        for name, size in sizes.items():
            self.DeclareVectorInputPort(name, size)
