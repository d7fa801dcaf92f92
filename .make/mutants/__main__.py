"""Start with `python .make/mutants`: the folder above goes on the path, so that its modules import as `mutants.…`."""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parent.parent)

from mutants.command import main  # noqa: E402

sys.exit(main())
