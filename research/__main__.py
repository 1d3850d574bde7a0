"""Run a study or write the pages of results: `python -m research COMMAND`; `--help` lists commands and options."""

from __future__ import annotations

import sys

from baselines.__main__ import Command, main

COMMANDS = {
    "deployment": Command("research.deployment.measure", "export"),
    "estimation-bound": Command("research.estimation_bound.command", "eval"),
    "failure-rate": Command("research.robustness.failure_rate", "eval"),
    "faults": Command("research.robustness.faults", "eval"),
    "filter-gains": Command("research.trainings.filter_gains", "eval"),
    "fine-tuning": Command("research.trainings.fine_tuning", "train"),
    "gain-exponents": Command("research.vehicles.exponents", "train"),
    "governed": Command("research.robustness.governed", "eval"),
    "guards": Command("research.robustness.guards", "eval"),
    "identification-coverage": Command("research.vehicles.coverage", "eval"),
    "leaderboard": Command("research.leaderboard.command", "eval"),
    "model-error": Command("research.robustness.model_error", "eval"),
    "pages": Command("research.pages", "eval"),
    "paper": Command("research.paper.command", "eval"),
    "screenshots": Command("research.site.screenshots", "dev"),
    "study": Command("research.trainings.study", "train"),
    "suites": Command("research.suites.command", "eval"),
    "throughput": Command("research.throughput.measure", "eval"),
    "train-all": Command("research.trainings.shipped", "train"),
    "transfer": Command("research.transfer.command", "eval"),
    "validation": Command("research.validation.command", "eval"),
    "vehicle-gains": Command("research.vehicles.vehicles", "tuning"),
    "web-demo": Command("research.site.live.page", "eval"),
}
"""The commands by name."""

if __name__ == "__main__":
    sys.exit(main(COMMANDS))
