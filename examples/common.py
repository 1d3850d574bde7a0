"""What the scripts share: the ids, how much to do, and the score of what was trained."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
QUICK = "--quick" in sys.argv  # as few steps as show that it runs
TRACK = "auv_gym:UnderactuatedAUVTrack-cruise-calm-v0"
RESIDUAL = "auv_gym:UnderactuatedAUVTrackResidual-cruise-calm-v0"
IDS = (TRACK, RESIDUAL)


def steps(usual: int, quick: int) -> int:
    """Return how many steps to take."""
    return quick if QUICK else usual


def steady_error(policy: str, scenario: str = "cruise-calm") -> float:
    """Return the tail error [m] that `evaluate.py` finds for a policy, a name or a path."""
    words = ["--policy", policy, "--scenario", scenario, "--episodes", "2", "--jobs", "1", "--out", "scored"]
    subprocess.run([sys.executable, str(ROOT / "evaluate.py"), *words], check=True, stdout=subprocess.DEVNULL)
    results = json.loads(Path("scored", "results.json").read_text(encoding="utf-8"))["results"]
    error: float = next(r for r in results if r["policy"] == policy)["steady_rmse_m"]["mean"]
    assert 0 <= error < 1000, error
    return error


def figure(error: float) -> str:
    """Return a tail error [m] for the line; what was trained for a moment has none."""
    return "" if QUICK else f" ({error:.2g} m)"


def works(what: str) -> None:
    """Say in one line what has been shown."""
    print(f"works: {what}")
