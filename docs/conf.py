"""Settings of the site: `make docs` builds it, and any warning ends the build."""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
sys.path.insert(0, str(Path(__file__).parent))

import reachlab

project = "reachlab"
author = "the authors of reachlab"
project_copyright = author
release = reachlab.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "builder"]
exclude_patterns = ["builder"]
default_role = "literal"
nitpicky = True
nitpick_ignore_regex = [
    # Other packages: their pages are not asked for, as the build needs no network.
    ("py:.*", r"(jax|jnp|np|numpy|mujoco|gymnasium|gym|spaces|collections|typing|pathlib|ml_dtypes)\b.*"),
    # Shapes and units behind the names of arguments, and names that are not public.
    ("py:.*", r"(?!reachlab\.).*"),
    ("py:.*", r"reachlab\.(?!(" + "|".join(reachlab.__all__) + r")$).*"),
]

myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_typehints_format = "short"
autodoc_class_signature = "separated"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False

html_theme = "furo"
html_title = f"reachlab {release}"
html_static_path = ["builder/static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
