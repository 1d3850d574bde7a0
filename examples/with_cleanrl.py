"""CleanRL: unmodified single-file scripts of the package, with the id of an environment."""

import importlib.util
import subprocess
import sys
from pathlib import Path

from common import IDS, steps, works

SCRIPTS = {
    "ppo_continuous_action": ("--num-steps", "64", "--num-minibatches", "2"),
    "rpo_continuous_action": ("--num-steps", "64", "--num-minibatches", "2"),
    "ddpg_continuous_action": ("--learning-starts", "50", "--buffer-size", "1000"),
}

if __name__ == "__main__":
    found = importlib.util.find_spec("cleanrl")
    assert found is not None
    assert found.submodule_search_locations
    folder = Path(found.submodule_search_locations[0])
    for script, options in SCRIPTS.items():
        for env_id in IDS:
            words = ("--env-id", env_id, "--total-timesteps", str(steps(10_000, 700)), "--cuda", "False", *options)
            done = subprocess.run(
                [sys.executable, str(folder / f"{script}.py"), *words], capture_output=True, text=True, check=False
            )
            assert done.returncode == 0, done.stderr[-2000:]
            assert "episodic_return=" in done.stdout, "no episode has ended"
    works(f"{', '.join(f'{name}.py' for name in SCRIPTS)}, unmodified, on both ids")
