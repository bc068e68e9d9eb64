"""Sphinx settings. The tables of the reference are written from eiwa's own models whenever the docs are built."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import generate  # noqa: E402  (lives beside this file)
from sphinx.util import logging  # noqa: E402

from eiwa.core.version import __version__  # noqa: E402

project = "eiwa"
author = "the eiwa developers"
project_copyright = f"2026, {author}"
release = version = __version__

extensions = ["myst_parser", "sphinx.ext.mathjax"]
myst_enable_extensions = ["amsmath", "deflist", "dollarmath"]
myst_heading_anchors = 3

exclude_patterns = ["_build", "*/_generated"]
html_theme = "furo"
html_title = f"eiwa {release}"
html_show_sphinx = False
nitpicky = True


def setup(app):
    """Write the generated tables; what the pages lack is a warning, and so an error under -W."""
    generate.write(HERE)
    for problem in generate.missing(HERE / "reference"):
        logging.getLogger(__name__).warning(problem)
