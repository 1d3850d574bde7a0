"""Sphinx: `make docs` builds these pages, with every warning an error."""

import dataclasses
import functools
import importlib
import inspect
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from docutils import nodes
from docutils.statemachine import StringList
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

sys.path.insert(0, str(Path(__file__).parents[1]))
import auv_gym

project = "auv_gym"
author = "auv_gym contributors"
version = release = auv_gym.__version__
extensions = ["myst_parser"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = f"{project} {version}"
html_static_path = ["_static"]
html_css_files = ["tables.css"]
html_math_renderer = "mathml"  # what browsers draw themselves: no script, no network
exclude_patterns = ["_build"]

PROPERTIES = (property, functools.cached_property)


class ModuleReference(SphinxDirective):
    """The public names of a module, from its docstrings, which are Markdown."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the parsed documentation."""
        module = importlib.import_module(self.arguments[0])
        text = f"```{{py:module}} {module.__name__}\n```\n\n{markdown(module)}\n\n"
        text += "\n\n".join(entry(name, value, module) for name, value in members(module))
        box = nodes.container()
        self.state.nested_parse(StringList(text.splitlines(), source=module.__name__), 0, box)
        return list(box.children)


def members(module: ModuleType) -> list[tuple[str, Any]]:
    """Return the documented public functions, classes and exceptions that the module itself defines."""
    found = [(name, value) for name, value in vars(module).items() if not name.startswith("_")]
    found = [(name, value) for name, value in found if inspect.isclass(value) or inspect.isfunction(value)]
    return [(name, value) for name, value in found if value.__module__ == module.__name__ and value.__doc__]


def entry(name: str, value: Any, owner: Any) -> str:
    """Return a function, method, property or class as a directive of Sphinx's Python domain."""
    if isinstance(value, PROPERTIES):
        return f"````{{py:property}} {name}\n{markdown(value)}\n````"
    if not inspect.isclass(value):
        kind = "py:method" if inspect.isclass(owner) else "py:function"
        value = getattr(value, "__func__", value)  # of a class method
        return f"````{{{kind}}} {name}{signature(value)}\n{markdown(value)}\n````"
    parts = [(n, m) for n, m in vars(value).items() if not n.startswith("_") and m.__doc__]
    parts = [(n, m) for n, m in parts if inspect.isroutine(m) or isinstance(m, PROPERTIES)]
    inner = "\n\n".join(entry(n, m, value) for n, m in parts)
    kind = "py:exception" if issubclass(value, Exception) else "py:class"
    plain = fields(value) or issubclass(value, Exception) or getattr(value, "_is_protocol", False)
    heading = name if plain else name + signature(value)
    return f"`````{{{kind}}} {heading}\n{markdown(value)}\n\n{fields(value)}\n\n{inner}\n`````"


def signature(value: Any) -> str:
    """Return the names and defaults of the arguments."""
    arguments = [p.replace(annotation=p.empty) for p in inspect.signature(value).parameters.values()]
    return re.sub(r"<[^>]*>", "...", str(inspect.Signature(a for a in arguments if a.name not in ("self", "cls"))))


def fields(value: Any) -> str:
    """Return the fields of a dataclass or named tuple as they stand in its source, units included."""
    if not (dataclasses.is_dataclass(value) or hasattr(value, "_fields")):
        return ""
    lines = [line.strip() for line in inspect.getsource(value).splitlines()]
    known = [field.name for field in dataclasses.fields(value)] if dataclasses.is_dataclass(value) else value._fields
    kept = [line for line in lines if line.split(":")[0] in known]
    return "```python\n" + "\n".join(kept) + "\n```"


def markdown(value: Any) -> str:
    """Return the docstring with its headings as bold lines and its sections (Args, Raises, ...) as lists."""
    lines, section = [], False
    for line in (inspect.getdoc(value) or "").splitlines():
        if match := re.fullmatch(r"#+ (.*)", line):
            lines.append(f"\n**{match[1]}**\n")
        elif match := re.fullmatch(r"(Args|Returns|Raises|Attributes):", line):
            section = True
            lines.append(f"\n**{match[1]}**\n")
        elif section and re.match(r"    \w.*", line):
            lines.append("- " + re.sub(r"^(\w+):", r"`\1`:", line.strip()))
        else:
            section = section and (line.startswith(" ") or not line)
            lines.append(line)
    return "\n".join(lines)


def inside(_app: Sphinx, _name: str, source: list[str]) -> None:
    """Let links that lead out of this folder where it is read as plain files stay inside it."""
    source[0] = source[0].replace("](../CONTRIBUTING.md)", "](contributing.md)")


def formula(translator: Any, node: nodes.Element) -> None:
    """Write a formula as MathML."""
    block = isinstance(node, nodes.math_block)
    text = tex2mathml(node.astext(), as_block=block)
    translator.body.append(f"<p>{text}</p>" if block else text)
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Add the directive, the hook and the formulas."""
    app.add_html_math_renderer("mathml", (formula, None), (formula, None))
    app.add_directive("module-reference", ModuleReference)
    app.connect("source-read", inside)
