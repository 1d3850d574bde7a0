"""The options of `auv-gym evaluate`, in a module that is imported fast."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg


@dataclass(frozen=True)
class Options:
    """Run policies in the same episodes, print a table, and write report.html and results.json, .csv and .npz.

    The expert, backstepping, always runs too: effort and command rate are relative to it. Exit status: 0 done, 1 a
    policy failed or the results could not be written, 2 wrong usage.

    Example: auv-gym evaluate --policy nmpc helm --scenario cruise-storm --episodes 20
    """

    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]")] = ()
    """Policies, compared with the expert; the default is the expert alone. Each is a name; FILE.py:FACTORY; a FILE.zip
    of Stable-Baselines3; a FILE.onnx; a FILE.json of auv-gym tune; "cmd:COMMAND", a program in any language that reads
    observations and writes actions line by line, see docs/programs.md; the folder of a trained agent, or of its
    training run. With several training seeds all of them run, and a line has their mean with an interval over seeds and
    episodes."""
    suite: Annotated[str | None, arg(metavar="S")] = None
    """A frozen suite, see docs/suites.md: "benchmark-v3", the default, or "benchmark-v3-validation"; with python
    evaluate.py in a clone also "hard-v1", "sealed-v3", "space-v1" and "vehicles-v3". The tables also show the recorded
    results of other policies. Or "presets": all presets, with episodes drawn from the seed."""
    scenario: Annotated[tuple[str, ...], arg(metavar="S [S ...]")] = ()
    """Scenarios instead of a suite: names of presets, also as PRESET@VEHICLE and PRESET-setpoints, or .toml and .json
    files."""
    mission: Annotated[Path | None, arg(metavar="FILE")] = None
    """A mission instead of a suite: waypoints in a .csv, .geojson, .plan or .waypoints file, see docs/missions.md."""
    vehicle: Annotated[str | None, arg(metavar="V")] = None
    """Vehicle of the mission: a published one by name, or a .toml file. Default: the paper's."""
    speed: float | None = None
    """Speed of the mission in m/s, where its file has none. Default: the design speed of the vehicle."""
    radius: float | None = None
    """Least radius of the corners of the mission in m. Default: that of the vehicle's turn rate."""
    current: Annotated[tuple[float, float], arg(metavar="V_X V_Y", help_behavior_hint="")] = (0.0, 0.0)
    """Current of the mission in m/s, to the east and to the north."""
    plant: Annotated[str | None, arg(metavar="P")] = None
    """Another simulator that moves the vehicles: "cmd:COMMAND", a program in any language that reads commands and
    writes states line by line, see docs/plants.md. Results of a suite are then not compared with recorded ones."""
    effects: Annotated[tuple[Path, ...], arg(metavar="FILE.py [...]")] = ()
    """Python files with effects of your own, which scenario files name: docs/make-your-own.md. They are executed."""
    episodes: int | None = None
    """Number of episodes of each policy in each scenario. Default: 20; in a frozen suite all of them."""
    seed: int = 0
    """Seed of the first episode; episode i has seed + i, the same for all policies."""
    jobs: int | None = None
    """Worker processes; the results are the same for any number. Default: 2, or 1 on a single processor."""
    cluster: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """A Dask scheduler, by its address or its file, whose workers run instead of --jobs, see docs/many-runs.md."""
    out: Path = Path("runs/evaluate")
    """Folder for the results."""
    step_limit: float = 0.1
    """Largest mean time of a policy for one action, in seconds; a slower policy fails."""
    resume: bool = False
    """Use the finished runs of an interrupted evaluation in the folder. A run is repeated if the policy's file or the
    simulator has changed since, or if it was too slow for --step-limit. Of what a policy's file imports, files beside
    it are checked; of a program, the files that its command names, with those that they import from beside them."""
