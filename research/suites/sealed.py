"""Sealed suites, whose episodes are secret until all policies are frozen.

The scenarios of a sealed suite are public. Its episodes are drawn from a secret. `SEALS` has the SHA-256 of the secret
and of the scenarios, and was committed before any measurement. So no policy can be trained, tuned or chosen on the
episodes. After all policies are frozen, `python -m research suites open NAME --secret WORDS` checks both hashes,
publishes the secret and builds the suite, and `record NAME` runs the policies. From then on the suite is public, and
the next one is sealed.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from auv_gym.effects.current import RandomCurrent
from auv_gym.effects.faults import RandomFaults
from auv_gym.effects.waves import RandomWaves
from auv_gym.scenarios.presets import PRESETS, SPEED_RANGES, TYPICAL_NOISE
from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation.suites import SuiteError
from baselines.tools.files import json_text, read_json, write_atomically

Changes = dict[str, dict[str, Any]]  # fields of a scenario that differ from the storm, by the name of the change
SEALS = Path(__file__).parent / "seals.json"
"""File with the SHA-256 of each secret, and with the secrets of opened suites."""

LAG = (1.5, 2.5)  # [s] time constants of the actuators
_WEAK = (0.35, 0.55)  # actual force as a share of the commanded force
_PERIOD = 0.05  # [s] control period
_CHOP = (1.2, 2.0)  # [rad/s] frequencies of waves above the usual band
_TURN = {"slow": (-0.04, 0.04), "cruise": (-0.1, 0.1)}  # [rad/s] turn rate of a turning current
ACTUATOR_FAULTS = "surge stuck", "surge dead", "surge one way", "yaw stuck", "yaw dead", "yaw one way"
SENSOR_FAULTS = (
    "all frozen", "heading frozen", "velocity frozen", "yaw rate frozen", "velocity missing", "position jump",
)  # fmt: skip
FAULTS = *ACTUATOR_FAULTS, *SENSOR_FAULTS
"""Kinds of faults of the frozen suites, whatever kinds are added to the package."""


@dataclass(frozen=True)
class Seal:
    """The hashes of a secret and of the scenarios and, after the opening, the secret."""

    sha256: str
    worlds: str  # `worlds_hash` of the suite
    secret: str | None = None  # None: the suite is sealed

    def opened(self, secret: str) -> Seal:
        """Return the seal with its secret.

        Raises:
            SuiteError: the secret does not have this hash.
        """
        if sha256(secret) != self.sha256:
            raise SuiteError(f"this is not the secret: its SHA-256 is {sha256(secret)}, that of the seal {self.sha256}")
        return replace(self, secret=secret)


def sha256(secret: str) -> str:
    """Return the SHA-256 of a secret, in hexadecimal digits."""
    return hashlib.sha256(secret.encode()).hexdigest()


def seals() -> dict[str, Seal]:
    """Return the seals, by the names of their suites."""
    return {name: Seal(**entry) for name, entry in read_json(SEALS).items()}


def write_seal(name: str, seal: Seal) -> None:
    """Write a seal to the file.

    Raises:
        SuiteError: the suite has another seal.
    """
    known = seals()
    if name in known and known[name] != replace(seal, secret=known[name].secret):
        raise SuiteError(f"{name} is sealed already, with SHA-256 {known[name].sha256}")
    write_atomically(SEALS, json_text({key: asdict(entry) for key, entry in sorted((known | {name: seal}).items())}))


def seed(name: str) -> int:
    """Return the seed of an opened suite.

    Raises:
        SuiteError: the suite has no seal, it is sealed, or its scenarios have changed since then.
    """
    seal = seals().get(name)
    if seal is None:
        raise SuiteError(f"{name} has no seal; make one with: python -m research suites seal {name}")
    if seal.secret is None:
        raise SuiteError(f"{name} is sealed: its episodes are published after all policies are frozen")
    if seal.worlds != worlds_hash(name):
        raise SuiteError(f"the scenarios of {name} have changed since it was sealed")
    return int.from_bytes(hashlib.sha256(b"episodes " + seal.secret.encode()).digest()[:8], "big")


def worlds_hash(name: str) -> str:
    """Return the SHA-256 of the scenarios of a sealed suite, none of which follows random waypoints."""
    return sha256(json.dumps([[s.to_dict(), False] for s in sealed_worlds(name)], sort_keys=True))


def sealed_worlds(name: str) -> list[Scenario]:
    """Return the scenarios of a sealed suite: the storm of each speed range with each of its changes."""
    storms = {r: replace(PRESETS[f"{r}-storm"], sensors=TYPICAL_NOISE[r]) for r in SPEED_RANGES}
    return [
        replace(storm, name=f"{speed_range}-{key}", **change)
        for speed_range, storm in storms.items()
        for key, change in CHANGES[name](storm, speed_range).items()
    ]


def _third(storm: Scenario, speed_range: str) -> Changes:
    """Return the changes of sealed-v3. The training of `helm` now has such lags and two kinds of faulty measurements.

    They have faults of actuators or of measurements, actuators with a lag of about two seconds or with half the force,
    half the control period, a turning current, short waves, and a combination of these.
    """
    assert isinstance(storm.current, RandomCurrent)
    assert isinstance(storm.waves, RandomWaves)
    weak = replace(storm.actuators, effectiveness=_WEAK)
    turning, chop = replace(storm.current, turn=_TURN[speed_range]), replace(storm.waves, band=_CHOP)
    return {
        "actuator-faults": {"faults": RandomFaults(ACTUATOR_FAULTS)},
        "sensor-faults": {"faults": RandomFaults(SENSOR_FAULTS)},
        "lag": {"actuators": replace(storm.actuators, lag=LAG)},
        "weak": {"actuators": weak},
        "period": {"control_dt": _PERIOD, "steps": round(storm.duration / _PERIOD)},
        "turning": {"current": turning},
        "chop": {"waves": chop},
        "all-at-once": {
            "faults": RandomFaults(FAULTS, rate=1.0),
            "actuators": weak,
            "current": turning,
            "waves": chop,
        },
    }


CHANGES: Mapping[str, Callable[[Scenario, str], Changes]] = {"sealed-v3": _third}
"""Functions that return the changes of a storm in a speed range, by sealed suite."""
