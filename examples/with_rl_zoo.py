"""rl_zoo3: the commands train and enjoy on both ids; evaluate.py scores the models."""

import subprocess
import sys
from pathlib import Path

from common import IDS, steady_error, steps, works

HYPERPARAMETERS = """
{env}:
  normalize: true
  n_envs: 2
  n_timesteps: 1000
  policy: MlpPolicy
  n_steps: 64
  batch_size: 64
  n_epochs: 2
"""


def zoo(command: str, *words: str) -> None:
    """Run a command of rl_zoo3."""
    subprocess.run([sys.executable, "-m", f"rl_zoo3.{command}", *words], check=True, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    errors = []
    for env_id in IDS:
        env = env_id.removeprefix("auv_gym:")  # rl_zoo3 imports the package itself
        conf = Path(f"{env}.yml")
        conf.write_text(HYPERPARAMETERS.format(env=env), encoding="utf-8")
        common = ("--algo", "ppo", "--env", env, "--gym-packages", "auv_gym", "--seed", "0")
        zoo("train", *common, "--conf-file", str(conf), "-f", "logs", "-n", str(steps(50_000, 256)), "--verbose", "0")
        zoo("enjoy", *common, "-f", "logs", "-n", "20", "--no-render")
        run = max(Path("logs", "ppo").glob(f"{env}_*"), key=lambda path: path.stat().st_mtime)
        errors.append(steady_error(str(run / f"{env}.zip")))
    works("train and enjoy on both ids, with normalisation; evaluate.py scores the models in its folders")
