"""Run a study or write the pages of results: `python -m research COMMAND`; `--help` lists commands and options."""

from __future__ import annotations

from baselines.__main__ import Command, end, main

RESEARCH_COMMANDS = {
    "deployment": Command("research.deployment.measure", "export"),
    "error-only": Command("research.results.error_only", "eval"),
    "failure-rate": Command("research.robustness.failure_rate", "eval"),
    "filter-gains": Command("research.trainings.filter_gains", "eval"),
    "fine-tuning": Command("research.trainings.fine_tuning", "train"),
    "gain-exponents": Command("research.vehicles.exponents", "train"),
    "identification-coverage": Command("research.vehicles.coverage", "eval"),
    "model-error": Command("research.robustness.model_error", "eval"),
    "pages": Command("research.pages", "eval"),
    "paper": Command("research.paper.command", "eval"),
    "plant": Command("research.transfer.program", "eval"),
    "speed": Command("research.speed", "eval"),
    "suites": Command("research.suites.command", "eval"),
    "train-all": Command("research.trainings.command", "train"),
    "transfer": Command("research.transfer.comparison", "eval"),
    "validation": Command("research.validation.predictions", "eval"),
    "vehicle-gains": Command("research.vehicles.gains", "tuning"),
    "web-demo": Command("research.site.live.page", "eval"),
}
"""The commands by name."""

if __name__ == "__main__":
    end(main(RESEARCH_COMMANDS))
