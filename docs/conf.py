"""The site: `make docs` builds it from these pages into `build/site`, self-contained."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "site"))

import mbocp

project = "mbocp"
author = "The mbocp developers"
copyright = f"2026, {author}"
version = release = mbocp.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
    "mathml",
    "pages",
    "docstrings",
]
root_doc = "index"
exclude_patterns = ["site/**"]
show_warning_types = True

html_theme = "furo"
html_title = "mbocp"
html_static_path = ["site/static"]
html_css_files = ["site.css"]
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#1f5fa8", "color-brand-content": "#1f5fa8"},
    "dark_css_variables": {"color-brand-primary": "#7fb2f0", "color-brand-content": "#7fb2f0"},
}
html_show_sphinx = False
html_copy_source = False
html_math_renderer = "mathml"
pygments_style = "tango"
pygments_dark_style = "monokai"
highlight_language = "none"  # of indented blocks: output, formulas, and keys

myst_enable_extensions = ["colon_fence", "html_admonition", "html_image"]
myst_heading_anchors = 6
myst_links_external_new_tab = False

copybutton_prompt_text = "$ "
copybutton_only_copy_prompt_lines = False

autodoc_typehints = "none"  # docstrings say types, shapes and units
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
