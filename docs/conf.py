"""Configuration of the site, built by `make docs` and read without network access."""

import os
import sys
import warnings
from importlib import metadata
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))

# Programs of one site are compiled once and kept in a folder of the build. Most run once and compile faster without fusion.
# Later versions of XLA refuse the flag
if tuple(int(part) for part in metadata.version("jaxlib").split(".")[:2]) < (0, 11):
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false")
os.environ.setdefault("XDG_CACHE_HOME", str(HERE.parent / "build" / "docs-cache"))

from sphinx_gallery.sorting import ExplicitOrder  # noqa: E402

import docs_commands  # noqa: E402
import docs_results  # noqa: E402
from matcam.core.jax import use_compilation_cache  # noqa: E402

use_compilation_cache()

# Jobs of a run execute in this process, because a worker would compile its programs again. The files are the same
from matcam.batch.executors.local import ProcessExecutor  # noqa: E402
from matcam.batch.job import attempt  # noqa: E402

ProcessExecutor.outcomes = lambda self, jobs: (attempt(job) for job in jobs)

project = "matcam"
author = "The matcam authors"
copyright = "the matcam authors"  # noqa: A001
release = version = metadata.version("matcam")

extensions = [
    "sphinx.ext.mathjax",
    "myst_parser",
    "sphinx_design",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    "docs_site",
]
exclude_patterns = ["_ext", "_build", "reference/api.toml", "**/GALLERY_HEADER.rst"]
source_suffix = {".rst": "restructuredtext", ".md": "markdown"}
myst_enable_extensions = ["colon_fence", "dollarmath", "deflist", "attrs_inline"]
myst_heading_anchors = 3
default_role = "code"
smartquotes = False  # two dashes begin an option
nitpicky = True
suppress_warnings = ["config.cache"]  # sphinx-gallery's order is a function
python_maximum_signature_line_length = 88
toc_object_entries_show_parents = "hide"
add_module_names = False

WIDE = (
    "index",
    "glossary",
    "stand-ins",
    "capture",
    "exchange",
    "reference/messages",
    "reference/supported",
    "understand/trust",
    "validation/index",
    "validation/recovery",
    "validation/recovery-photographs",
    "validation/recovery-cases",
    *(f"validation/{name}" for name in docs_results.pages()),
    *(f"reference/commands/{docs_commands.file_of(words)}" for words in docs_commands.commands()),
)
"""Pages with wide tables, which have no list of their headings beside them."""
html_theme = "pydata_sphinx_theme"
html_title = "matcam"
html_static_path = ["_static"]
html_css_files = ["matcam.css"]
html_js_files = ["matcam.js"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "logo": {"text": "matcam"},
    "navbar_end": ["theme-switcher"],
    "navbar_persistent": ["search-button"],
    "navbar_align": "left",
    "secondary_sidebar_items": {"**": ["page-toc"]} | {page: [] for page in WIDE},
    "show_prev_next": True,
    "navigation_depth": 3,
    "show_nav_level": 1,
    "collapse_navigation": True,  # a sidebar with every name on every page would take most of the time of a build
    "header_links_before_dropdown": 9,
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
html_sidebars = {"changelog": [], "development/contributing": []}
mathjax_path = "tex-svg.js"  # one file with all its glyphs, copied from the installed package by docs_site
mathjax3_config = {"svg": {"fontCache": "global"}, "options": {"enableMenu": False}}
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True


THEMES = ("predict", "calibrate", "correct", "exchange")
sphinx_gallery_conf = {
    "examples_dirs": ["../examples/tutorials", "../examples/gallery"],
    "gallery_dirs": ["tutorials", "gallery"],
    "filename_pattern": r"\.py$",
    "ignore_pattern": r"/_",
    "subsection_order": ExplicitOrder(
        [f"../examples/gallery/{name}" for name in ("predict", "calibrate", "correct", "exchange")]
    ),
    "within_subsection_order": "FileNameSortKey",
    "download_all_examples": False,
    "remove_config_comments": True,
    "show_signature": False,
    "show_memory": False,
    "min_reported_time": 2,
    "write_computation_times": False,
    "abort_on_example_error": True,
    "image_scrapers": ("matplotlib", "docs_figures.scrape"),
    "thumbnail_size": (400, 280),
    "nested_sections": False,
}
warnings.filterwarnings("ignore", category=UserWarning, message="FigureCanvasAgg is non-interactive")
