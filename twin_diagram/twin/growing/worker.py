"""The process that builds an asset beside a running loop: `python -m twin_diagram.twin.growing.worker FOLDER`.

It lives no longer than the one that started it: when its standard input ends, so does it.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Final

from twin_diagram.runtime import atomic_file
from twin_diagram.runtime.child_process import BAD_INPUT, end_with_starter

PICTURES: Final = "pictures.npz"
"""In the folder: the growth."""
REQUEST: Final = "request.json"
"""In the folder: `name`, `library`, `nice`."""
ANSWER: Final = "grown.json"
"""In the folder, once the asset is whole: `folder`, `R_TO`, `p_TO`, `size`, `volume`, `notes`."""


def main(folder: Path) -> int:
    """Build the asset as asked; the answer appears in the folder once it is whole."""
    end_with_starter()
    request = json.loads((folder / REQUEST).read_text(encoding="utf-8"))
    if hasattr(os, "nice"):
        os.nice(request["nice"])
    from twin_diagram.assets.building.from_mesh import AssetPlace
    from twin_diagram.assets.building.growth_file import read_growth
    from twin_diagram.errors import TwinError

    try:
        grown = read_growth(folder / PICTURES).grown(AssetPlace(request["name"], request["library"]))
    except TwinError as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        return BAD_INPUT
    built = grown.built
    answer = {
        "folder": str(built.folder),
        "R_TO": grown.R_TO.tolist(),
        "p_TO": grown.p_TO.tolist(),
        "size": built.size.tolist(),
        "volume": built.volume,
        "notes": list(built.notes),
    }
    atomic_file.write(folder / ANSWER, json.dumps(answer, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
