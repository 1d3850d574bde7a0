"""Configuration of Sphinx; `make docs` builds the pages, and every warning is an error."""

import functools
import importlib
import inspect
import re
import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE / "_ext")]
import auv_gym  # noqa: E402
from auv_gym.scenarios.records import tomllib  # noqa: E402

project = "auv_gym"
author = project_copyright = "auv_gym contributors"
version = release = auv_gym.__version__
extensions = [
    "live_page",
    "markdown_docstrings",
    "module_pages",
    "myst_parser",
    "paper_figures",
    "scenario_pages",
    "search",
    "sphinx.ext.autodoc",
    "sphinx.ext.linkcode",
    "sphinx_copybutton",
    "sphinx_design",
    "videos",
]
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # types and shapes are in the docstrings
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 88
myst_enable_extensions = ["attrs_block", "attrs_inline", "colon_fence", "dollarmath", "fieldlist"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = f"{project} {version}"
html_static_path = ["_static"]
html_search_scorer = str(HERE / "_ext" / "scorer.js")
html_css_files = ["site.css"]
html_js_files = ["tables.js"]
html_math_renderer = "mathml"  # browsers render it without scripts or network
html_show_sourcelink = False
suppress_warnings = [
    "ref.python",  # several modules have a class of this name; the link points to the first
]


PROJECT = tomllib.loads((HERE.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def linkcode_resolve(_domain: str, info: dict[str, str]) -> str | None:
    """Return the URL of the source of a class or function; None for fields and constants."""
    try:
        value = functools.reduce(getattr, info["fullname"].split("."), importlib.import_module(info["module"]))
        value = inspect.unwrap(getattr(value, "fget", None) or getattr(value, "func", None) or value)
        lines, first = inspect.getsourcelines(value)
        file = Path(inspect.getsourcefile(value) or "").resolve().relative_to(HERE.parent).as_posix()
    except (AttributeError, TypeError, OSError, ValueError):
        return None
    return f"{PROJECT['urls']['Source']}/blob/main/{file}#L{first}-L{first + len(lines) - 1}"


def redirect_links(_app: Sphinx, _name: str, source: list[str]) -> None:
    """Redirect links to CONTRIBUTING.md, outside of this folder, to the copy of it on this site."""
    source[0] = re.sub(r"\]\(((?:\.\./)*)\.\./CONTRIBUTING\.md\)", r"](\1contributing.md)", source[0])


def write_formula(translator: Any, node: nodes.Element) -> None:
    """Write a formula as MathML."""
    block = isinstance(node, nodes.math_block)
    text = tex2mathml(node.astext(), as_block=block)
    translator.body.append(f'<div class="formula">{text}</div>' if block else text)
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Add the renderer of formulas, the language of tables and the event handler."""
    app.add_lexer("csv", TextLexer)
    app.add_html_math_renderer("mathml", (write_formula, None), (write_formula, None))
    app.connect("source-read", redirect_links)
