"""The reference: a page for each package and for each module of `auv_gym`, from docstrings, in docs/api/.

The pages are written before Sphinx looks for pages, and are not kept in git.
"""

import importlib
import pkgutil
from pathlib import Path

from markdown_docstrings import document_fields
from sphinx.application import Sphinx

PACKAGES = ("auv_gym", "baselines")


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
        home: "\n".join([f"# {home}\n", *(section(name, home) for name in inner)]) for home, inner in homes.items()
    }
    rows = [f"| [{home}]({home}.md) | {first_line(home)} |" for home in homes if home != package]
    table = "\n".join(["", "| module | what is in it |", "|---|---|", *rows])
    texts[package] += f"{table}\n\n```{{toctree}}\n:hidden:\n\n" + "\n".join(name for name in homes if name != package)
    texts[package] += "\n```\n"
    return texts


def section(name: str, home: str) -> str:
    """Return a module's part of a page, with a heading unless it is the page's own."""
    heading = "" if name == home else f"## {name.removeprefix(home + '.')}\n\n"
    quiet = "   :no-index:\n" if name in PACKAGES else ""  # its names are those of the modules that define them
    return f"{heading}```{{eval-rst}}\n.. automodule:: {name}\n   :members:\n{quiet}```\n"


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
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
