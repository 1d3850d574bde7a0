"""Measurements of this project and the pages that they are written to. Not part of the installed package."""

from pathlib import Path

from baselines.tools.files import DATA_FOLDERS

DATA = Path(__file__).parent / "data"
"""Folder of the measurements."""
DOCS = Path(__file__).parents[1] / "docs"
"""Folder of the documentation, whose pages and figures are written from `DATA`."""

DATA_FOLDERS.append(DATA)
