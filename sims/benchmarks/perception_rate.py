"""How often the whole of perception can run: eight things on a table, two of them alike, one unknown to the library.

    OMP_NUM_THREADS=1 python sims/benchmarks/perception_rate.py --profile d435 --frames 60

Frames are ray-cast at 15 Hz from a metre away; no arm is in view. A frame's time is the processor's, of labels,
tracking, search, further instances and unknown things together; the first frames, in which all is found, are apart.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from pose_truth import eight, spoil
from real_data import DATA, need
from threadpoolctl import threadpool_limits

from twin_diagram import scenario
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.slots import Slot
from twin_diagram.perception.registration.view import Known
from twin_diagram.perception.registration.whole_image import ImageSettings, OtherMemory, advance
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.perception.things.memory import Life


def main() -> None:
    """Track and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--profile", choices=spoil.PROFILES, default="d435")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    need("ycb")
    rng = np.random.default_rng(args.seed)
    scene = eight.Scene.drawn(DATA, args.profile, rng)
    settings, perception = scenario.Registration(), scenario.Perception(workspace=eight.WORKSPACE)
    clouds = [ModelCloud.of(one.asset, settings.model_points) for one, _, _ in scene.things[: eight.KNOWN]]
    told = ImageSettings(tuple(map(Known.of, clouds)), settings, perception.smallest, scenario.Slots(), Life(1.0, 5.0))
    slots, beside, spent = [Slot()] * eight.KNOWN, OtherMemory.empty(told), []
    grid = Grid.of(scene.camera, perception.stride)
    for k, (rgb, depth) in enumerate(scene.frames(args.profile, args.frames, rng)):
        with threadpool_limits(1):
            begin = time.process_time()
            outcome = advance(slots, beside, segment(rgb, depth, k / 15.0, grid, perception), told)
            spent.append(1e3 * (time.process_time() - begin))
        slots, beside = outcome.slots, outcome.beside
    tracked = sum(one.quality > 0 for one in outcome.poses) + sum(bool(one.identity) for one in beside.further)
    unknown = sum(bool(one.thing.identity) for one in beside.things)
    off = [1e3 * np.linalg.norm(slot.p - p) for slot, (_, _, p) in zip(slots, scene.things, strict=False)]
    print(f"{args.profile}, seed {args.seed}: {tracked} objects of 7 tracked, {unknown} unknown things of 1", end="; ")
    print("first instances off by " + " ".join(f"{one:.1f}" for one in off) + " mm")
    for name, part in (("first half", spent[: len(spent) // 2]), ("second half", spent[len(spent) // 2 :])):
        middle, slow = np.median(part), np.quantile(part, 0.95)
        print(f"{name}: median {middle:.0f} ms ({1e3 / middle:.1f} Hz), p95 {slow:.0f} ms ({1e3 / slow:.1f} Hz)")


if __name__ == "__main__":
    main()
