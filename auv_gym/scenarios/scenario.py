"""The scenario: a distribution of episodes, composed of small frozen objects, with JSON and TOML files."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from auv_gym.effects import PACKAGE, Autopilot, Effect
from auv_gym.effects.actuators import Actuators, Response
from auv_gym.effects.base import EFFECTS, uniform_of
from auv_gym.effects.current import Current, RandomCurrent
from auv_gym.effects.faults import RandomFaults
from auv_gym.effects.mismatch import RandomMismatch
from auv_gym.effects.sensors import Sensors
from auv_gym.effects.space import SPACE_PACKAGE
from auv_gym.effects.waves import RandomWaves
from auv_gym.physics.dynamics import Load
from auv_gym.physics.intervals import Interval, Uniform, check_interval, check_number, draw, signed
from auv_gym.physics.namespaces import Array, Number
from auv_gym.physics.space import Limits, SpaceVehicle
from auv_gym.physics.stiffness import AT_REST, check_step, substeps_for
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.planning.paths import PAPER_CIRCLE, PATHS, Path
from auv_gym.planning.paths.space import HEIGHTS, SPACE_PATHS, SpacePath, WithHeight
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.records import checked_suffix, from_record, guarded, meant, read_table, to_record
from auv_gym.scenarios.vehicles import VehicleModel, as_vehicle, model_from
from auv_gym.scenarios.vertical import Vertical
from auv_gym.task.model import PLANE
from auv_gym.task.observation import TERMS, reference_bounds
from auv_gym.task.simulation import Parameters, Parts
from auv_gym.task.space import SPACE, SpaceResponse

if TYPE_CHECKING:
    from auv_gym.planning.planner import Planner
    from auv_gym.planning.reserves import Reserves
    from auv_gym.planning.space import SpacePlanner

T = TypeVar("T")
DRAWS = 96
"""Number of uniform numbers that are reserved for the parameters of one episode."""
_USUAL = {term.name: term.bound * term.scale for term in TERMS}
"""Usual bound of each term of an observation, in SI units, see `task.bounds`."""
MOST_STEPS = 10**6  # control steps of an episode
ATTEMPTS = 20
"""Largest number of draws until an episode has a feasible path."""


@dataclass(frozen=True)
class RandomPath:
    """Distribution of the path: a family, a nominal speed, and a member whose turn rate is at most `turn_rate`.

    Only the lobes of a figure-eight turn faster, by a factor of 1.2 to 1.75.
    """

    speed: Interval  # [m/s]
    turn_rate: float  # [rad/s]
    families: tuple[str, ...] = ("line", "circle", "sine", "figure_eight", "random_smooth")

    def __post_init__(self) -> None:
        check_interval("path speed", self.speed, 1e-2)
        check_number("path turn_rate", self.turn_rate, 1e-6, 1e2)
        allowed = [name for name, cls in PATHS.items() if hasattr(cls, "drawn")]
        if not isinstance(self.families, (tuple, list)):
            raise ValueError(f"path families is {self.families!r}; it must be a list, such as [{self.families!r}]")
        for name in self.families:
            if name not in allowed:
                raise ValueError(
                    f"unknown path family {name!r}{meant(name, allowed)}; allowed are {', '.join(allowed)}"
                )
        if not self.families:
            raise ValueError(f"path families is empty; name at least one of {', '.join(allowed)}")

    def draw(self, uniform: Uniform) -> Path:
        """Return one path."""
        return self.member(int(uniform() * len(self.families)), uniform)

    def member(self, family: int, uniform: Uniform) -> Path:
        """Return a path of a family by its index, or N paths as one, see `stack`, from rows of the stream."""
        drawn: Path = PATHS[self.families[family]].drawn(draw(self.speed, uniform), self.turn_rate, uniform)  # type: ignore[attr-defined]
        return drawn


@dataclass(frozen=True)
class Start:
    """Distribution of the initial state about the reference; errors take random signs if `random_signs`."""

    x_e: Interval = 0.0  # [m] in the world
    y_e: Interval = 0.0  # [m]
    psi_e: Interval = 0.0  # [rad]
    surge: Interval = 1.0  # surge velocity relative to the water, as a fraction of u_R; sway and yaw rate start at 0
    random_signs: bool = False

    def __post_init__(self) -> None:
        for name in ("x_e", "y_e"):
            check_interval(f"start {name}", getattr(self, name), -1e3, 1e3)
        check_interval("start psi_e", self.psi_e, -math.pi, math.pi)
        check_interval("start surge", self.surge, -10, 10)
        if not isinstance(self.random_signs, bool):
            raise ValueError(f"start random_signs is {self.random_signs!r}; it must be true or false")


_PARTS: dict[str, tuple[type, ...]] = {
    "path": (RandomPath, Path, SpacePath),
    "vehicle": (Vehicle,),
    "mismatch": (RandomMismatch, type(None)),
    "current": (RandomCurrent, type(None)),
    "waves": (RandomWaves, type(None)),
    "sensors": (Sensors,),
    "actuators": (Actuators,),
    "start": (Start,),
    "faults": (RandomFaults, type(None)),
    "vertical": (Vertical, type(None)),
}


@dataclass(frozen=True)
class Scenario:
    """A task: path, vehicle, disturbances, sensors, actuators, start, clock and reward; intervals are distributions."""

    name: str = "custom"
    path: Path | SpacePath | RandomPath = PAPER_CIRCLE
    vehicle: Vehicle = PAPER_VEHICLE  # the nominal vehicle, for which the reference is planned
    mismatch: RandomMismatch | None = None  # None: the true vehicle is the nominal one
    current: RandomCurrent | None = None
    waves: RandomWaves | None = None
    sensors: Sensors = field(default_factory=Sensors)
    actuators: Actuators = field(default_factory=Actuators)
    start: Start = field(default_factory=Start)
    faults: RandomFaults | None = None
    vertical: Vertical | None = None  # None: motion in the plane
    effects: tuple[Effect, ...] = ()  # of classes made by `auv_gym.effects.effect`
    control_dt: float = 0.1  # [s] control period
    steps: int = 1000  # control steps until truncation
    substeps: int = 1  # Runge-Kutta steps in a control period
    error_scale: float = 0.5  # [m] position error at which the reward is 0.71
    rate_weight: float = 0.05  # penalty for the squared change of the action
    lost_distance: float = 30.0  # [m] position error that terminates
    model: VehicleModel | None = field(default=None, compare=False, repr=False)  # of the vehicle; not in records

    def __post_init__(self) -> None:
        if not self.name or not isinstance(self.name, str) or not self.name.isprintable():
            raise ValueError(f"scenario name is {self.name!r}; it must be a string of printable characters, not empty")
        for name, kinds in _PARTS.items():
            if not isinstance(getattr(self, name), kinds):
                allowed = " or ".join("None" if kind is type(None) else kind.__name__ for kind in kinds)
                raise ValueError(f"scenario {name} is {getattr(self, name)!r}; it must be a {allowed}")
        if not isinstance(self.effects, tuple) or not all(
            isinstance(e, Effect) and is_dataclass(e) for e in self.effects
        ):
            raise ValueError(
                f"scenario effects is {self.effects!r}; it must be a tuple of objects whose classes are made by "
                "auv_gym.effects.effect"
            )
        if len({one.name for one in self.effects}) < len(self.effects):
            raise ValueError("scenario effects has two of one name; give each effect once")
        for name, high in (("steps", MOST_STEPS), ("substeps", 1000)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= high:
                raise ValueError(f"{name} is {value!r}; it must be an integer in [1, {high}]")
        check_number("control_dt", self.control_dt, 1e-3, 10)
        check_number("error_scale", self.error_scale, 1e-6, 1e6)
        check_number("rate_weight", self.rate_weight, 0, 1e6)
        check_number("lost_distance", self.lost_distance, 1e-3, 1e5)
        ends = (e if isinstance(e, tuple) else (e, e) for e in (self.start.x_e, self.start.y_e))
        if (nearest := math.hypot(*(max(low, -high, 0.0) for low, high in ends))) > self.lost_distance:
            raise ValueError(
                f"start x_e, y_e are {nearest:g} m or more; raise lost_distance from {self.lost_distance:g} m"
            )
        if self.mismatch is not None:
            self.mismatch.check(self.vehicle)
        self._check_step(self._stiffest)
        if self.vertical is not None:
            self.vertical.check(self)
        elif isinstance(self.path, SpacePath):
            raise ValueError("the path is one in space; give the scenario a vertical part, vertical=Vertical(...)")
        if not isinstance(self.path, RandomPath) and not self.path.start <= 0 < self.duration <= self.path.end:
            raise ValueError(
                f"the path runs from {self.path.start:.6g} to {self.path.end:.6g} s, the episode from 0 to "
                f"{self.duration:.6g} s; lower steps or control_dt, or make the path longer"
            )

    @property
    def _stiffest(self) -> tuple[Any, ...]:
        """The coefficients of the stiffest true vehicles, as rows, or of the only one."""
        return self.mismatch.extremes(self.vehicle) if self.mismatch else self.vehicle.all_coefficients

    @property
    def largest_load(self) -> Load:
        """Largest force in surge [N] and sway [N] and largest moment in yaw [N m] of actuators and waves."""
        surge, sway, yaw = self.actuators.F_u_max, 0.0, self.actuators.F_r_max
        if self.waves is not None:
            speed = self.path.speed[1] if isinstance(self.path.speed, tuple) else self.path.speed
            waves = self.waves.draw(lambda: 0.0, speed, self.vehicle)
            surge, sway, yaw = surge + waves.surge, waves.sway, yaw + waves.yaw
        return surge, sway, yaw

    def _check_step(self, coefficients: Sequence[Any], speeds: Load = AT_REST) -> None:
        """Raise ValueError if the integration step is too long for a true vehicle, or for several in rows."""
        check_step(self.control_dt / self.substeps, coefficients, self.largest_load, speeds)

    @property
    def least_substeps(self) -> int:
        """The smallest valid `substeps` for its vehicles, actuators and waves."""
        least = substeps_for(self.control_dt, self._stiffest, self.largest_load)
        return least if self.vertical is None else max(least, self.vertical.least_substeps(self))

    @property
    def known(self) -> Vehicle | VehicleModel | SpaceVehicle:
        """What policies get: `known_plane`, in space the vehicle with five degrees of freedom."""
        return self.known_plane if self.vertical is None else self.vertical.vehicle(self)

    @property
    def known_plane(self) -> Vehicle | VehicleModel:
        """The vehicle in the plane, with its actuators if the scenario was adapted to a vehicle model."""
        return self.model if self.model is not None and self.model.vehicle == self.vehicle else self.vehicle

    @property
    def bare(self) -> Vehicle | SpaceVehicle:
        """The known vehicle without its actuators."""
        return self.vehicle if self.vertical is None else self.vertical.vehicle(self)

    @property
    def duration(self) -> float:
        """Length of an episode [s]."""
        return self.steps * self.control_dt

    def draw(self, rng: np.random.Generator) -> Episode:
        """Return one episode; the generator advances by the same amount for every episode."""
        numbers, noise_seed = rng.random(DRAWS).tolist(), int(rng.integers(2**63))
        uniform, path = iter(numbers).__next__, self.path
        if isinstance(path, RandomPath):
            path = path.draw(uniform)
        sensors, duration = self.sensors, self.duration
        episode = self.episode(path, uniform, noise_seed)
        if sensors.outages:
            outages = sensors.draw_outages(np.random.default_rng([noise_seed, 1]), duration)
            episode = replace(episode, outages=outages)
        if sensors.reckoning:
            reckoning = sensors.reckoning.draw(np.random.default_rng([noise_seed, 2]), duration)
            episode = replace(episode, reckoning=reckoning)
        if self.faults:
            faults = self.faults.draw(np.random.default_rng([noise_seed, 4]), duration)
            episode = replace(episode, faults=faults)
        episode = self.completed(episode, noise_seed)
        return episode if self.vertical is None else self.vertical.extended(episode, self, noise_seed)

    def completed(self, episode: Episode, noise_seeds: Any) -> Episode:
        """Return an episode with the numbers that have a stream of their own: those of the noise, and `effects`.

        Also N episodes with rows, for their noise seeds (N,).
        """
        if self.sensors.draws_noise:
            episode = replace(episode, noise=self.sensors.draw_noise(uniform_of("noise", noise_seeds)))
        if self.sensors.correlation != 0:
            time: Any = draw(self.sensors.correlation, uniform_of("correlation", noise_seeds))
            episode = replace(episode, correlation=time)
        if not self.effects:
            return episode
        drawn = ((one.name, one.draw(uniform_of(one.name, noise_seeds))) for one in self.effects)
        return replace(episode, effects=tuple(drawn))

    def noise_of(self, episode: Episode) -> tuple[Number, ...]:
        """Return the standard deviations of the measurements in an episode."""
        return self.sensors.noise if episode.noise is None else episode.noise

    def episode(self, path: Path, uniform: Uniform, noise_seed: int) -> Episode:
        """Return the episode of a path from a uniform stream, without outages, dead reckoning and faults.

        Args:
            path: path of the episode, or N paths as one, see `stack`.
            uniform: the stream, with numbers or with rows of shape (N,), see `draw`.
            noise_seed: seed of the noise of the episode.

        Returns:
            The episode; with rows in the stream its numbers are rows of shape (N,).
        """
        start, act, known = self.start, self.actuators, self.vehicle
        vehicle = self.mismatch.draw(uniform, known) if self.mismatch else known
        x_e, y_e, psi_e = (draw(x, uniform) for x in (start.x_e, start.y_e, start.psi_e))
        if start.random_signs:
            x_e, y_e, psi_e = (signed(e, uniform) for e in (x_e, y_e, psi_e))
        return Episode(
            path=path,
            vehicle=vehicle,
            current=self.current.draw(uniform, path.speed) if self.current else Current(),
            waves=self.waves.draw(uniform, path.speed, known) if self.waves else None,
            bias=self.sensors.draw_bias(uniform),
            lag=draw(act.lag, uniform),
            initial_error=(x_e, y_e, psi_e),
            surge=draw(start.surge, uniform),
            noise_seed=noise_seed,
            effectiveness=(draw(act.effectiveness, uniform), draw(act.effectiveness, uniform)),
            reach=(draw(act.reach, uniform), draw(act.reach, uniform)),
            delay=_rounded(draw(act.delay, uniform)),
        )

    def drawn(self, rng: np.random.Generator, plan: Callable[[Episode], T]) -> tuple[Episode, T]:
        """Return an episode and the result of `plan(episode)`; after a ValueError of `plan` another episode is drawn.

        Raises:
            ValueError: `plan` refused a fixed path, or `ATTEMPTS` random ones; the state of the generator is unchanged.
        """
        state = rng.bit_generator.state
        for left in reversed(range(ATTEMPTS if isinstance(self.path, RandomPath) else 1)):
            episode = self.draw(rng)
            try:
                return episode, plan(episode)
            except ValueError:
                if not left:
                    rng.bit_generator.state = state
                    raise
        raise AssertionError("unreachable")

    @cached_property
    def parts(self) -> Parts:
        """The parts of the simulation that its episodes use."""
        effects = dict.fromkeys((*(e for e in self._package if e.used(self)), *(type(one) for one in self.effects)))
        return Parts(self.substeps, tuple(effects), self.bound_factor, SPACE if self.vertical else PLANE)

    @property
    def takes_setpoints(self) -> bool:
        """Whether actions are setpoints of an `Autopilot`, not forces."""
        return Autopilot in self.parts.effects

    @property
    def _package(self) -> tuple[type[Effect], ...]:
        """The effects of the package for its kind of motion."""
        return SPACE_PACKAGE if self.vertical else PACKAGE

    @property
    def bound_factor(self) -> int:
        """Factor of the usual bounds of its observations, a power of two, see `task.bounds`."""
        act = self.actuators
        needed = act.F_u_max / _USUAL["F_u_max"], act.F_r_max / _USUAL["F_r_max"], self.lost_distance / _USUAL["e_x"]
        return int(2 ** max(0, math.ceil(math.log2(max(needed)))))

    @property
    def planner(self) -> Any:
        """The planner of the references of its paths, for the known vehicle; equal scenarios share it.

        It is a `Planner`, in space a `SpacePlanner`.
        """
        act = self.actuators
        if self.vertical is not None:
            known, most = self.vertical.vehicle(self), self.vertical.limits(act)
            return _space_planner(known, self.control_dt, self.steps, most, self.bound_factor)
        limits = act.F_u_max, act.F_r_max
        return _planner(self.vehicle, self.control_dt, self.steps, limits, act.fin, self.bound_factor)

    def reserves(self, episode: Episode) -> Reserves:
        """Return what the known vehicle's motion on its path leaves of the limits, in the mean current of an episode.

        Gusts, shear and turn of the current are left out, see `auv_gym.planning.reserves.reserves`.

        Raises:
            ValueError: the scenario is one in space, or the motion cannot be planned in the current.
        """
        if self.vertical is not None:
            raise ValueError(f"reserves are for motion in the plane; scenario {self.name!r} is one in space")
        from auv_gym.planning.reserves import reserves

        act, now, path = self.actuators, episode.current, episode.path
        times: Array = self.control_dt * np.arange(self.steps + 1, dtype=np.float64)
        strength, slowest = math.hypot(now.V_x, now.V_y), float(np.hypot(*path.derivatives(times)[1]).min())
        share = now.cap * slowest / strength if now.cap * slowest < strength else 1.0
        current = share * now.V_x, share * now.V_y
        return reserves(path, self.vehicle, times, (act.F_u_max, act.F_r_max), act.fin, current)

    def parameters(self, episode: Episode, parts: Parts | None = None) -> Parameters:
        """Return the constants of an episode.

        Args:
            episode: of this scenario.
            parts: with the effects whose constants are returned; None: those of the scenario.

        Raises:
            ValueError: the episode has an effect that the scenario does not have, or the integration step is too long.
        """
        there = [e.what for e in self._package if e not in self.parts.effects and e.there(episode)]
        there += [
            f"the effect {name!r}" for name, _ in episode.effects if name not in [one.name for one in self.effects]
        ]
        if there:
            raise ValueError(f"the episode has {there[0]}, but scenario {self.name!r} has none; change one of them")
        if self.vertical is None and (
            episode.initial_velocity is not None or (self.mismatch is None and episode.vehicle is not self.vehicle)
        ):
            self._check_step(episode.vehicle.all_coefficients, episode.initial_velocity or AT_REST)  # type: ignore[arg-type]
        return self.constants(episode, parts)

    def constants(self, episode: Episode, parts: Parts | None = None) -> Parameters:
        """Return the `parameters` of an episode of this scenario, or rows of them."""
        act, parts = self.actuators, parts or self.parts
        limits = {"u": act.F_u_max, "r": act.F_r_max}
        response: Any = Response.of(episode.lag, act.F_u_rate, act.F_r_rate, self.control_dt)
        if self.vertical is not None:
            limits["q"], response = self.vertical.limits(act).F_q_max, SpaceResponse.of(response)
        channels = zip(parts.model.channels, episode.effectiveness, strict=True)
        constants: Parameters = parts.model.Parameters(
            h=self.control_dt / self.substeps,
            coefficients=episode.vehicle.coefficients,
            response=response,
            error_scale=self.error_scale,
            rate_weight=self.rate_weight,
            lost_distance=self.lost_distance,
            parts=parts,
            own=tuple(x for effect in parts.effects for x in effect.constants(self, episode)),
            **{f"F_{c}_max": limit for c, limit in limits.items()},
            **{f"thrust_{c}": limits[c] * share for c, share in channels},
        )
        return constants

    def to_dict(self) -> dict[str, Any]:
        """Return the scenario as plain dicts, lists, numbers and strings, without fields that have their default.

        It has no model of the vehicle, whose numbers are those of the vehicle and the actuators.
        """
        record = to_record(self)
        if not isinstance(self.path, RandomPath):
            record["path"] = path_record(self.path)
        if self.effects:
            record["effects"] = {one.name: to_record(one) for one in self.effects}
        return {"name": self.name, **record}

    @property
    def record(self) -> dict[str, Any]:
        """The same with the model of the vehicle, which policies get."""
        return self.to_dict() | ({"model": to_record(self.model)} if self.model else {})

    @classmethod
    def from_dict(cls, record: Mapping[str, Any]) -> Scenario:
        """Return the scenario of a dict in the format of `to_dict` or of a spec's JSON; `vehicle` may also be a name.

        Raises:
            ValueError: an entry is unknown or wrong; the message names it and the allowed values.
        """
        special = {"path": path_from, "vehicle": as_vehicle, "effects": effects_from, "model": _model_from}
        return from_record(cls, record, "scenario", special)

    def save(self, file: str | FilePath) -> None:
        """Write the scenario to a .json or .toml file."""
        file = FilePath(file)
        if checked_suffix(file) == ".json":
            text = json.dumps(self.record, indent=2, allow_nan=False) + "\n"
        else:
            import tomli_w

            text = tomli_w.dumps(self.record)
        file.write_text(text, encoding="utf-8")

    @classmethod
    def load(cls, file: str | FilePath) -> Scenario:
        """Return the scenario of a .json or .toml file.

        Raises:
            ValueError: the file is no valid JSON or TOML, or has a wrong entry.
            OSError: the file cannot be read.
        """
        record = read_table(FilePath(file))
        with guarded(str(file)):
            return cls.from_dict(record)


@lru_cache(maxsize=64)
def _planner(
    vehicle: Vehicle, control_dt: float, steps: int, limits: tuple[float, float], fin: float, bound_factor: int
) -> Planner:
    # Imported here: it loads the compiler of equations, which scenarios alone do not need.
    from auv_gym.planning.planner import Planner

    times: Array = control_dt * np.arange(steps + 1, dtype=np.float64)
    return Planner(vehicle, times, limits, fin, reference_bounds(bound_factor))


@lru_cache(maxsize=64)
def _space_planner(
    vehicle: SpaceVehicle, control_dt: float, steps: int, limits: Limits, bound_factor: int
) -> SpacePlanner:
    from auv_gym.planning.space import SpacePlanner

    times: Array = control_dt * np.arange(steps + 1, dtype=np.float64)
    return SpacePlanner(vehicle, times, limits, reference_bounds(bound_factor, SPACE.layout))


def _rounded(delay: Number) -> Any:
    return np.round(delay) if isinstance(delay, np.ndarray) else round(delay)


def _model_from(record: Any) -> VehicleModel | None:
    return None if record is None else model_from(record, "model")


def effects_from(record: Any) -> tuple[Effect, ...]:
    """Return the effects of a table with a table for each; none for an empty list.

    In a list, as in the JSON of a spec that Gymnasium makes, the names of its entries tell an effect.

    Raises:
        ValueError: a name is unknown, since reading a scenario never imports code, or an entry is unknown or wrong.
    """
    if isinstance(record, (list, tuple)) and all(isinstance(one, Mapping) for one in record):
        found = [[name for name, cls in EFFECTS.items() if {*cls.entries} == {*one}] for one in record]
        if all(len(names) == 1 for names in found):
            record = {names[0]: one for names, one in zip(found, record, strict=True)}
    if not isinstance(record := record or {}, Mapping):
        raise ValueError(f"scenario effects is {record!r}; it must be a table with a table for each effect")
    if unknown := [name for name in record if name not in EFFECTS]:
        raise ValueError(
            f"unknown effect {unknown[0]!r}; known are {', '.join(EFFECTS) or 'none'}. Import the file that defines it "
            "first, or name it: auv-gym evaluate --effects FILE.py"
        )
    return tuple(from_record(EFFECTS[name], entries, f"effect {name}") for name, entries in record.items())


def path_record(path: Path) -> dict[str, Any]:
    """Return a path as a dict with the name of its family, see `path_from`.

    Raises:
        ValueError: its class is not in `auv_gym.planning.paths.PATHS`.
    """
    families = PATHS | SPACE_PATHS
    family = next((name for name, cls in families.items() if type(path) is cls), None)
    if family is None:
        raise ValueError(f"{type(path).__name__} is not in auv_gym.planning.paths.PATHS, so it cannot be written")
    record = {"family": family, **to_record(path)}
    if isinstance(path, WithHeight):
        kind = next(name for name, cls in HEIGHTS.items() if type(path.height) is cls)
        record |= {"path": path_record(path.path), "height": {"kind": kind, **to_record(path.height)}}
    return record


def _height_from(record: Any) -> Any:
    """Return the height of a dict with its kind, see `path_record`."""
    kind = record.get("kind") if isinstance(record, Mapping) else None
    if kind not in HEIGHTS:
        raise ValueError(f"path height is {record!r}; it must be a table with a kind, one of {', '.join(HEIGHTS)}")
    return from_record(HEIGHTS[kind], {key: x for key, x in record.items() if key != "kind"}, f"height {kind}")


def path_from(record: Any) -> Any:
    """Return the path of a dict in the format of `path_record`, or a `RandomPath` if the dict has no family.

    Raises:
        ValueError: the family is unknown, or an entry is unknown or wrong.
    """
    if not isinstance(record, Mapping):
        raise ValueError(f"scenario path is {record!r}; it must be a table with a family, or with speed and turn_rate")
    rest = dict(record)
    # In the JSON of a spec a path has no family, but all of its entries.
    whole = (name for name, cls in PATHS.items() if {f.name for f in fields(cls)} == {*rest})
    if (family := rest.pop("family", None) or next(whole, None)) is None:
        return from_record(RandomPath, rest, "path")
    families = PATHS | SPACE_PATHS
    if not isinstance(family, str) or family not in families:
        raise ValueError(f"unknown path family {family!r}{meant(family, families)}; allowed are {', '.join(families)}")
    special = {"path": path_from, "height": _height_from} if family == "with_height" else None
    return from_record(families[family], rest, f"path {family}", special)
