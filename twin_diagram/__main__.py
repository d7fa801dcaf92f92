"""``python -m twin_diagram`` is the command ``twin-diagram``."""

from __future__ import annotations

import sys

if __name__ == "__main__":
    from twin_diagram.cli import main

    sys.exit(main())
