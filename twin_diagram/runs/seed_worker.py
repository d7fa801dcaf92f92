"""The process of one run among many: `python -m twin_diagram.runs.seed_worker REQUEST`, the request in JSON.

It lives no longer than the one that started it: when its standard input ends, so does it.
"""

from __future__ import annotations

import json
import sys

from twin_diagram.runtime.child_process import BAD_INPUT, end_with_starter


def main(request: str) -> int:
    """Run what is asked; its summary lies in the run's folder."""
    end_with_starter()
    from twin_diagram.errors import TwinError
    from twin_diagram.model.effects.users_modules import import_again
    from twin_diagram.runs.many_seeds import run_one

    asked = json.loads(request)
    try:
        import_again(asked["modules"])
        run_one(tuple(asked["task"]))
    except TwinError as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        return BAD_INPUT
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
