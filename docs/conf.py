"""The documentation site: ``make docs`` builds it in docs/_build."""

from __future__ import annotations

import inspect
import os
import re
from pathlib import Path
from typing import Any

import jackbox_env
from jackbox_env.env import JackInBoxEnv

HERE = Path(__file__).parent
os.environ.pop("MPLBACKEND", None)  # the notebooks draw inline
os.environ["PYTHONPATH"] = str(HERE.parent)  # they read agents/ too

project = "jackbox"
author = "The jackbox developers"
copyright = author
version = release = jackbox_env.__version__
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx-mathjax-offline",
]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = "jackbox"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_extra_path = ["accuracy/work_precision.html"]
html_show_sourcelink = False
html_theme_options = {"source_directory": "docs/"}

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

nb_execution_mode = "cache"
nb_execution_cache_path = str(HERE / "_build" / "notebooks")
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_class_signature = "mixed"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True


def environment_page() -> str:
    """The environment's page: its docstring, which is Markdown in the order of Gymnasium's own pages."""
    text = inspect.cleandoc(JackInBoxEnv.__doc__ or "").split("\nRaises:")[0]
    first, rest = text.split("\n", 1)
    example = re.compile(r"((?:^(?:>>>|\.\.\.) .*\n)+)(^\(\(.*\n)?", re.MULTILINE)
    rest = example.sub(lambda found: f"```pycon\n{found[0]}```\n", rest)
    picture = "![The chirp, a trained agent and a planner, from the same start](../jackbox.gif)"
    sketch = "![Box, jack, angles and signs](../sketch.svg)"
    return f"# JackInBox-v0\n\n{picture}\n\n{first}\n\n{sketch}\n{rest}"


def write_environment(app: Any) -> None:
    """Write the page where it has changed."""
    path = HERE / "generated" / "environment.md"
    path.parent.mkdir(exist_ok=True)
    if not path.exists() or path.read_text() != environment_page():
        path.write_text(environment_page())


def setup(app: Any) -> None:
    """Called by Sphinx."""
    app.connect("builder-inited", write_environment)
