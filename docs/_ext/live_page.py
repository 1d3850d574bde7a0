"""Builds the live page in live/, next to the built pages."""

from pathlib import Path

from sphinx.application import Sphinx


def write(app: Sphinx, exception: Exception | None) -> None:
    """Write the live page after all other pages; not with the tag `quick`."""
    if exception is None and "quick" not in app.tags:
        from research.site.live.page import write_page as write_live_page

        write_live_page(Path(app.outdir) / "live")


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect the hook."""
    app.connect("build-finished", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
