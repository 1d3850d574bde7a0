"""Improves the site's search: search terms for pages, and a lower rank for names of the code.

Sphinx ranks names of the code above pages, and finds no page for synonyms such as "SB3". Index entries, which its
search ranks first, therefore add search terms to pages, and scorer.js lowers the rank of names of the code.
"""

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx

WORDS = {
    "install": ("install", "installation", "pip install"),
    "quickstart": ("gym.make", "make_vec"),
    "tutorials/controller": ("own controller", "your own controller", "my controller", "controller"),
    "tutorials/log-to-agent": ("log", "CSV"),
    "training": ("train", "training", "PPO", "SAC"),
    "environments/track": ("reward", "observation", "action"),
    "environments/residual": ("residual", "correction"),
    "vehicles": ("vehicle", "vehicles", "REMUS", "Otter"),
    "policies": ("policy", "policies", "MPC", "nmpc", "helm", "backstepping"),
    "results": ("compare MPC", "results", "score"),
    "tools": ("SB3", "Stable-Baselines3", "RLlib", "TorchRL"),
    "export": ("ONNX", "C header"),
    "on-a-vehicle": ("ROS", "ROS 2", "NED"),
    "citing": ("cite", "citation", "BibTeX"),
}
"""Search terms by page."""


def add_words(app: Sphinx, document: nodes.document) -> None:
    """Add the index entries of a page."""
    entries = [("single", word, "", "main", None) for word in WORDS.get(app.env.docname, ())]
    document.insert(0, addnodes.index(entries=entries))


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect the event handler."""
    app.connect("doctree-read", add_words)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
