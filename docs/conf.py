"""Settings of the site: `make docs` builds it into build/site, without a network."""

import importlib.metadata
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "extensions"))

project = "goniotwin"
release = importlib.metadata.version("goniotwin")
copyright = "goniotwin's authors"

source_address = ""
"""Where the repository's files are read, up to the path of a file. While it is empty, links to sources are plain paths."""

extensions = ["myst_parser", "sphinx.ext.autodoc", "reference", "diagrams", "sources"]
default_role = "code"
smartquotes = False  # would make a dash of the -- of an option
autodoc_typehints_format = "short"
maximum_signature_line_length = 100
autodoc_member_order = "bysource"
myst_enable_extensions = ["deflist", "attrs_block", "attrs_inline"]
myst_heading_anchors = 4
myst_fence_as_directive = ["mermaid"]
myst_links_external_new_tab = False

html_theme = "furo"
html_title = "goniotwin"
