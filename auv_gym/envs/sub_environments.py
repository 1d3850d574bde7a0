"""The common part of the environments: N sub-environments whose episodes are drawn, planned and given samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache, reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_gym.envs.arguments import checked_reset, checked_steps, scenarios_of, seeded
from auv_gym.envs.vector_api import Autoreset, AutoresetMode, checked_mode
from auv_gym.physics.namespaces import ARRAYS, Array, Indices
from auv_gym.physics.rows import flatten, spread
from auv_gym.physics.vehicle import Vehicle
from auv_gym.planning.paths import Path
from auv_gym.planning.planner import Planner
from auv_gym.scenarios.drawing import Drawing, drawn_as_rows
from auv_gym.scenarios.episode import Episode, with_options
from auv_gym.scenarios.exogenous import ExogenousInputs
from auv_gym.scenarios.scenario import RandomPath, Scenario
from auv_gym.scenarios.vehicles import VehicleModel
from auv_gym.task.kernels import STATES, started
from auv_gym.task.observation import Observation, check_reference, decode, reference_bounds
from auv_gym.task.policy import Forces
from auv_gym.task.preview import Preview, encode_preview
from auv_gym.task.simulation import PARAMETER_ROWS, SAMPLE_ROWS, Parameters, Parts

ScenarioLike = Scenario | str | Mapping[str, Any]

LARGEST_BLOCK = 64  # largest number of control steps that are read at once
BLOCK_SAMPLES = 2**15  # largest number of vehicles times control steps that are read at once; it bounds the memory
FEWEST_ROWS = 4  # fewer episodes of a scenario are drawn one by one, since calls on rows take more time than on floats


class ReadyEpisodes(NamedTuple):
    """Planned episodes of one scenario, for n of the sub-environments that need one."""

    places: Indices  # positions in the array of the sub-environments that need one, shape (n,)
    scenario: Scenario
    episodes: Episode  # n episodes as one whose numbers are rows (n,), or a single one
    tables: Sequence[Array]  # reference tables, shape (steps + 1, 8)
    noise_seeds: Sequence[int]
    constants: Array  # rows of their `simulation.Parameters`, shape (PARAMETER_ROWS, n)
    paths: Sequence[Path]  # empty if there is no preview


class StartedEpisodes(NamedTuple):
    """The first states of n new episodes."""

    indices: Indices  # of the sub-environments, shape (n,)
    plant: Array  # rows of their `simulation.Plant`, shape (PLANT_ROWS, n)
    seen: Array  # first observations without previews, shape (columns, n), see `kernels.started`
    errors: Array  # [m] position errors, shape (n,)


class SubEnvironments:
    """N sub-environments without the simulation: drawing and planning of episodes, samples, previews, autoreset.

    It runs on the host for every back end.

    Args:
        num_envs: N.
        scenario: a scenario, or a sequence of N.
        vehicle: replaces the known vehicle of the scenarios.
        control_dt: control period [s], replaces that of the scenarios.
        preview: control periods ahead, see `Preview`.
        autoreset_mode: when the next episode begins after the end of one.
        max_episode_steps: control steps after which episodes are truncated, if fewer than those of the scenario.

    Attributes:
        all: the indices of all sub-environments, shape (N,).
        scenarios: the scenario of each sub-environment.
        started: whether all sub-environments have been reset.
        samples: a block of samples, shape (block, SAMPLE_ROWS, N).
        row: index of the present sample in the block; -1 if it was the last one of the previous block.
        blocks: number of blocks read so far.
        constants: the rows of `parameters`, shape (PARAMETER_ROWS, N).
        k: control steps since the reset of each sub-environment, shape (N,).
        forces: of the control law whose actions are appended to observations; None without one.
        preview: positions of the references ahead.
        autoreset: the sub-environments whose episodes are over.

    Raises:
        ValueError: a wrong number of sub-environments, scenarios or steps, an unknown mode, or a wrong scenario.
    """

    def __init__(
        self,
        num_envs: int,
        scenario: ScenarioLike | Sequence[ScenarioLike],
        vehicle: Vehicle | VehicleModel | str | Mapping[str, Any] | None,
        control_dt: float | None,
        preview: Sequence[int] = (),
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        max_episode_steps: int | None = None,
    ) -> None:
        if isinstance(num_envs, bool) or not isinstance(num_envs, int) or num_envs < 1:
            raise ValueError(f"num_envs is {num_envs!r}; it must be an integer of at least 1")
        self.scenarios = scenarios_of(scenario, num_envs, vehicle, control_dt)
        self.all: Indices = np.arange(num_envs)
        self.started = False
        self.forces: Forces | None = None
        self._generators: list[np.random.Generator | None] = [None] * num_envs  # made when first used
        self._dt = np.array([s.control_dt for s in self.scenarios])
        self._steps = np.array([s.steps for s in self.scenarios])
        self._lengths = np.minimum(self._steps, checked_steps(max_episode_steps))
        self.autoreset = Autoreset(num_envs, checked_mode(autoreset_mode))
        block = max(1, min(LARGEST_BLOCK, BLOCK_SAMPLES // num_envs))
        self._exogenous = ExogenousInputs(num_envs, block)
        self.preview = Preview(num_envs, preview, int(self._steps.max()))
        self._fixed_tables: dict[tuple[Any, ...], Array] = {}  # of scenarios with a fixed path
        self.samples, self.row, self.blocks = np.zeros((block, SAMPLE_ROWS, num_envs)), 0, 0
        self._previous = self.samples[0]  # the last sample of the previous block
        self.constants = np.ones((PARAMETER_ROWS, num_envs))
        self.parts = reduce(Parts.joined, {s.parts: None for s in self.scenarios})
        self.parameters = Parameters.of(tuple(self.constants), self.parts)
        self.k: Indices = np.zeros(num_envs, dtype=np.int64)
        self._remaining = 0  # lower bound of the control steps until an episode is truncated

    @property
    def sample(self) -> Any:
        """The samples of the present time, shape (SAMPLE_ROWS, N)."""
        return self._previous if self.row < 0 else self.samples[self.row]

    @property
    def time(self) -> Array:
        """Time since each reset [s], shape (N,)."""
        return np.asarray(self.k * self._dt)

    @property
    def truncating(self) -> NDArray[np.bool_]:
        """Whether the next control step is the last one of each episode, shape (N,)."""
        if self._remaining > 0:
            return np.zeros(len(self.all), dtype=bool)
        remaining = self._lengths - self.k - 1
        self._remaining = int(remaining.min())
        ending: NDArray[np.bool_] = remaining <= 0
        return ending

    def next_sample(self) -> Array:
        """Return the samples at the end of the next control step, shape (SAMPLE_ROWS, N); the time does not change."""
        if self.row + 1 == len(self.samples):
            self.read()
        sample: Array = self.samples[self.row + 1]
        return sample

    def advance(self) -> None:
        """Advance the time by one control step, after a call of `next_sample`."""
        self.row += 1
        self.k += 1
        self._remaining -= 1

    def reset(self, seed: int | Sequence[int | None] | None, options: Mapping[str, Any] | None) -> StartedEpisodes:
        """Start new episodes in all sub-environments, or in those of `options["reset_mask"]`; i has seed + i.

        Raises:
            ValueError: wrong options or seeds, or an episode that cannot be planned; nothing has changed then.
        """
        indices, choices = checked_reset(options, len(self.all), self.started)
        generators = seeded(self._generators, seed)
        planned = self.ready(indices, generators, choices)
        for i in indices.tolist():
            self._generators[i] = generators[i]
        return self.begin(indices, planned)

    def next_episodes(self, indices: Indices) -> list[ReadyEpisodes]:
        """Return a planned episode for each of these sub-environments.

        Raises:
            ValueError: see `Scenario.drawn`; nothing has changed then.
        """
        return self.ready(indices, self._generators, None)

    def ready(
        self, indices: Indices, generators: Sequence[Any], choices: Sequence[Mapping[str, Any]] | None
    ) -> list[ReadyEpisodes]:
        """Return a planned episode for each of these sub-environments.

        Args:
            indices: of the sub-environments, shape (n,).
            generators: N random generators.
            choices: checked options of `reset` for N sub-environments; None without any.

        Raises:
            ValueError: see `Scenario.drawn`; nothing has changed then.
        """
        states = {i: generators[i].bit_generator.state for i in indices.tolist()}
        single: list[int] = []  # positions in `indices` of the episodes that are drawn one by one
        groups: dict[int, list[int]] = {}  # those of the episodes that are drawn as rows, by scenario
        for place, i in enumerate(states):
            if choices and choices[i]:
                single.append(place)
            else:
                groups.setdefault(id(self.scenarios[i]), []).append(place)
        found: list[ReadyEpisodes] = []
        try:
            for places in map(np.array, groups.values()):
                scenario = self.scenarios[int(indices[places[0]])]
                if len(places) < FEWEST_ROWS or not drawn_as_rows(scenario):
                    single += places.tolist()
                    continue
                own = [generators[i] for i in indices[places].tolist()]
                rows, refused = self._rows(scenario, places, own)
                for place in refused:
                    generators[indices[place]].bit_generator.state = states[int(indices[place])]
                found += rows
                single += refused
            for place in single:
                i = int(indices[place])
                found.append(self._single(self.scenarios[i], place, generators[i], choices[i] if choices else {}))
        except ValueError:
            for i, state in states.items():
                generators[i].bit_generator.state = state
            raise
        return found

    def _rows(
        self, scenario: Scenario, places: Indices, generators: Sequence[np.random.Generator]
    ) -> tuple[list[ReadyEpisodes], list[int]]:
        """Return planned episodes of a scenario, drawn as rows, and the places of those that are infeasible."""
        drawing = Drawing(scenario, generators)
        tables: list[Array | None] = [None] * len(places)
        if not isinstance(scenario.path, RandomPath):
            tables = [self.fixed_table(scenario)] * len(places)
        planner = planner_of(*plan_of(scenario))
        for members, stacked in drawing.paths:
            for j, table in zip(members.tolist(), planner.tables(stacked, len(members)), strict=True):
                tables[j] = table
        refused = [j for j, table in enumerate(tables) if table is None]
        kept = np.array([j for j, table in enumerate(tables) if table is not None])
        if len(kept) < FEWEST_ROWS:
            return [], places.tolist()
        episodes = drawing.episodes(kept)
        constants = spread(flatten(scenario.constants(episodes)), len(kept))
        paths = drawing.single(kept) if self.preview.periods else []
        feasible, seeds = [table for table in tables if table is not None], [drawing.seeds[j] for j in kept.tolist()]
        rows = ReadyEpisodes(places[kept], scenario, episodes, feasible, seeds, constants, paths)
        return [rows], places[refused].tolist()

    def _single(
        self, scenario: Scenario, place: int, rng: np.random.Generator, options: Mapping[str, Any]
    ) -> ReadyEpisodes:
        """Return one planned episode: that of the options of `reset`, or a random feasible one."""

        def table_of(episode: Episode) -> Array:
            if episode.path is scenario.path:
                return self.fixed_table(scenario)
            return reference_table(episode.path, *plan_of(scenario), many=len(self.all) > 1)

        if chosen := options.get("episode"):
            episode, table = chosen, table_of(chosen)
        else:
            episode, table = scenario.drawn(rng, table_of)
        episode = with_options(episode, options)
        constants = spread(flatten(scenario.parameters(episode)), 1)
        places, seeds = np.array([place]), [episode.noise_seed]
        return ReadyEpisodes(places, scenario, episode, [table], seeds, constants, [episode.path])

    def begin(self, indices: Indices, ready: Sequence[ReadyEpisodes]) -> StartedEpisodes:
        """Start these episodes in n sub-environments and return their first states."""
        states, errors = self.load(indices, ready)
        given = states, self.sample[:, indices], self.constants[:, indices], self.forces
        return StartedEpisodes(indices, *started(self.parts, *given), errors)

    def load(self, indices: Indices, ready: Sequence[ReadyEpisodes]) -> tuple[Array, Array]:
        """Load episodes into n sub-environments; return their first states (STATES, n) and position errors (n,) [m]."""
        states, errors = np.empty((STATES, len(indices))), np.empty(len(indices))
        for places, scenario, episodes, tables, noise_seeds, constants, paths in ready:
            own = indices[places]
            self._exogenous.load_rows(own, scenario, episodes, tables, noise_seeds)
            self.constants[:, own] = constants
            self.preview.load(own, paths, scenario.control_dt, tables)
            firsts: Any = tables[0][0].tolist() if len(tables) == 1 else np.array([table[0] for table in tables]).T
            states[:, places] = spread(episodes.initial_state(firsts), len(tables))
            errors[places] = np.hypot(*episodes.initial_error[:2])
        self.started = True
        self.k[indices], self._remaining = 0, 0
        self.autoreset.over[indices] = False
        if self.row < 0:
            self._previous[:, indices] = self._exogenous.read(indices, 1)[0]
        self._exogenous.read_into(self.samples[max(self.row, 0) :], indices, indices)
        return states, errors

    def read(self) -> None:
        """Read the next block of samples."""
        self._previous = self.samples[-1].copy()
        self._exogenous.read_into(self.samples, self.all, self.all)
        self.row, self.blocks = -1, self.blocks + 1

    def with_preview(self, rows: Array, indices: Indices) -> Array:
        """Return the observations (SIZE, n) of n sub-environments with their previews, a new array (columns, n)."""
        if not self.preview.periods:
            return rows.copy()
        ahead, o = self.preview.ahead(indices, self.k[indices]), Observation._make(decode(rows, ARRAYS))
        return np.vstack((rows, encode_preview(ahead, o, ARRAYS, self.parts.span)))

    def fixed_table(self, scenario: Scenario) -> Array:
        """Return the reference table of a scenario with a fixed path.

        Raises:
            ValueError: see `reference_table`.
        """
        assert not isinstance(scenario.path, RandomPath)
        key = id(scenario.path), plan_of(scenario)
        if key not in self._fixed_tables:
            self._fixed_tables[key] = reference_table(scenario.path, *plan_of(scenario), many=len(self.all) > 1)
        return self._fixed_tables[key]


def plan_of(scenario: Scenario) -> tuple[float, int, Vehicle, float, float, float, int]:
    """Return the arguments of `reference_table` after the path."""
    s, act = scenario, scenario.actuators
    return s.control_dt, s.steps, s.vehicle, act.F_u_max, act.F_r_max, act.fin, s.span


def reference_table(
    path: Path,
    dt: float,
    steps: int,
    vehicle: Vehicle,
    F_u_max: float,
    F_r_max: float,
    fin: float,
    span: int,
    *,
    many: bool = True,
) -> Array:
    """Return the reference table of a path, shape (steps + 1, 8).

    Args:
        path: the path of an episode.
        dt: control period [s].
        steps: control steps of an episode.
        vehicle: the known vehicle.
        F_u_max: largest |F_u| [N].
        F_r_max: largest |F_r| [N m].
        fin: parameter of the fins [kg], see `actuators.Actuators`.
        span: of the scenario, see `observation.bounds`.
        many: see `planning.kernels.driver`.

    Raises:
        InfeasibleReferenceError: the path cannot be followed within these limits.
        ValueError: the reference exceeds the bounds of observations.
    """
    planner = planner_of(dt, steps, vehicle, F_u_max, F_r_max, fin, span, many=many)
    table = planner.table(path)
    if table is None:  # one of these calls raises the error
        table = planner.plan(path).table
        check_reference(table, span)
    return table


def reference_tables(episodes: Sequence[Episode], *given: Any) -> list[Array]:
    """Return the `reference_table` of the path of each episode, for its other arguments."""
    return [reference_table(episode.path, *given) for episode in episodes]


@lru_cache(maxsize=64)
def planner_of(
    dt: float, steps: int, vehicle: Vehicle, F_u_max: float, F_r_max: float, fin: float, span: int, *, many: bool = True
) -> Planner:
    """Return the planner of a scenario; for the arguments see `reference_table`."""
    times: Array = dt * np.arange(steps + 1, dtype=np.float64)
    return Planner(vehicle, times, (F_u_max, F_r_max), fin, reference_bounds(span), many=many)
