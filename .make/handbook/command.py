"""`make docs`: from the pages in `docs/` to HTML in `out/docs/html`, which needs no network to be made or read."""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from handbook import effect_pictures, made_parts, tutorials

CHECKOUT = Path(__file__).resolve().parent.parent.parent
DOCS = CHECKOUT / "docs"
FROM_OUTSIDE = re.compile(
    r"""(?:<script[^>]*\ssrc|<link[^>]*(?:stylesheet|preload|icon)[^>]*\shref|<link[^>]*\shref(?=[^>]*stylesheet)"""
    r"""|<img[^>]*\ssrc|@import|url\()\s*=?\s*["'(]?\s*(?:https?:)?//[^"')\s>]+""",
    re.IGNORECASE,
)
"""What a browser would fetch from elsewhere; links that a reader may follow are none of it."""


def main() -> int:
    """Build the pages; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=CHECKOUT / "out" / "docs", help="folder (default: %(default)s)")
    parser.add_argument("--no-tutorials", action="store_true", help="do not run the tutorials' cells")
    arguments = parser.parse_args()
    pages, html = arguments.out / "pages", arguments.out / "html"
    for folder in (pages, html):
        shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(DOCS, pages)
    wrong = write_tutorials(pages / "tutorials", run=not arguments.no_tutorials)
    for line in wrong:
        print(f"error: {line}", file=sys.stderr)
    effect_pictures.draw_all(pages / "pictures" / "effects")
    for page in pages.rglob("*.md"):
        page.write_text(made_parts.expand(page.read_text(encoding="utf-8")), encoding="utf-8")
    sphinx = [
        sys.executable,
        "-m",
        "sphinx",
        "-W",
        "--keep-going",
        "-q",
        "-b",
        "html",
        "-c",
        str(Path(__file__).parent),
    ]
    status = subprocess.run([*sphinx, str(pages), str(html)], check=False).returncode
    fetched = from_outside(html)
    for line in fetched:
        print(f"error: {line}", file=sys.stderr)
    if status or wrong or fetched:
        return status or 1
    print(f"see {html / 'index.html'}")
    return 0


def write_tutorials(folder: Path, *, run: bool) -> list[str]:
    """Give each tutorial its notebook and its pictures; return what its cells print otherwise than the page says.

    Args:
        folder: of the pages, which are changed.
        run: whether the cells are run.
    """
    wrong: list[str] = []
    for page in sorted(folder.glob("*.md")):
        text = page.read_text(encoding="utf-8")
        (folder / f"{page.stem}.ipynb").write_text(tutorials.notebook(text), encoding="utf-8")
        pictures = folder / page.stem
        pictures.mkdir()
        if run:
            print(f"running {page.name}", flush=True)
            with tempfile.TemporaryDirectory() as work:
                wrong += [f"{page.name}: {line}" for line in tutorials.check(text, Path(work), pictures)]
        text = tutorials.with_pictures(text, page.stem, {path.name for path in pictures.iterdir()})
        page.write_text(f"{text.rstrip()}\n\nThe same [as a notebook]({page.stem}.ipynb).\n", encoding="utf-8")
    return wrong


def from_outside(html: Path) -> list[str]:
    """Return a line for each thing that the built pages would load from a network."""
    found = []
    for path in sorted(html.rglob("*")):
        if path.suffix in (".html", ".css", ".js"):
            text = path.read_text(encoding="utf-8", errors="replace")
            found += [f"{path.relative_to(html)} loads {match.group(0)}" for match in FROM_OUTSIDE.finditer(text)]
    return found
