"""Shared code of the examples: ids of environments, numbers of steps, and the error of a trained policy."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
QUICK = "--quick" in sys.argv  # short runs, which only show that the scripts work
TRACK = "auv_gym:UnderactuatedAUVTrack-cruise-calm-v0"
RESIDUAL = "auv_gym:UnderactuatedAUVTrackResidual-cruise-calm-v0"
IDS = (TRACK, RESIDUAL)


def steps(usual: int, quick: int) -> int:
    """Return the number of steps, depending on --quick."""
    return quick if QUICK else usual


def steady_error(policy: str, scenario: str = "cruise-calm", *others: str) -> float:
    """Return the steady-state RMSE [m] of a policy, a name or a path, from `evaluate.py` with other options."""
    words = ["--policy", policy, "--scenario", scenario, "--episodes", "2", "--jobs", "1", "--out", "scored", *others]
    subprocess.run([sys.executable, str(ROOT / "evaluate.py"), *words], check=True, stdout=subprocess.DEVNULL)
    results = json.loads(Path("scored", "results.json").read_text(encoding="utf-8"))["results"]
    error: float = next(r for r in results if r["policy"] == policy)["steady_rmse_m"]["mean"]
    assert 0 <= error < 1000, error
    return error


def figure(error: float) -> str:
    """Return a steady-state RMSE [m] as text; empty with --quick, since short training gives no useful error."""
    return "" if QUICK else f" ({error:.2g} m)"


def works(text: str) -> None:
    """Print the line from which `examples.__main__.run` takes the result."""
    print(f"works: {text}")
