"""Follows eight things that are carried, taken away, brought back and hidden, by the command `track`, beside the truth.

    python sims/benchmarks/followed_scenes.py --first 0 --count 4 --profile d435
    python sims/benchmarks/followed_scenes.py --count 84 --out out/followed_scenes     (10,080 frames; resumable)
    python sims/benchmarks/followed_scenes.py --first 0 --shrink 2 --seconds 2         (pictures of 320 × 240, 30 each)

Two of the eight are alike, one is in no library. A folder of frames (8 s at 15 Hz) and a library built from meshes are
all that the tracker gets; its camera has calibration errors (5 mm / 0.5°, focal 0.3 %, centre 1 pixel, depth 1 %)
unless the profile is `ideal`. Poses are scored in W. Printed: wrong objects, inventions, flips, swaps
per 1,000 frames, how soon losses are said and things in the open found, errors, squared errors over claims, and how
often claims of a probability are right. What other code left under `--out` is not read. Seeds from 100000 are held
back. Needs the YCB meshes.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

SIMS = Path(__file__).resolve().parent
sys.path[:0] = [str(SIMS), str(SIMS.parents[1])]

import result_lines  # noqa: E402
from pose_truth import spoil  # noqa: E402
from real_data import DATA, need  # noqa: E402
from scene_truth import library, tallies  # noqa: E402
from scene_truth.film import film  # noqa: E402
from scene_truth.script import drawn  # noqa: E402

from twin_diagram.runs.tracking.track_frames import track_frames  # noqa: E402

SECONDS = 8.0


def run_one(out: Path, profile: str, seed: int, shrink: int, seconds: float) -> tuple[tallies.Tally, float]:
    """Film a scene, follow it, and return what came of it and the seconds a frame that following took."""
    rng = np.random.default_rng([seed, 15])
    script = drawn(DATA, rng, SECONDS)
    with tempfile.TemporaryDirectory() as aside:
        known = [one.kind.asset.name for one in script.actors if one.known]
        origins = library.built(Path(aside) / "library", out / "assets", known, DATA)
        truth = film(Path(aside) / "frames", script, profile, profile != "ideal", seconds, rng, shrink)
        begin = time.process_time()
        track_frames(Path(aside) / "library", Path(aside) / "frames", Path(aside) / "found", say=lambda text: None)
        spent = (time.process_time() - begin) / len(truth.seen)
        found = Path(aside) / "found" / "objects.jsonl"
        return tallies.score(found, script, truth, origins, f"{profile} seed {seed}"), spent


def report(profile: str, tally: tallies.Tally, seconds: list[float]) -> None:
    """Print a profile's figures."""
    counts = tally.counts
    frames = counts["frames"]
    kinds = ("wrong object", "invented", "flip", "swap")
    print(f"{profile}: {frames} frames, {counts['claims']} claims, {np.mean(seconds):.2f} s a frame")
    print(
        "   per 1,000 frames: " + ", ".join(f"{k} {1e3 * counts[k] / frames:.1f}" for k in kinds) + "  (aim ≤ 1 in all)"
    )
    said, found = np.array(tally.until_said), np.array(tally.until_found)
    if len(said):
        soon = np.mean(said <= tallies.LATE)
        print(f"   things in the open lost or flipped: {len(said)} times, {soon:.1%} for 0.5 s at most")
    share = np.mean(found <= tallies.REGAINED)
    print(f"   came into the open: {len(found)} times, found within 1 s {share:.1%} (aim ≥ 98 %)", end=", ")
    print(f"of all the time in the open known {counts['open and right'] / max(counts['open'], 1):.1%}")
    mm, deg = np.array(tally.millimetres), np.array(tally.degrees)
    print(f"   off: median {np.median(mm):.2f} mm {np.median(deg):.2f}°, p95 {np.quantile(mm, 0.95):.1f} mm", end=" ")
    print(f"{np.quantile(deg, 0.95):.1f}°; NEES {np.mean(tally.nees):.2f}, median {np.median(tally.nees):.2f}", end="")
    print(f" (aim 0.5 to 1.5); truth among hypotheses {np.mean(tally.inside):.1%} (aim ≥ 98 %)")
    print(f"   NEES without the camera's calibration, drawn once a scene: {np.mean(tally.nees_left):.2f}", end=", ")
    print(f"median {np.median(tally.nees_left):.2f}")
    p, ok = np.array(tally.confidence).T
    for low, high in ((0.5, 0.7), (0.7, 0.9), (0.9, 0.97), (0.97, 1.01)):
        of = (p >= low) & (p < high)
        if of.any():
            print(f"   claims with probability {low:.2f} to {min(high, 1):.2f}: {of.sum()}, right {ok[of].mean():.1%}")


def main() -> None:
    """Run what is not there yet and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=100_000, help="first seed; smaller ones are for training")
    parser.add_argument("--count", type=int, default=4)
    parser.add_argument("--profile", nargs="+", choices=spoil.PROFILES, default=["d435"])
    parser.add_argument("--shrink", type=int, default=1, help="pictures so many times smaller than 640 × 480")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of each scene that are filmed, from its start")
    parser.add_argument("--out", type=Path, default=Path("out/followed_scenes"))
    parser.add_argument("--verbose", action="store_true", help="print each mistake")
    args = parser.parse_args()
    need("ycb")
    out = args.out / result_lines.code()
    for profile in args.profile:
        whole, seconds = tallies.Tally(), []
        for seed in range(args.first, args.first + args.count):
            part = "" if (args.shrink, args.seconds) == (1, SECONDS) else f"_{args.shrink}_{args.seconds:g}"
            kept = out / f"{profile}_{seed}{part}.json"
            if not kept.exists():
                done = run_one(out, profile, seed, args.shrink, args.seconds)
                kept.parent.mkdir(parents=True, exist_ok=True)
                kept.write_text(json.dumps([vars(done[0]), done[1]]))
            of, spent = json.loads(kept.read_text())
            tally = tallies.Tally(**of | {"counts": Counter(of["counts"])})
            whole.merge(tally)
            seconds.append(spent)
            print(f"{profile} seed {seed}: {len(tally.lines)} to look at", file=sys.stderr, flush=True)
        if args.verbose:
            print("\n".join(whole.lines))
        report(profile, whole, seconds)


if __name__ == "__main__":
    main()
