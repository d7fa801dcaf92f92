"""The process that looks for a gap beside a running loop: `python -m twin_diagram.twin.healing.worker FOLDER`.

It lives no longer than the one that started it: when its standard input ends, so does it.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from dataclasses import dataclass
from pathlib import Path

from twin_diagram.twin.healing.gap_process import REQUEST
from twin_diagram.twin.healing.gap_process import TUNING as GAP_PROCESS


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    orphaned: int = 3
    """Exit status where the starter is gone."""


TUNING = Tuning()


def main(folder: Path) -> int:
    """Run the gap workflow as asked; its report appears in the folder once it is whole."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    request = json.loads((folder / REQUEST).read_text(encoding="utf-8"))
    if hasattr(os, "nice"):
        os.nice(request["nice"])
    from twin_diagram.errors import TwinError
    from twin_diagram.gap.workflow import run_gap

    def say(text: str) -> None:
        print(text, flush=True)

    try:
        run_gap(request["model"], request["fit"], request["holdout"], folder, say, request["packages"])
    except TwinError as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        return GAP_PROCESS.bad_input
    return 0


def _end_with_parent() -> None:
    # Not through sys.stdin: whoever holds its lock when the interpreter ends brings it down.
    while os.read(0, 4096):
        pass
    os._exit(TUNING.orphaned)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
