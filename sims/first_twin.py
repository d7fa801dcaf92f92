"""The closed loop from Python: build it, run it, ask the twin what it believes.

python sims/first_twin.py
"""

from __future__ import annotations

import argparse

from pydrake.systems.analysis import Simulator

from twin_diagram import load_scenario, make_closed_loop
from twin_diagram.runs import beliefs


def main() -> None:
    """Run three seconds and print beliefs."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    scenario = load_scenario("tabletop", ["twin.task.start=0.5"])  # a name or a file; fields are overridden by name
    loop = make_closed_loop(scenario)  # station and twin in one Diagram: loop.diagram, loop.station, loop.twin.diagram
    simulator = Simulator(loop.diagram)
    simulator.AdvanceTo(3.0)

    belief = beliefs(loop, simulator.get_context())
    for name, entry in belief["objects"].items():
        x, y, z = entry["pose"][4:]
        print(f"{name:<12} {entry['status']:<8} at ({x:.3f}, {y:.3f}, {z:.3f}) m ± {entry['position_std_mm']:.1f} mm")
    mass = belief["parameters"]["payload.mass"]
    print(f"the hand carries {mass['value']:.2f} ± {mass['std']:.2f} kg that nobody told the twin of")


if __name__ == "__main__":
    main()
