"""The documentation site: ``make docs`` builds it in docs/_build."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

import jackbox_env

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
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx-mathjax-offline",
]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = "jackbox"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_theme_options = {"source_directory": "docs/"}

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

nb_execution_mode = "cache"
nb_execution_cache_path = str(HERE / "_build" / "notebooks")
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True
nb_output_stderr = "remove"  # that something is compiled

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_class_signature = "mixed"
_ALIASES = "Array", "ArrayLike", "Counts", "Flags", "Floats", "Indices", "Infos", "Numbers"
autodoc_type_aliases = {**{name: name for name in _ALIASES}, "Observation": "Floats"}
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = False  # attributes are entries of their own, which links find


def _plain(app, what, name, obj, options, signature, return_annotation):
    """Names of types without what Sphinx makes of them inside a union."""
    return tuple(
        text and re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text) for text in (signature, return_annotation)
    )


def _in_short(app, what, name, obj, options, lines):
    """Of the environment's docstring its first line; the rest is the page environment.md."""
    if name == "jackbox_env.JackInBoxEnv":
        lines[1:] = ["", "Its spaces, rewards and arguments are on its page, :doc:`/environment`."]


def _whole(app, what, name, obj, options, lines):
    """Put an empty comment first: else napoleon reads words before a colon as a property's type."""
    if what == "property":
        lines[:0] = ["..", ""]


def _copy_page(app, exception):
    """The page of ``jackbox play``, which the site shows in frames."""
    if exception or app.builder.format != "html":
        return
    from scripts.site.build import ensure_page

    shutil.copy(ensure_page(), app.outdir)


def setup(app):
    """Connect the above."""
    app.connect("autodoc-process-signature", _plain)
    app.connect("autodoc-process-docstring", _in_short)
    app.connect("autodoc-process-docstring", _whole, priority=100)  # before napoleon
    app.connect("build-finished", _copy_page)
