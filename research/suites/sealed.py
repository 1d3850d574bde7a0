"""Sealed suites: worlds that nobody can have trained, tuned or chosen anything on, since nobody has seen them.

What a sealed suite is made of stands here for everybody to read; which episodes it has does not. They are drawn from a
secret, and of that only the SHA-256 is in `SEALS`, committed before anything is measured on it. When all policies are
frozen, `python -m research suites open NAME --secret WORDS` checks the secret against the hash, writes it
down for everybody, and builds the suite; `record NAME` runs the policies. From then on the suite is as open as the
others, and the hash of the next one takes its place.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from auv_gym.physics.disturbances import RandomCurrent, RandomMismatch, RandomWaves
from auv_gym.scenarios.presets import PRESETS, SPEED_RANGES
from auv_gym.scenarios.scenario import RandomPath, Scenario, Start
from baselines.evaluation.suites import SuiteError
from baselines.tools.files import json_text, read_json, write_atomically

SEALS = Path(__file__).parent / "seals.json"
"""The SHA-256 of each secret, and the secrets of the suites that are open."""
_SHORTEST = 16  # characters of a secret

BETWEEN = {"slow": (0.3, 0.4), "cruise": (0.4, 0.5)}  # [m/s] speeds between the regimes
BEYOND = {"slow": (0.05, 0.1), "cruise": (1.6, 2.0)}  # [m/s] speeds outside of them
_MISSION = 300.0  # [s] a mission of five minutes
_SLEW = 2.0  # [s] in which the actuators go from zero to the limit
FIRST: Mapping[str, Any] = {"beyond": {**BEYOND, "cruise": (1.5, 2.0)}, "slew": 1.0}
"""What was otherwise in `sealed-v1`; `helm` and its kin are trained up to 1.6 m/s and with a slew of a second since."""
_OUTAGES = 3.0  # [1/min] how often the position fix fails
LONG = {"slow": (5.0, 10.0), "cruise": (3.0, 6.0)}  # [s] for how long
_FAR = 5.0  # [m] how far off a far start is, on each axis
MASS_SHARES = (0.7, 1.3)  # masses of a hull as shares of the known one's
DRAG = (0.6, 1.4)  # its drag


@dataclass(frozen=True)
class Seal:
    """What is known of a secret."""

    sha256: str
    secret: str | None = None  # None: the suite is sealed

    def opened(self, secret: str) -> Seal:
        """Return the seal with its secret.

        Raises:
            SuiteError: it is another one.
        """
        if sha256(secret) != self.sha256:
            raise SuiteError(f"this is not the secret: its SHA-256 is {sha256(secret)}, that of the seal {self.sha256}")
        return Seal(self.sha256, secret)


def sha256(secret: str) -> str:
    """Return the SHA-256 of a secret, in hexadecimal digits."""
    return hashlib.sha256(secret.encode()).hexdigest()


def seed_of(secret: str) -> int:
    """Return the seed that a secret stands for, of 64 bits."""
    return int.from_bytes(hashlib.sha256(b"episodes " + secret.encode()).digest()[:8], "big")


def seals() -> dict[str, Seal]:
    """Return the seals by the name of their suites.

    Raises:
        SuiteError: the file cannot be read.
    """
    try:
        return {name: Seal(**entry) for name, entry in read_json(SEALS).items()}
    except (OSError, ValueError, TypeError) as error:
        raise SuiteError(f"cannot read the seals: {error}") from error


def write_seal(name: str, seal: Seal) -> None:
    """Write a seal down.

    Raises:
        SuiteError: there is another one of that name.
    """
    known = seals()
    if name in known and known[name].sha256 != seal.sha256:
        raise SuiteError(f"{name} is sealed already, with SHA-256 {known[name].sha256}")
    known[name] = seal
    record = {key: {"sha256": s.sha256, "secret": s.secret} for key, s in sorted(known.items())}
    write_atomically(SEALS, json_text(record))


def seed(name: str) -> int:
    """Return the seed of a suite whose seal is open.

    Raises:
        SuiteError: there is no such suite, or it is sealed.
    """
    seal = seals().get(name)
    if seal is None:
        raise SuiteError(f"{name} has no seal; make one with: python -m research suites seal {name}")
    if seal.secret is None:
        raise SuiteError(f"{name} is sealed: its episodes are known when everything that runs in it is frozen")
    return seed_of(seal.secret)


def sealed_worlds(
    beyond: Mapping[str, tuple[float, float]] = BEYOND, slew: float = _SLEW
) -> list[tuple[Scenario, bool]]:
    """Return the scenarios of a sealed suite, and whether each follows random waypoints in place of path families.

    They lie outside of what agents are trained on (`auv_gym.scenarios.mixtures`) and controllers are tuned on: speeds
    between and beyond the regimes, missions of five minutes, slewing actuators, long outages of the position fix, far
    starts, other hulls, and all of it at once.

    Args:
        beyond: speeds [m/s] outside of the regimes, by regime.
        slew: time [s] in which slewing actuators go from zero to the limit.
    """
    found = []
    for speed_range in SPEED_RANGES:
        storm = PRESETS[f"{speed_range}-storm"]
        assert isinstance(storm.path, RandomPath)
        slewing = _slewing(storm, slew)
        patchy = replace(storm.sensors, outages=_OUTAGES, outage_time=LONG[speed_range])
        far = Start(x_e=(-_FAR, _FAR), y_e=(-_FAR, _FAR), psi_e=(-math.pi, math.pi), surge=(0.0, 1.0))
        hulls = _hulls(storm)
        changes: Mapping[str, dict[str, Any]] = {
            "between": {"path": replace(storm.path, speed=BETWEEN[speed_range])},
            "beyond": {"path": replace(storm.path, speed=beyond[speed_range])},
            "mission": {"steps": round(_MISSION / storm.control_dt)},
            "slew": {"actuators": slewing},
            "outages": {"sensors": patchy},
            "far-start": {"start": far},
            "hulls": {"mismatch": hulls},
            "all-at-once": {
                "path": replace(storm.path, speed=BETWEEN[speed_range]),
                "actuators": replace(slewing, effectiveness=(0.7, 1.0), delay=(0.0, 2.0)),
                "sensors": replace(patchy, outages=1.0, heading_bias=(-0.04, 0.04)),
                "mismatch": hulls,
                "current": _sheared(storm, speed_range),
            },
        }
        found += [
            (replace(storm, name=f"{speed_range}-{name}", **change), name == "mission")
            for name, change in changes.items()
        ]
    return found


def _slewing(storm: Scenario, slew: float) -> Any:
    act = storm.actuators
    return replace(act, F_u_rate=act.F_u_max / slew, F_r_rate=act.F_r_max / slew)


def _hulls(storm: Scenario) -> RandomMismatch:
    assert isinstance(storm.mismatch, RandomMismatch)
    return replace(storm.mismatch, mass=MASS_SHARES, m33=MASS_SHARES, d11=DRAG, d22=DRAG, d33=DRAG)


def _sheared(storm: Scenario, speed_range: str) -> RandomCurrent:
    """Return the storm's current, steeper and rougher, and its waves' lengths out of the usual."""
    assert isinstance(storm.current, RandomCurrent)
    assert isinstance(storm.waves, RandomWaves)
    wavelength = {"slow": (3.0, 5.0), "cruise": (10.0, 20.0)}[speed_range]
    return replace(storm.current, shear=(0.1, 0.2), wavelength=wavelength)
