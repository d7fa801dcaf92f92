"""Builds an asset from pictures and shows how it came about on one page: views, cloud, mesh, pieces, truth.

    python sims/reconstruct.py                      # a mug that is pictured here, twelve views
    python sims/reconstruct.py scans/mug --name mug # posed RGB-D frames (BOP, Nerfstudio) [--masks D] [--truth ASSET]

The asset is built as `twin-diagram assets build` builds it. `OUT/page.html` is one file and needs no network.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from asset_pictures.built_asset import asset_parts, cloud_part, views_part
from asset_pictures.page import write_page

from twin_diagram import TwinError
from twin_diagram.assets import Asset
from twin_diagram.assets.building import build_from_frames, posed_frames
from twin_diagram.scenario import models_dir


def pictured(folder: Path, views: int) -> tuple[Path, Path]:
    """Write pictures of the shipped mug, as a D415 takes them, poses 2 mm and 0.2° off; return them and the truth."""
    sys.path.append(str(Path(__file__).resolve().parent / "benchmarks"))
    from rendered_views import load, pictures, write_scene

    truth = models_dir() / "objects" / "mug"
    return write_scene(folder, pictures(load(truth), views)), truth


def reconstruct(arguments: argparse.Namespace) -> Path:
    """Build the asset and write the page."""
    source, truth, out = arguments.source, arguments.truth, arguments.out
    if source is None:
        source, truth = pictured(out / "frames", arguments.views)
    elif truth is not None:
        Asset.load(truth)  # what is wrong with it is said before the asset is built
    begin, said, library = time.process_time(), [], out / "library"
    built = build_from_frames(source, arguments.name, library, masks=arguments.masks, replace_it=True, say=print)
    said.append(f"{time.process_time() - begin:.1f} s of processor time. " + "; ".join(built.notes) + ".")
    frames = posed_frames(source, arguments.masks)
    parts = [views_part(frames), cloud_part(frames, str(source)), *asset_parts(built.folder, truth, said)]
    return write_page(out / "page.html", f"{arguments.name}, from {len(frames)} views", parts)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=Path, nargs="?", help="frames; without them, the shipped mug is pictured")
    parser.add_argument("--name", default="mug", help="of the asset (default: %(default)s)")
    parser.add_argument("--masks", type=Path, help="folder of masks")
    parser.add_argument("--truth", type=Path, help="an asset known to be true, shown beside it")
    parser.add_argument("--views", type=int, default=12, help="of the mug (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("out/reconstruct"), help="folder (default: %(default)s)")
    try:
        print(f"see {reconstruct(parser.parse_args())}")
    except TwinError as error:
        parser.exit(2, f"error: {error}\n")
