"""The reference from docstrings, in docs/api/: a page of public names for each package, a page for each module.

The pages are written before Sphinx looks for pages, and are not kept in git. Those of modules are not searched.
"""

import importlib
import inspect
import pkgutil
import re
from pathlib import Path
from typing import Any

from docutils import nodes
from markdown_docstrings import document_fields
from sphinx import addnodes
from sphinx.application import Sphinx

PACKAGES = ("auv_gym", "baselines")
KINDS = ("class", "function", "data")
"""Kinds of objects in the order in which a page has them."""
LONGEST_VALUE = 60  # characters of a constant's value that is shown


def modules(package: str, *, quick: bool) -> list[str]:
    """Return a package and all that is in it, by name, private modules left out; quick: what is directly in it."""
    path = importlib.import_module(package).__path__
    entries = pkgutil.iter_modules(path, f"{package}.") if quick else pkgutil.walk_packages(path, f"{package}.")
    return [package, *(entry.name for entry in entries if "._" not in entry.name)]


def first_line(name: str) -> str:
    """Return what a module's docstring begins with."""
    return (importlib.import_module(name).__doc__ or "").strip().split("\n\n")[0].replace("\n", " ")


def pages(package: str, found: list[str]) -> dict[str, str]:
    """Return the reference of a package: its own page, one for each module in it, one for each package in it."""
    packages = {name for name in found if hasattr(importlib.import_module(name), "__path__")}
    homes = {name: [name] for name in found if name in packages or name.count(".") == 1}
    for name in found:
        if name not in homes:
            homes[name.rpartition(".")[0]].append(name)
    texts = {
        home: "\n".join(["---\nnosearch: true\n---\n", f"# {home}\n", *(section(name, home) for name in inner)])
        for home, inner in homes.items()
    }
    texts[package] = f"# {package}\n\n{public_names(package)}\n## Modules\n\nWhat is not listed above is internal.\n"
    rows = [f"| [{home}]({home}.md) | {first_line(home)} |" for home in homes if home != package]
    table = "\n".join(["", "| module | what is in it |", "|---|---|", *rows])
    texts[package] += f"{table}\n\n```{{toctree}}\n:hidden:\n\n" + "\n".join(name for name in homes if name != package)
    texts[package] += "\n```\n"
    return texts


def section(name: str, home: str) -> str:
    """Return a module's part of a page, with a heading unless it is the page's own."""
    heading = "" if name == home else f"## {name.removeprefix(home + '.')}\n\n"
    return f"{heading}```{{eval-rst}}\n.. automodule:: {name}\n   :members:\n```\n"


def kind_of(value: object) -> str:
    """Return the kind of an object, one of `KINDS`."""
    return "class" if inspect.isclass(value) else "function" if callable(value) else "data"


def public_names(package: str) -> str:
    """Return the documentation of the names in a package's `__all__`; links lead to the modules that define them."""
    module = importlib.import_module(package)
    kinds = {name: kind_of(getattr(module, name)) for name in module.__all__}
    options = {"class": "   :members:\n", "function": "", "data": "   :no-value:\n"}
    return "\n".join(
        f"```{{eval-rst}}\n.. auto{kind}:: {package}.{name}\n   :no-index:\n{options[kind]}```\n"
        for name, kind in sorted(kinds.items(), key=lambda item: KINDS.index(item[1]))
    )


def shortened(_app: Sphinx, *described: Any) -> tuple[str, str | None] | None:
    """Return a signature with short default values: `Circle(...)` in place of an object with all its fields."""
    *_, signature, returns = described
    if signature is None:
        return None
    return re.sub(r"<\w+>", "...", re.sub(r"=(\w+)\([^()]+\)", r"=\1(...)", signature)), returns


def tidy(_app: Sphinx, document: nodes.document) -> None:
    """Put classes before functions and constants, and leave out long values of constants."""
    for value in list(document.findall(addnodes.desc_annotation)):
        if value.astext().lstrip().startswith("=") and len(value.astext()) > LONGEST_VALUE:
            value.parent.remove(value)
    for home in document.findall(nodes.section):
        units = [own_nodes(home, node) for node in home if isinstance(node, addnodes.desc)]
        first = home.index(units[0][0]) if units else 0
        moved = [node for unit in sorted(units, key=rank) for node in unit]
        for node in moved:
            home.remove(node)
        for node in reversed(moved):
            home.insert(first, node)


def rank(unit: list[nodes.Element]) -> int:
    """Return the place of an object's kind among `KINDS`."""
    kind = {"exception": "class"}.get(unit[-1]["objtype"], unit[-1]["objtype"])
    return KINDS.index(kind) if kind in KINDS else len(KINDS)


def own_nodes(home: nodes.Element, node: nodes.Element) -> list[nodes.Element]:
    """Return an object's description, with its entry for the index before it if there is one."""
    before = home[max(0, home.index(node) - 1)]
    return [before, node] if isinstance(before, addnodes.index) else [node]


def write(app: Sphinx) -> None:
    """Write all pages; with the tag `quick` without the modules of the inner packages of `baselines`."""
    found = {p: modules(p, quick="quick" in app.tags and p == "baselines") for p in PACKAGES}
    texts = {name: text for package, names in found.items() for name, text in pages(package, names).items()}
    document_fields(found["auv_gym"] + found["baselines"])
    replace_folder(Path(app.srcdir) / "api", {f"{name}.md": text for name, text in texts.items()})


def replace_folder(folder: Path, texts: dict[str, str]) -> None:
    """Make these the Markdown files of a folder; a file that is the same already is left alone, and not read again."""
    folder.mkdir(exist_ok=True)
    for file in set(folder.glob("*.md")) - {folder / name for name in texts}:
        file.unlink()
    for name, text in texts.items():
        file = folder / name
        if not file.exists() or file.read_text(encoding="utf-8") != text:
            file.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect the hook."""
    app.connect("autodoc-process-signature", shortened)
    app.connect("builder-inited", write)
    app.connect("doctree-read", tidy)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
