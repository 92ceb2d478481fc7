"""Sphinx configuration: sphinx-build -W docs docs/_build."""

from __future__ import annotations

import voluminous

project = "voluminous"
author = "The voluminous developers"
copyright = "the voluminous developers"
release = version = voluminous.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
myst_enable_extensions = ["amsmath", "dollarmath"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]
default_role = "py:obj"

autodoc_member_order = "bysource"
# numpydoc sections tell types, with shapes and units.
autodoc_typehints = "none"
napoleon_google_docstring = False
# Groups of the parameters of `render`.
napoleon_custom_sections = [
    (group, "params_style") for group in ("Accuracy", "Sampling", "Large data", "Extras")
]
napoleon_use_ivar = True
napoleon_use_param = False
napoleon_use_rtype = False

html_theme = "furo"
html_title = f"voluminous {version}"
html_static_path = ["_static"]
html_css_files = ["gallery.css"]
