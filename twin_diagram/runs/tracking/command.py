"""The command `twin-diagram track`. Cheap to import, as the command line is."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from twin_diagram.runtime.command_parser import add_command
from twin_diagram.runtime.progress import say_beside


def add_track_command(commands: Any) -> None:
    """Add the command that tracks objects through a folder of frames."""
    track = add_command(commands, "track", "follow a library's objects through a folder of RGB-D frames")
    track.add_argument("--library", required=True, type=Path, metavar="L", help="the folder of assets")
    track.add_argument("--frames", required=True, type=Path, metavar="F", help="a BOP scene folder")
    track.add_argument(
        "--out", required=True, type=Path, metavar="DIR", help="write poses.csv (BOP results) and objects.jsonl"
    )
    track.add_argument("--init", type=Path, metavar="CSV", help="poses in the first frame, laid out as poses.csv")
    track.add_argument(
        "--grow", type=Path, metavar="DIR", help="put unknown things seen from enough sides into this library"
    )
    track.add_argument(
        "--segmenter", type=Path, metavar="ONNX", help="a network that says which thing each pixel shows"
    )
    track.add_argument("--seed", type=int, default=0, help="of what is drawn (default: %(default)s)")
    track.set_defaults(command=_track)


def _track(arguments: argparse.Namespace) -> int:
    from twin_diagram.runs.tracking.track_frames import track_frames

    segmenter = None
    if arguments.segmenter is not None:
        from twin_diagram.perception.segmentation.learned import OnnxSegmenter

        segmenter = OnnxSegmenter(arguments.segmenter)
    places = arguments.library, arguments.frames, arguments.out, arguments.init
    track_frames(*places, arguments.seed, say_beside, arguments.grow, segmenter)
    return 0
