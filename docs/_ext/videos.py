"""The directive `video`: a video of policies in a preset, made when Sphinx reads the page.

The files are kept next to the built pages. The name of a file has a hash of everything that the video depends on, so
a video is made only once. With the tag `quick` all videos are the one of a single scenario.
"""

import hashlib
import json
import os
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from auv_gym.scenarios.presets import as_scenario
from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation.score import SETPOINT_EXPERT, speed_range_of
from baselines.space import SPEED_RANGE

FOLDER = "videos"
"""Name of the folder of the files, next to the folder of the built pages."""
SEED = 6
SPEED = 4.0  # playback speed, as a multiple of real time
SECONDS = 10.0
QUICK = "paper-circle"
"""The scenario of all videos with the tag `quick`."""


def shown_policies(scenario: str) -> tuple[str, ...]:
    """Return the policies in the video of a scenario: the expert, and with a speed range a second one."""
    speed_range = speed_range_of(scenario)
    if as_scenario(scenario).takes_setpoints:
        return (SETPOINT_EXPERT,)
    if speed_range == SPEED_RANGE:
        return "backstepping", "helm-3d"
    return ("backstepping", "helm") if speed_range else ("backstepping",)


def video_file(scenario: Scenario, folder: Path) -> Path:
    """Return the file of a scenario's video; the video is made if the file does not exist."""
    from baselines.video import make_video

    policies = shown_policies(scenario.name)
    size = (max(600, 400 * len(policies)), 400)
    options = {"seed": SEED, "size": size, "speed": SPEED, "seconds": SECONDS, "fps": 10}
    record = json.dumps([scenario.to_dict(), policies, options])
    file = folder / f"{scenario.name}-{hashlib.sha256(record.encode()).hexdigest()[:12]}.webp"
    return file if file.exists() else make_video(file, policies, scenario.name, **options)


class VideoDirective(SphinxDirective):
    """A video of a preset, with a caption."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the figure."""
        name = QUICK if "quick" in self.env.app.tags else self.arguments[0]
        names = " and ".join({"backstepping": "the expert"}.get(p, f"`{p}`") for p in shown_policies(name))
        line = f"{names[0].upper()}{names[1:]} in the episode of seed {SEED} of `{name}`, {SPEED:g} times as fast."
        return [figure(self, video_file(as_scenario(name), Path(self.env.app.outdir).parent / FOLDER), line)]


def figure(directive: SphinxDirective, file: Path, line: str) -> nodes.figure:
    """Return a figure whose file is outside of the pages' folder, with a line as its caption."""
    uri = "/" + Path(os.path.relpath(file, directive.env.srcdir)).as_posix()
    caption, _ = directive.parse_inline(line)
    image = nodes.image(uri=uri, alt=line.replace("`", ""))
    return nodes.figure("", image, nodes.caption("", "", *caption))


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the directive."""
    app.add_directive("video", VideoDirective)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
