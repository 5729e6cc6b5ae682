"""Settings of the documentation site: ``make docs`` writes it to ``build/site``, without network.

Sphinx reads from the root of the repository, so that the links between the pages are the same on the site and wherever
the repository is shown.
"""

import os
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "_extensions"), str(HERE.parent), str(HERE.parent / "agents")]

from repository_links import place_in_source  # noqa: E402

from hydro_env import __version__  # noqa: E402  (needs the path above)

project = "hydro_env"
author = "hydro_env contributors"
version = release = __version__
project_copyright = "hydro_env contributors, MIT licence"

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.linkcode",
    "sphinx.ext.napoleon",
    "docstrings",
    "mathml",
    "page_parts",
    "repository_links",
    "search_from_disk",
]
root_doc = "docs/index"
include_patterns = ["docs/**.md", "agents/hydro_agents/pretrained/*.md", "CONTRIBUTING.md", "CHANGELOG.md"]
exclude_patterns = [
    ".*",
    "build",
    "dist",
    "results",
    "hydro_env",
    "tests",
    "configs",
    "benchmarks",
    "challenge",
    "paper",
]
nitpicky = True

# The notebooks run while the site is built; an error in one ends the build.
os.environ["PYTHONPATH"] = os.pathsep.join([str(HERE.parent), str(HERE.parent / "agents")])
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 600
nb_output_stderr = "remove"  # the notice that something is compiled

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath", "attrs_inline", "attrs_block"]
myst_heading_anchors = 4
myst_links_external_new_tab = False

autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False
add_module_names = False
python_use_unqualified_type_names = True

html_theme = "furo"
html_title = f"hydro_env {__version__}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_extra_path = ["_root"]  # index.html, which leads to the front page
html_copy_source = False
html_show_sphinx = False
html_math_renderer = "mathml"
html_theme_options = {"navigation_with_keys": True}
pygments_style = "friendly"
pygments_dark_style = "monokai"

linkcode_resolve = place_in_source
