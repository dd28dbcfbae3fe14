# SPDX-License-Identifier: Apache-2.0
"""The documentation as a site; `make site` builds it from the Markdown pages, which are readable without it."""

import os

import multilica

project = "multilica"
author = "the authors of multilica"
version = release = multilica.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["site"]

myst_heading_anchors = 4

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented_params"
autoclass_content = "class"
napoleon_use_param = True
napoleon_use_rtype = False
default_role = "code"
# What the public names use of other packages, and of this one without being public, has no page.
nitpick_ignore_regex = [("py:.*", r"(numpy|pd|collections|pathlib|typing|pydantic|multilica)\..+")]

html_theme = "pydata_sphinx_theme"
html_title = "multilica"
templates_path = ["templates"]
html_sidebars = {"**": ["pages"]}
html_static_path = ["style"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_show_copyright = False
html_copy_source = False
html_theme_options = {
    "navbar_start": ["navbar-logo"],
    "navbar_center": [],
    "navbar_end": ["theme-switcher"],
    "footer_start": [],
    "footer_end": [],
    "show_prev_next": False,
    "secondary_sidebar_items": ["page-toc"],
    "navigation_with_keys": False,
}

# Path on the server of the sites of all versions; a release has it (`.ci/release.py pages`), `make site` does not.
if _versions := os.environ.get("MULTILICA_SITE_BASE"):
    html_theme_options |= {
        "navbar_end": ["version-switcher", "theme-switcher"],
        "switcher": {"json_url": f"{_versions}versions.json", "version_match": release},
        "check_switcher": False,
    }
