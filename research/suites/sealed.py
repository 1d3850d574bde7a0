"""Sealed suites, whose episodes are secret until all policies are frozen.

The scenarios of a sealed suite are public. Its episodes are drawn from a secret, and only the SHA-256 of the secret and
of the scenarios is in `SEALS`, committed before any measurement. So no policy can be trained, tuned or chosen on the episodes. After all
policies are frozen, `python -m research suites open NAME --secret WORDS` checks the secret against the hash, publishes
it and builds the suite, and `record NAME` runs the policies. From then on the suite is public, and the next one is
sealed.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from auv_gym.physics.disturbances import RandomCurrent, RandomMismatch
from auv_gym.scenarios.presets import PRESETS, SPEED_RANGES
from auv_gym.scenarios.scenario import RandomPath, Scenario, Start
from baselines.evaluation.suites import SuiteError
from baselines.tools.files import json_text, read_json, write_atomically

SEALS = Path(__file__).parent / "seals.json"
"""File with the SHA-256 of each secret and of the scenarios, and with the secrets of opened suites."""

BETWEEN = {"slow": (0.3, 0.4), "cruise": (0.4, 0.5)}  # [m/s] speeds between the speed ranges
BEYOND = {"slow": (0.05, 0.1), "cruise": (1.6, 2.0)}  # [m/s] speeds outside the speed ranges
_MISSION = 300.0  # [s] duration of a mission
_SLEW = 2.0  # [s] time from zero to the limit of slewing actuators
FIRST: Mapping[str, Any] = {"beyond": {**BEYOND, "cruise": (1.5, 2.0)}, "slew": 1.0}
"""Arguments of `sealed_worlds` for `sealed-v1`. Since then `helm` and its variants are trained up to 1.6 m/s and with a
slew time of a second."""
_OUTAGES = 3.0  # [1/min] rate of outages of the position fix
LONG = {"slow": (5.0, 10.0), "cruise": (3.0, 6.0)}  # [s] duration of an outage
_FAR = 5.0  # [m] largest distance of a far start on each axis
MASS_SHARES = (0.7, 1.3)  # masses of a vehicle as shares of the known ones
DRAG = (0.6, 1.4)  # drag of a vehicle as shares of the known one


@dataclass(frozen=True)
class Seal:
    """The hashes of a secret and of the scenarios and, after the opening, the secret."""

    sha256: str
    worlds: str
    secret: str | None = None  # None: the suite is sealed

    def opened(self, secret: str, worlds: str) -> Seal:
        """Return the seal with its secret, for the hash of the present scenarios.

        Raises:
            SuiteError: the secret or the scenarios do not have these hashes.
        """
        if worlds != self.worlds:
            raise SuiteError(f"the scenarios have changed: their SHA-256 is {worlds}, that of the seal {self.worlds}")
        if sha256(secret) != self.sha256:
            raise SuiteError(f"this is not the secret: its SHA-256 is {sha256(secret)}, that of the seal {self.sha256}")
        return Seal(self.sha256, self.worlds, secret)


def worlds(name: str) -> str:
    """Return the SHA-256 of the scenarios of a sealed suite, in hexadecimal digits."""
    found = [[s.to_dict(), mission] for s, mission in sealed_worlds(**(FIRST if name == "sealed-v1" else {}))]
    return sha256(json.dumps(found, sort_keys=True))


def sha256(text: str) -> str:
    """Return the SHA-256 of a text, in hexadecimal digits."""
    return hashlib.sha256(text.encode()).hexdigest()


def seed_of(secret: str) -> int:
    """Return the seed of a secret, a number of 64 bits."""
    return int.from_bytes(hashlib.sha256(b"episodes " + secret.encode()).digest()[:8], "big")


def seals() -> dict[str, Seal]:
    """Return the seals, by the names of their suites.

    Raises:
        SuiteError: the file cannot be read.
    """
    try:
        return {name: Seal(**entry) for name, entry in read_json(SEALS).items()}
    except (OSError, ValueError, TypeError) as error:
        raise SuiteError(f"cannot read the seals: {error}") from error


def write_seal(name: str, seal: Seal) -> None:
    """Write a seal to the file.

    Raises:
        SuiteError: the suite has another seal.
    """
    known = seals()
    if name in known and known[name].sha256 != seal.sha256:
        raise SuiteError(f"{name} is sealed already, with SHA-256 {known[name].sha256}")
    known[name] = seal
    write_atomically(SEALS, json_text({key: vars(s) for key, s in sorted(known.items())}))


def seed(name: str) -> int:
    """Return the seed of an opened suite.

    Raises:
        SuiteError: the suite has no seal, or it is sealed.
    """
    seal = seals().get(name)
    if seal is None:
        raise SuiteError(f"{name} has no seal; make one with: python -m research suites seal {name}")
    if seal.secret is None:
        raise SuiteError(f"{name} is sealed: its episodes are published after all policies are frozen")
    return seed_of(seal.secret)


def sealed_worlds(
    beyond: Mapping[str, tuple[float, float]] = BEYOND, slew: float = _SLEW
) -> list[tuple[Scenario, bool]]:
    """Return the scenarios of a sealed suite, and whether each follows random waypoints in place of path families.

    They are outside the distributions of training (`auv_gym.scenarios.mixtures`) and tuning: speeds between and beyond
    the speed ranges, missions of five minutes, slewing actuators, long outages of the position fix, far starts, other
    vehicles, and a combination of these.

    Args:
        beyond: speeds [m/s] outside the speed ranges, by speed range.
        slew: time [s] from zero to the limit of slewing actuators.
    """
    found = []
    for speed_range in SPEED_RANGES:
        storm = PRESETS[f"{speed_range}-storm"]
        assert isinstance(storm.path, RandomPath)
        slewing = _slewing(storm, slew)
        patchy = replace(storm.sensors, outages=_OUTAGES, outage_time=LONG[speed_range])
        far = Start(x_e=(-_FAR, _FAR), y_e=(-_FAR, _FAR), psi_e=(-math.pi, math.pi), surge=(0.0, 1.0))
        vehicles = _vehicles(storm)
        changes: Mapping[str, dict[str, Any]] = {
            "between": {"path": replace(storm.path, speed=BETWEEN[speed_range])},
            "beyond": {"path": replace(storm.path, speed=beyond[speed_range])},
            "mission": {"steps": round(_MISSION / storm.control_dt)},
            "slew": {"actuators": slewing},
            "outages": {"sensors": patchy},
            "far-start": {"start": far},
            "hulls": {"mismatch": vehicles},
            "all-at-once": {
                "path": replace(storm.path, speed=BETWEEN[speed_range]),
                "actuators": replace(slewing, effectiveness=(0.7, 1.0), delay=(0.0, 2.0)),
                "sensors": replace(patchy, outages=1.0, heading_bias=(-0.04, 0.04)),
                "mismatch": vehicles,
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


def _vehicles(storm: Scenario) -> RandomMismatch:
    assert isinstance(storm.mismatch, RandomMismatch)
    return replace(storm.mismatch, mass=MASS_SHARES, m33=MASS_SHARES, d11=DRAG, d22=DRAG, d33=DRAG)


def _sheared(storm: Scenario, speed_range: str) -> RandomCurrent:
    """Return the storm's current with a shear of short wavelength."""
    assert isinstance(storm.current, RandomCurrent)
    wavelength = {"slow": (3.0, 5.0), "cruise": (10.0, 20.0)}[speed_range]
    return replace(storm.current, shear=(0.1, 0.2), wavelength=wavelength)
