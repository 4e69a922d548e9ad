"""The site: Sphinx, Furo, MyST, with warnings as errors, by ``make docs`` and by a test; needs the extra agents too."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # from_code, mathml

project = "probe-env"
html_title = "probe-env"
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "from_code",
    "mathml",
]

# Markdown: headings have the anchors that they have on a forge
myst_heading_anchors = 4
# $...$ and $$...$$ as a forge draws them
myst_enable_extensions = ["dollarmath"]
html_math_renderer = "mathml"

# API pages from docstrings, with types
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_member_order = "bysource"
autosummary_generate = False
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_attr_annotations = False
python_display_short_literal_types = True

# opens from disk; no external requests: no fonts, no scripts, no search summaries
html_theme = "furo"
html_static_path = html_css_files = ["site.css"]
html_show_copyright = False
html_show_search_summary = False
html_copy_source = False
html_permalinks_icon = "#"
