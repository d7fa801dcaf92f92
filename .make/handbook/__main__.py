"""Start with `python .make/handbook`: the folder above goes on the path, so that its modules import as `handbook.…`."""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parent.parent)

from handbook.command import main  # noqa: E402

sys.exit(main())
