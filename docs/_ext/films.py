"""The directive `film`: a moving picture of policies in a preset, made when a page that shows it is read.

The files are kept beside the built pages, under names made of all that they show: what is there is not made again.
With the tag `quick` all are the film of one scenario.
"""

import hashlib
import json
import os
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation.score import speed_range_of

FOLDER = "films"
"""Where the files are, beside the folder of the built pages."""
SEED = 6
SPEED = 4.0  # how many times faster than the vehicles a film is
SECONDS = 10.0
QUICK = "paper-circle"
"""The scenario that is filmed in place of all others where there is no time."""


def filmed(scenario: str) -> tuple[str, ...]:
    """Return the policies of a scenario's film: the expert and, where there is one, the regime's agent."""
    speed_range = speed_range_of(scenario)
    return ("backstepping", f"apg-{speed_range}") if speed_range else ("backstepping",)


def film(scenario: Scenario, folder: Path) -> Path:
    """Return the file of a scenario's film, made if it is not there."""
    from baselines.video import make_film

    policies = filmed(scenario.name)
    options = {"seed": SEED, "size": (400 * len(policies), 400), "speed": SPEED, "seconds": SECONDS, "fps": 10}
    record = json.dumps([scenario.to_dict(), policies, options])
    file = folder / f"{scenario.name}-{hashlib.sha256(record.encode()).hexdigest()[:12]}.webp"
    return file if file.exists() else make_film(file, policies, scenario.name, **options)


class FilmDirective(SphinxDirective):
    """A moving picture of a preset, with a line about it."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the figure."""
        name = QUICK if "quick" in self.env.app.tags else self.arguments[0]
        who = " and ".join({"backstepping": "the expert"}.get(policy, f"`{policy}`") for policy in filmed(name))
        line = f"{who[0].upper()}{who[1:]} in the episode of seed {SEED} of `{name}`, {SPEED:g} times as fast."
        return [figure(self, film(PRESETS[name], Path(self.env.app.outdir).parent / FOLDER), line)]


def figure(directive: SphinxDirective, file: Path, line: str) -> nodes.figure:
    """Return a picture that lies outside of the pages' folder, with a line below it."""
    uri = "/" + Path(os.path.relpath(file, directive.env.srcdir)).as_posix()
    caption, _ = directive.parse_inline(line)
    image = nodes.image(uri=uri, alt=line.replace("`", ""))
    return nodes.figure("", image, nodes.caption("", "", *caption))


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the directive."""
    app.add_directive("film", FilmDirective)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
