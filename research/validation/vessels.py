"""Predictions of measured runs by models that were fitted to other runs of the same vessel."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from auv_gym.physics.dynamics import rates
from auv_gym.physics.namespaces import Array
from baselines.identification import Identified, Log, identify
from baselines.identification.columns import Format
from baselines.identification.log import joined
from baselines.identification.model import COEFFICIENTS, is_current, load_of, names_of
from baselines.identification.prediction import PREDICTORS, HeldOut, held_out, rms

BIN, BINS = 10.0, 6
"""Length [s] and number of the parts of a prediction of which errors are recorded."""
TIMES = (20.0, 40.0, 60.0)
"""Times [s] after the start of a prediction at which errors are recorded, each for the second that ends there."""
_STEP = 1e-5  # half width of central differences, in SI units


@dataclass(frozen=True)
class Vessel:
    """A vessel with measured runs in a folder of the logs."""

    files: str  # pattern of its runs
    form: str  # name of their format
    mass: float  # [kg]
    length: float  # [m]
    folds: int  # parts of the runs that are left out in turn

    @property
    def known(self) -> dict[str, float]:
        """Parameters that runs with a rudder do not show: masses and arm by the rules that `identify` prints."""
        m, L = self.mass, self.length
        return {"m11": 1.05 * m, "m22": 1.8 * m, "m33": 0.1 * m * L * L, "arm": 0.5 * L}


VESSELS: Mapping[str, Vessel] = {
    "kvlcc2-hsva": Vessel("Z_*.dat", "kvlcc2", 3272.0, 7.0, 7),
    "esso-osaka": Vessel("[tz]*.csv", "esso-osaka", 244.6, 3.0, 11),
}
"""By the folder of their runs."""


def runs_of(name: str, folder: Path) -> dict[str, Log]:
    """Return the runs of a vessel by the names of their files.

    Raises:
        OSError: there are fewer files than folds.
    """
    vessel = VESSELS[name]
    files = sorted((folder / name).glob(vessel.files))
    if len(files) < vessel.folds:
        raise OSError(f"{folder / name} has {len(files)} files {vessel.files}; it must have {vessel.folds} or more")
    form = Format.named(vessel.form)
    return {file.stem: Log.load(file, form) for file in files}


def fitted_vessel(name: str, logs: Sequence[Log]) -> Identified:
    """Return the model that is fitted to some runs of a vessel, in water without a current."""
    log = joined(logs)
    still = {name: 0.0 for name in names_of(log) if is_current(name)}
    return identify(log, known=VESSELS[name].known | still)


def cross_validated(name: str, folder: Path) -> dict[str, Any]:
    """Return the prediction errors of a cross-validation over the runs of a vessel.

    Args:
        name: of the vessel.
        folder: of all logs.
    """
    logs, folds = runs_of(name, folder), VESSELS[name].folds
    results: list[tuple[list[str], Identified, HeldOut]] = []
    for k in range(folds):
        out = list(logs)[k::folds]
        found = fitted_vessel(name, [log for run, log in logs.items() if run not in out])
        results.append((out, found, held_out(found, joined([logs[run] for run in out]))))
        print(f"{name}: {', '.join(out)}: {math.degrees(results[-1][2].rms['model'][0]):.2f} degrees", flush=True)
    every = {
        predictor: np.concatenate([result.errors[predictor] for *_, result in results]) for predictor in PREDICTORS
    }
    ages = np.concatenate([result.age for *_, result in results])
    names = np.concatenate([np.array(out)[result.run] for out, _, result in results])
    beyond = [(out[e.run], e.name) for out, _, result in results for e in result.extrapolations]
    bins = np.minimum((ages / BIN).astype(np.int64), BINS - 1)
    late = {time: (ages > time - 1.0) & (ages <= time) for time in TIMES}
    return {
        "runs": len(logs),
        "minutes": sum(log.duration for log in logs.values()) / 60,
        "misfit": sum(found.misfit for _, found, _ in results),
        "folds": folds,
        "straight_growth_1_s": [straight_growth(found) for _, found, _ in results],
        "rms": {predictor: _sizes(rows) for predictor, rows in every.items()},
        "inside": np.concatenate([result.inside for *_, result in results]).mean(axis=0).tolist(),
        "growth_deg": {
            predictor: [_sizes(rows[bins == k])["heading_deg"] for k in np.unique(bins)]
            for predictor, rows in every.items()
        },
        "after": {
            predictor: {
                f"{time:g}": _sizes(rows[at]) | {"runs": len(np.unique(names[at]))}
                for time, at in late.items()
                if at.any()
            }
            for predictor, rows in every.items()
        },
        "by_run": {
            str(run): _sizes(every["model"][names == run])
            | {"Nomoto": _sizes(every["Nomoto"][names == run]), "beyond": [name for of, name in beyond if of == run]}
            for run in np.unique(names)
        },
        "manoeuvres": [
            {"run": out[m.run], "name": m.name, "measured": m.measured, "predicted": m.predicted}
            for out, _, result in results
            for m in result.manoeuvres
        ],
    }


def straight_growth(found: Identified) -> float:
    """Return the largest real part [1/s] of the eigenvalues of sway and yaw of a fitted vessel on a straight line.

    It is positive for a directionally unstable vessel. Speed and propeller command are the medians of the log. The
    rudder is amidships, and there is no wind.
    """
    log, named = found.model.log, dict(zip(found.model.names, found.values.tolist(), strict=True))
    u, ahead = float(np.median(log.measured[:, 3])), float(np.median(log.commands[:, 0]))
    coefficients = [named[name] for name in COEFFICIENTS]

    def change(v: float, r: float) -> Array:
        load = load_of(log.kind, (ahead, 0.0), (0.0, 0.0, 0.0, u, v, r), named, math)
        return np.array(rates(0.0, u, v, r, load, coefficients)[3:])

    steps = _STEP * np.eye(2)
    slopes = [(change(*e) - change(*-e)) / (2 * _STEP) for e in steps]
    return float(np.linalg.eigvals(np.column_stack(slopes)).real.max())


def _sizes(errors: Array) -> dict[str, float]:
    """Return root mean squares and medians of the magnitude of prediction errors, shape (n, 6)."""
    psi, u, place = rms(errors)
    median_psi, median_u = np.median(np.abs(errors[:, 2:4]), axis=0).tolist()
    return {
        "points": len(errors),
        "heading_deg": math.degrees(psi),
        "speed_m_s": u,
        "place_m": place,
        "median_heading_deg": math.degrees(median_psi),
        "median_speed_m_s": median_u,
        "median_place_m": float(np.median(np.hypot(errors[:, 0], errors[:, 1]))),
    }
