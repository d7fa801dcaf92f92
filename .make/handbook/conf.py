"""How Sphinx builds the handbook: Markdown in, HTML out that loads nothing from any network."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from twin_diagram.runtime.version import __version__

project = "twin_diagram"
release = version = __version__
html_title = f"twin_diagram {__version__}"
extensions = ["myst_parser", "handbook.mathml"]
myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3
html_math_renderer = "mathml"
html_theme = "furo"
html_static_path = [str(Path(__file__).resolve().parent / "style")]
html_css_files = ["handbook.css"]
html_copy_source = html_show_sourcelink = html_show_copyright = False
pygments_style = "friendly"
pygments_dark_style = "native"
