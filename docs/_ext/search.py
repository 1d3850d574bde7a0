"""The search of the site: words that lead to a page, and names of the code behind all pages.

Sphinx ranks a name of the code above a page, and does not know that a reader who types "SB3" wants the page on other
libraries. So pages get index entries, which its search ranks first, and scorer.js takes names of the code down.
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
"""What a reader may type, by the page that answers it."""


def add_words(app: Sphinx, document: nodes.document) -> None:
    """Add the index entries of a page."""
    entries = [("single", word, "", "main", None) for word in WORDS.get(app.env.docname, ())]
    document.insert(0, addnodes.index(entries=entries))


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect the hook."""
    app.connect("doctree-read", add_words)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
