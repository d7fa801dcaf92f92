"""Which parts of a run work in processes of their own, beside the simulator; its results are the same without them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from twin_diagram.runtime.threads import cores
from twin_diagram.station.sim.station import SimStation
from twin_diagram.twin.closed_loop import ClosedLoop


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    worthwhile: float = 5.0
    """In shorter runs only ways are searched for [s]: a process takes 3 s of a core to begin and saves 1 s in each."""


TUNING = Tuning()


@contextmanager
def helping_processes(loop: ClosedLoop, spare: bool = True) -> Iterator[None]:
    """Start what is worth a process of its own: it ends with the `with` statement.

    Ways are searched for where there is something to reach. Pictures are taken, and looked at where that has a latency,
    where the run is long and there is a core to spare; what does so has begun when this returns, so that no step of the
    run waits for it to load.

    Args:
        loop: what is to run.
        spare: whether other cores may be used: not where as many runs go on as there are cores.
    """
    plan, mpc, station = loop.scenario, loop.twin.mpc, loop.station
    begun: list[Callable[[], None]] = []
    with ExitStack() as stack:
        if mpc is not None and (plan.twin.task.steps or plan.twin.task.X_WG is not None):
            stack.enter_context(mpc.searching_beside(waits=plan.station != "lcm"))
        if spare and plan.duration >= TUNING.worthwhile and cores() > 1:
            if isinstance(station, SimStation):
                begun += stack.enter_context(station.pictures_beside())
            # A real arm must not wait for a process that hangs, and what stops it waits here, too.
            if plan.station != "lcm":
                begun.append(stack.enter_context(loop.twin.looking_beside()))
        for wait in begun:  # they begin at the same time
            wait()
        yield
