"""Docstrings for autodoc in Markdown with Google's sections; comments after fields are their documentation.

autodoc reads docstrings as reStructuredText. Here Napoleon turns `Args:`, `Returns:` and `Raises:` into field lists,
and MyST parses the result as Markdown. On all pages, names of documented objects in backticks become links.
"""

import re
from typing import Any

from docutils import nodes
from docutils.utils import new_document
from myst_parser.parsers.sphinx_ import MystParser
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.ext.napoleon import Config, GoogleDocstring
from sphinx.pycode import ModuleAnalyzer
from sphinx.transforms import SphinxTransform
from sphinx.util.docutils import SphinxDirective

SECTIONS = Config(napoleon_use_rtype=False, napoleon_use_ivar=True)
FIELD = re.compile(r"^(    \w+: [^#\n]*?|\w+(?: =|: )[^#\n]*?(?=  # ))(?:  # (.*))?$", re.MULTILINE)
"""A field of a class, or a constant with a comment. autodoc documents it if the comment begins with `#:`."""
NAME = re.compile(r"(?:auv_gym|baselines)(?:\.\w+)*|[A-Z]\w*[a-z]\w*(?:\.\w+)?")
"""A name that can become a link: a full name, or the name of a class or of a member of it."""


class Markdown(SphinxDirective):
    """Markdown inside of reStructuredText."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Return the nodes that MyST parses from the content."""
        document = new_document(self.get_source_info()[0], self.state.document.settings)
        MystParser().parse("\n".join(self.content), document)
        for node in document.findall():
            node.document = self.state.document  # otherwise each docstring keeps a whole document in memory
        return list(document.children)


class Links(SphinxTransform):
    """Turns names in backticks into links; a name without a target stays unchanged."""

    default_priority = 400

    def apply(self, **_: Any) -> None:
        """Change the document."""
        for literal in list(self.document.findall(nodes.literal)):
            name = literal.astext().removesuffix("()")
            if isinstance(literal.parent, nodes.reference | nodes.title | addnodes.pending_xref):
                continue
            inside = enclosing(literal)
            if NAME.fullmatch(name) or (inside and re.fullmatch(r"[\w.]+", name)):
                link = addnodes.pending_xref("", refdomain="py", reftype="obj", reftarget=name, refexplicit=True)
                link.update_all_atts({**inside, "refdoc": self.env.docname})
                if NAME.fullmatch(name) and not name.startswith(("auv_gym", "baselines")):
                    link["refspecific"] = True  # search in all modules
                literal.replace_self(link)
                link += literal


def enclosing(node: nodes.Node) -> dict[str, str]:
    """Return the module and class of the object whose docstring contains a node; empty outside of docstrings."""
    while node is not None and not isinstance(node, addnodes.desc):
        node = node.parent
    if node is None or node.get("domain") != "py":
        return {}
    signature = node[0]
    own = signature["fullname"] if node["objtype"] in ("class", "exception") else signature["class"]
    return {"py:module": signature["module"], "py:class": own}


def docstring(_app: Sphinx, what: str, _name: str, _value: Any, _options: Any, lines: list[str]) -> None:
    """Wrap a docstring in the directive `markdown`; its headings become bold lines."""
    if what == "attribute" and not re.search(r"[`*|\\]|_\b", "\n".join(lines)):
        return  # plain text is the same in both markup languages
    text = lines if what in ("attribute", "data") else GoogleDocstring(lines, SECTIONS).lines()
    text = re.sub(r"^#+ (.*)$", r"**\1**\n", "\n".join(text), flags=re.MULTILINE).splitlines()
    lines[:] = [".. markdown::", "", *("   " + line for line in text), ""]


def document_fields(modules: list[str]) -> None:
    """Make autodoc document fields and constants with the comments after them, and fields without a comment too."""
    for name in modules:
        known = ModuleAnalyzer.for_module(name)
        marked = ModuleAnalyzer.for_string(FIELD.sub(r"\1  #: \2", known.code), name)
        known.find_attr_docs().update(marked.find_attr_docs())


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the directive, the transform and the event handler."""
    app.setup_extension("sphinx.ext.autodoc")
    app.add_directive("markdown", Markdown)
    app.add_transform(Links)
    app.connect("autodoc-process-docstring", docstring)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
