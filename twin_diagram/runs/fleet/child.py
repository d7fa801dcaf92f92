"""`twin-diagram` as a fleet's child, which ends with its starter: `python -m twin_diagram.runs.fleet.child gap …`."""

from __future__ import annotations

import os
import signal
import sys
import threading


def end_with_parent() -> None:
    """End this process, and its group where it leads one, once standard input ends, which its starter holds open."""
    threading.Thread(target=_wait_for_the_end, daemon=True).start()


def _wait_for_the_end() -> None:
    # Not through sys.stdin: whoever holds its lock when the interpreter ends brings it down.
    while os.read(0, 4096):
        pass
    os.kill(0 if os.getpgrp() == os.getpid() else os.getpid(), signal.SIGKILL)


if __name__ == "__main__":
    end_with_parent()
    from twin_diagram.cli import main

    sys.exit(main())
