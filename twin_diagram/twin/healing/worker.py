"""The process that looks for a gap beside a running loop: `python -m twin_diagram.twin.healing.worker FOLDER`.

It lives no longer than the one that started it: when its standard input ends, so does it.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

from twin_diagram.runtime.child_process import BAD_INPUT, end_with_starter
from twin_diagram.twin.healing.gap_process import REQUEST


def main(folder: Path) -> int:
    """Run the gap workflow as asked; its report appears in the folder once it is whole."""
    end_with_starter()
    request = json.loads((folder / REQUEST).read_text(encoding="utf-8"))
    if hasattr(os, "nice"):
        os.nice(request["nice"])
    from twin_diagram.errors import TwinError
    from twin_diagram.gap.workflow import run_gap
    from twin_diagram.model.effects.users_modules import import_again

    def say(text: str) -> None:
        print(text, flush=True)

    try:
        import_again(request["modules"])
        run_gap(request["model"], request["fit"], request["holdout"], folder, say, request["packages"])
    except TwinError as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        return BAD_INPUT
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
