"""Blocks and wires of a Diagram, with chosen sub-Diagrams opened up: what `svg` draws."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from pydrake.systems.framework import Diagram, InputPortIndex, OutputPortIndex, System

TRUTH = "truth."
"""What ports start with that only a simulated station has."""

Port = tuple[str, str]
"""A block's key and a port's name."""


@dataclass(frozen=True)
class Block:
    """One system.

    Attributes:
        key: its path in the Diagram, unique.
        name: the system's own name.
        kind: its class.
        parent: name of the opened Diagram that holds it; empty at the top.
        inputs: names of its input ports.
        outputs: names of its output ports.
    """

    key: str
    name: str
    kind: str
    parent: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


@dataclass(frozen=True)
class BlockGraph:
    """Blocks and wires, in the order of the Diagram."""

    blocks: tuple[Block, ...]
    wires: tuple[tuple[Port, Port], ...]

    @staticmethod
    def of(diagram: Diagram, opened: Collection[str] = ()) -> BlockGraph:
        """Read a Diagram.

        Args:
            diagram: the top-level Diagram.
            opened: names of its sub-Diagrams whose systems are shown in their place, one level deep.
        """
        reader = _Reader(frozenset(opened))
        reader.read(diagram, "")
        for system in diagram.GetSystems():
            if reader.opens(system):
                reader.read(system, system.get_name())
        # The connection map is ordered by address, which differs from run to run.
        return BlockGraph(tuple(reader.blocks), tuple(sorted(reader.wires)))


class _Reader:
    def __init__(self, opened: frozenset[str]) -> None:
        self._opened = opened
        self.blocks: list[Block] = []
        self.wires: list[tuple[Port, Port]] = []

    def opens(self, system: System) -> bool:
        return isinstance(system, Diagram) and system.get_name() in self._opened

    def read(self, diagram: Diagram, parent: str) -> None:
        for system in diagram.GetSystems():
            if parent or not self.opens(system):
                self.blocks.append(_block(system, parent))
        for (to_system, to_index), (from_system, from_index) in diagram.connection_map().items():
            source = self._source(from_system, from_index, parent)
            self.wires.extend((source, sink) for sink in self._sinks(to_system, to_index, parent))

    def _source(self, system: System, index: OutputPortIndex, parent: str) -> Port:
        if not parent and self.opens(system):
            inner, inner_index = system.get_output_port_locator(index)
            return _key(inner, system.get_name()), inner.get_output_port(inner_index).get_name()
        return _key(system, parent), system.get_output_port(index).get_name()

    def _sinks(self, system: System, index: InputPortIndex, parent: str) -> list[Port]:
        if not parent and self.opens(system):
            name = system.get_name()
            return [
                (_key(inner, name), inner.get_input_port(inner_index).get_name())
                for inner, inner_index in system.GetInputPortLocators(index)
            ]
        return [(_key(system, parent), system.get_input_port(index).get_name())]


def _key(system: System, parent: str) -> str:
    return f"{parent}/{system.get_name()}" if parent else str(system.get_name())


def _block(system: System, parent: str) -> Block:
    return Block(
        key=_key(system, parent),
        name=system.get_name(),
        kind=type(system).__name__,
        parent=parent,
        inputs=tuple(system.get_input_port(i).get_name() for i in range(system.num_input_ports())),
        outputs=tuple(system.get_output_port(i).get_name() for i in range(system.num_output_ports())),
    )
