"""The directive `paper-figure`: one of the paper's figures, recomputed when Sphinx reads the page."""

import functools
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from videos import FOLDER, figure

from research.paper.figures import paper_figures
from research.paper.numbers import reproduce_paper


@functools.cache
def figures() -> dict[str, bytes]:
    """Return the figures as PNG, by name."""
    return paper_figures(reproduce_paper())


class PaperFigure(SphinxDirective):
    """A figure of the paper with the directive's content as its caption."""

    required_arguments = 1
    has_content = True

    def run(self) -> list[nodes.Node]:
        """Return the figure."""
        file = Path(self.env.app.outdir).parent / FOLDER / f"{self.arguments[0]}.png"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(figures()[self.arguments[0]])
        return [figure(self, file, " ".join(self.content))]


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the directive."""
    app.add_directive("paper-figure", PaperFigure)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
