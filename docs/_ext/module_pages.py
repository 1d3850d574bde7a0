"""Writes the API reference to docs/api/: a page of public names for each package, and pages for the modules.

The pages are written before Sphinx collects its sources, and are not kept in git. The site's search skips them.
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
"""Kinds of objects, in the order of a page."""
LONGEST_VALUE = 60  # [characters] longest value of a constant on a page


def modules(package: str, *, quick: bool) -> list[str]:
    """Return the names of a package and of all its public modules; with `quick` only of those directly in it."""
    path = importlib.import_module(package).__path__
    entries = pkgutil.iter_modules(path, f"{package}.") if quick else pkgutil.walk_packages(path, f"{package}.")
    return [package, *(entry.name for entry in entries if "._" not in entry.name)]


def first_paragraph(name: str) -> str:
    """Return the first paragraph of a module's docstring."""
    return (importlib.import_module(name).__doc__ or "").strip().split("\n\n")[0].replace("\n", " ")


def pages(package: str, found: list[str]) -> dict[str, str]:
    """Return the text of each page of a package's reference: the package, its modules, and its inner packages."""
    packages = {name for name in found if hasattr(importlib.import_module(name), "__path__")}
    members = {name: [name] for name in found if name in packages or name.count(".") == 1}
    for name in found:
        if name not in members:
            members[name.rpartition(".")[0]].append(name)
    texts = {
        page: "\n".join(["---\nnosearch: true\n---\n", f"# {page}\n", *(section(name, page) for name in inner)])
        for page, inner in members.items()
    }
    texts[package] = (
        f"# {package}\n\n{public_names(package)}\n## Modules\n\nNames that are not listed above are internal.\n"
    )
    rows = [f"| [{page}]({page}.md) | {first_paragraph(page)} |" for page in members if page != package]
    table = "\n".join(["", "| module | content |", "|---|---|", *rows])
    texts[package] += f"{table}\n\n```{{toctree}}\n:hidden:\n\n" + "\n".join(
        page for page in members if page != package
    )
    texts[package] += "\n```\n"
    return texts


def section(name: str, page: str) -> str:
    """Return the section of a module on a page; it has a heading unless the page is the module's own."""
    heading = "" if name == page else f"## {name.removeprefix(page + '.')}\n\n"
    return f"{heading}```{{eval-rst}}\n.. automodule:: {name}\n   :members:\n```\n"


def kind_of(value: object) -> str:
    """Return the kind of an object, one of `KINDS`."""
    return "class" if inspect.isclass(value) else "function" if callable(value) else "data"


def public_names(package: str) -> str:
    """Return the documentation of the names in a package's `__all__`; links point to the modules that define them."""
    module = importlib.import_module(package)
    kinds = {name: kind_of(getattr(module, name)) for name in module.__all__}
    options = {"class": "   :members:\n", "function": "", "data": "   :no-value:\n"}
    return "\n".join(
        f"```{{eval-rst}}\n.. auto{kind}:: {package}.{name}\n   :no-index:\n{options[kind]}```\n"
        for name, kind in sorted(kinds.items(), key=lambda item: KINDS.index(item[1]))
    )


def shortened(_app: Sphinx, *described: Any) -> tuple[str, str | None] | None:
    """Return a signature with short default values, such as `Circle(...)` instead of an object with all its fields."""
    *_, signature, returns = described
    if signature is None:
        return None
    return re.sub(r"<\w+>", "...", re.sub(r"=(\w+)\([^()]+\)", r"=\1(...)", signature)), returns


def tidy(_app: Sphinx, document: nodes.document) -> None:
    """Sort classes before functions before constants, and remove long values of constants."""
    for value in list(document.findall(addnodes.desc_annotation)):
        if value.astext().lstrip().startswith("=") and len(value.astext()) > LONGEST_VALUE:
            value.parent.remove(value)
    for part in document.findall(nodes.section):
        units = [description_nodes(part, node) for node in part if isinstance(node, addnodes.desc)]
        first = part.index(units[0][0]) if units else 0
        moved = [node for unit in sorted(units, key=rank) for node in unit]
        for node in moved:
            part.remove(node)
        for node in reversed(moved):
            part.insert(first, node)


def rank(unit: list[nodes.Element]) -> int:
    """Return the index of an object's kind in `KINDS`."""
    kind = {"exception": "class"}.get(unit[-1]["objtype"], unit[-1]["objtype"])
    return KINDS.index(kind) if kind in KINDS else len(KINDS)


def description_nodes(part: nodes.Element, node: nodes.Element) -> list[nodes.Element]:
    """Return the description of an object in a section, preceded by its index entry if there is one."""
    before = part[max(0, part.index(node) - 1)]
    return [before, node] if isinstance(before, addnodes.index) else [node]


def write(app: Sphinx) -> None:
    """Write all pages; with the tag `quick`, those of the inner packages of `baselines` have no modules."""
    found = {p: modules(p, quick="quick" in app.tags and p == "baselines") for p in PACKAGES}
    texts = {name: text for package, names in found.items() for name, text in pages(package, names).items()}
    document_fields(found["auv_gym"] + found["baselines"])
    replace_folder(Path(app.srcdir) / "api", {f"{name}.md": text for name, text in texts.items()})


def replace_folder(folder: Path, texts: dict[str, str]) -> None:
    """Make these texts the Markdown files of a folder; unchanged files are not written, so Sphinx skips them."""
    folder.mkdir(exist_ok=True)
    for file in set(folder.glob("*.md")) - {folder / name for name in texts}:
        file.unlink()
    for name, text in texts.items():
        file = folder / name
        if not file.exists() or file.read_text(encoding="utf-8") != text:
            file.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect the event handlers."""
    app.connect("autodoc-process-signature", shortened)
    app.connect("builder-inited", write)
    app.connect("doctree-read", tidy)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
