"""Settings of the site: `make docs` builds it into build/site, without a network."""

import importlib.metadata

project = "goniotwin"
release = importlib.metadata.version("goniotwin")
copyright = "goniotwin's authors"

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]
myst_enable_extensions = ["dollarmath", "deflist", "attrs_block", "attrs_inline"]
myst_heading_anchors = 4

html_theme = "furo"
html_title = "goniotwin"
