"""What the environments of many vehicles share: N lanes of episodes, drawn, planned and supplied with samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache, reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_gym.envs.arguments import checked_reset, checked_steps, scenarios_of, seeded
from auv_gym.envs.vector_api import AutoresetMode, Ends, checked_mode
from auv_gym.physics.namespaces import ARRAYS, Array, Indices
from auv_gym.physics.rows import leaves, spread
from auv_gym.physics.vehicle import Vehicle
from auv_gym.planning.paths import Path
from auv_gym.planning.planner import Planner
from auv_gym.scenarios.drawing import Drawing, drawn_side_by_side
from auv_gym.scenarios.episode import Episode, with_options
from auv_gym.scenarios.exogenous import Tape
from auv_gym.scenarios.scenario import RandomPath, Scenario
from auv_gym.scenarios.vehicles import VehicleModel
from auv_gym.task.kernels import STATES, begun
from auv_gym.task.observation import Observation, check_reference, decode, reference_bounds
from auv_gym.task.policy import Forces
from auv_gym.task.preview import Preview, encode_preview
from auv_gym.task.simulation import PARAMETER_ROWS, SAMPLE_ROWS, Parameters, Parts

ScenarioLike = Scenario | str | Mapping[str, Any]

LARGEST_BLOCK = 64  # most control steps of tape that are read at once
BLOCK_SAMPLES = 2**15  # most vehicles times control steps that are read at once: it bounds the memory
FEWEST_ROWS = 4  # fewer episodes of a scenario are drawn one by one: calls on rows cost more than on floats


class ReadyEpisodes(NamedTuple):
    """Episodes of one scenario that are ready to begin."""

    places: Indices  # which of the lanes that asked they are for, shape (n,)
    scenario: Scenario
    episodes: Episode  # one whose numbers are rows (n,), or a single one
    tables: Sequence[Array]  # of the references, shape (steps + 1, 8)
    noise_seeds: Sequence[int]
    constants: Array  # the rows of their `simulation.Parameters`, shape (PARAMETER_ROWS, n)
    paths: Sequence[Path]  # if they are to be looked ahead on


class Begun(NamedTuple):
    """New episodes in n of the lanes."""

    lanes: Indices  # which, shape (n,)
    plant: Array  # rows of their `simulation.Plant`, shape (PLANT_ROWS, n)
    seen: Array  # the first observations without previews, shape (columns, n), see `kernels.begun`
    errors: Array  # [m] position error, shape (n,)


class Lanes:
    """N episodes side by side, everything of them but the simulation itself; on the host, for every back end.

    Args:
        num_envs: N.
        scenario: a scenario, or a sequence of N.
        vehicle: in place of the scenarios' known vehicle.
        control_dt: control period [s] in place of the scenarios'.
        preview: control periods ahead, see `Preview`.
        autoreset_mode: when an episode that has ended is followed by the next one.
        max_episode_steps: control steps after which episodes are truncated, if that is sooner than the scenario says.

    Attributes:
        scenarios: one for each lane.
        samples: a block of samples ahead, shape (block, SAMPLE_ROWS, N).
        row: the row of the present time in that block; -1 if it was the last of the block before.
        blocks: how many blocks have been read.
        constants: the rows of `parameters`, shape (PARAMETER_ROWS, N).
        k: control steps since each lane's reset, shape (N,).
        forces: of a law whose actions are observed as well, if there is one.
        preview: the references' positions ahead.
        ends: which episodes have ended.

    Raises:
        ValueError: a wrong number of lanes, scenarios or steps, an unknown mode, or whatever a scenario refuses.
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
        self.begun = False
        self.forces: Forces | None = None
        self._generators: list[np.random.Generator | None] = [None] * num_envs  # made when they are needed
        self._dt = np.array([s.control_dt for s in self.scenarios])
        self._steps = np.array([s.steps for s in self.scenarios])
        self._lengths = np.minimum(self._steps, checked_steps(max_episode_steps))
        self.ends = Ends(num_envs, checked_mode(autoreset_mode))
        block = max(1, min(LARGEST_BLOCK, BLOCK_SAMPLES // num_envs))
        self._tape = Tape(num_envs, block)
        self.preview = Preview(num_envs, preview, int(self._steps.max()))
        self._fixed: dict[tuple[Any, ...], Array] = {}  # tables of scenarios whose path is not drawn
        self.samples, self.row, self.blocks = np.zeros((block, SAMPLE_ROWS, num_envs)), 0, 0
        self._before = self.samples[0]  # the last sample of the block before
        self.constants = np.ones((PARAMETER_ROWS, num_envs))
        self.parts = reduce(Parts.joined, {s.parts: None for s in self.scenarios})
        self.parameters = Parameters.of(tuple(self.constants), self.parts)
        self.k: Indices = np.zeros(num_envs, dtype=np.int64)
        self._left = 0  # control steps for which no episode is truncated, at least

    @property
    def sample(self) -> Any:
        """The samples of the present time, an array (SAMPLE_ROWS, N)."""
        return self._before if self.row < 0 else self.samples[self.row]

    @property
    def time(self) -> Array:
        """Time since each reset [s], shape (N,)."""
        return np.asarray(self.k * self._dt)

    @property
    def truncating(self) -> NDArray[np.bool_]:
        """Whether the coming control step is the last one of each episode, shape (N,)."""
        if self._left > 0:
            return np.zeros(len(self.all), dtype=bool)
        left = self._lengths - self.k - 1
        self._left = int(left.min())
        ending: NDArray[np.bool_] = left <= 0
        return ending

    def coming(self) -> Array:
        """Return the samples at the end of the coming control step, an array (SAMPLE_ROWS, N); time stays."""
        if self.row + 1 == len(self.samples):
            self.read()
        coming: Array = self.samples[self.row + 1]
        return coming

    def advance(self) -> None:
        """Go on by one control step, whose samples `coming` has returned."""
        self.row += 1
        self.k += 1
        self._left -= 1

    def reset(self, seed: int | Sequence[int | None] | None, options: Mapping[str, Any] | None) -> Begun:
        """Begin new episodes everywhere, or where `options["reset_mask"]` says; lane i gets seed + i.

        Raises:
            ValueError: wrong options or seeds, or an episode that cannot be planned; nothing has changed then.
        """
        lanes, choices = checked_reset(options, len(self.all), self.begun)
        generators = seeded(self._generators, seed)
        planned = self.ready(lanes, generators, choices)
        for i in lanes.tolist():
            self._generators[i] = generators[i]
        return self.begin(lanes, planned)

    def planned(self, lanes: Indices) -> list[ReadyEpisodes]:
        """Return the next episode of each of the lanes, ready to begin.

        Raises:
            ValueError: see `Scenario.drawn`; nothing has changed then.
        """
        return self.ready(lanes, self._generators, None)

    def ready(
        self, lanes: Indices, generators: Sequence[Any], choices: Sequence[Mapping[str, Any]] | None
    ) -> list[ReadyEpisodes]:
        """Return an episode for each of the lanes, with every lane's generator and checked options of `reset`, if any.

        Raises:
            ValueError: see `Scenario.drawn`; nothing has changed then.
        """
        states = {i: generators[i].bit_generator.state for i in lanes.tolist()}
        alone: list[int] = []  # places in `lanes`
        together: dict[int, list[int]] = {}  # places of those that are drawn side by side, by scenario
        for place, i in enumerate(states):
            if choices and choices[i]:
                alone.append(place)
            else:
                together.setdefault(id(self.scenarios[i]), []).append(place)
        found: list[ReadyEpisodes] = []
        try:
            for places in map(np.array, together.values()):
                scenario = self.scenarios[int(lanes[places[0]])]
                if len(places) < FEWEST_ROWS or not drawn_side_by_side(scenario):
                    alone += places.tolist()
                    continue
                own = [generators[i] for i in lanes[places].tolist()]
                rows, refused = self._side_by_side(scenario, places, own)
                for place in refused:
                    generators[lanes[place]].bit_generator.state = states[int(lanes[place])]
                found += rows
                alone += refused
            for place in alone:
                i = int(lanes[place])
                found.append(self._alone(self.scenarios[i], place, generators[i], choices[i] if choices else {}))
        except ValueError:
            for i, state in states.items():
                generators[i].bit_generator.state = state
            raise
        return found

    def _side_by_side(
        self, scenario: Scenario, places: Indices, generators: Sequence[np.random.Generator]
    ) -> tuple[list[ReadyEpisodes], list[int]]:
        """Return the episodes of a scenario for these places, and the places of those that cannot be followed."""
        drawing = Drawing(scenario, generators)
        tables: list[Array | None] = [None] * len(places)
        if not isinstance(scenario.path, RandomPath):
            tables = [self.fixed_table(scenario)] * len(places)
        planner = planner_of(*plan_of(scenario))
        for members, paths in drawing.paths:
            for j, table in zip(members.tolist(), planner.tables(paths, len(members)), strict=True):
                tables[j] = table
        refused = [j for j, table in enumerate(tables) if table is None]
        kept = np.array([j for j, table in enumerate(tables) if table is not None])
        if len(kept) < FEWEST_ROWS:
            return [], places.tolist()
        episodes = drawing.episodes(kept)
        constants = spread(leaves(scenario.constants(episodes)), len(kept))
        ahead = drawing.single(kept) if self.preview.periods else []
        followed, seeds = [table for table in tables if table is not None], [drawing.seeds[j] for j in kept.tolist()]
        rows = ReadyEpisodes(places[kept], scenario, episodes, followed, seeds, constants, ahead)
        return [rows], places[refused].tolist()

    def _alone(
        self, scenario: Scenario, place: int, rng: np.random.Generator, options: Mapping[str, Any]
    ) -> ReadyEpisodes:
        """Return the episode of one lane, the one that is chosen or one that can be followed."""

        def table_of(episode: Episode) -> Array:
            if episode.path is scenario.path:
                return self.fixed_table(scenario)
            return reference_table(episode.path, *plan_of(scenario), many=len(self.all) > 1)

        if chosen := options.get("episode"):
            episode, table = chosen, table_of(chosen)
        else:
            episode, table = scenario.drawn(rng, table_of)
        episode = with_options(episode, options)
        constants = spread(leaves(scenario.parameters(episode)), 1)
        where, seeds = np.array([place]), [episode.noise_seed]
        return ReadyEpisodes(where, scenario, episode, [table], seeds, constants, [episode.path])

    def begin(self, lanes: Indices, ready: Sequence[ReadyEpisodes]) -> Begun:
        """Begin these episodes in the lanes."""
        states, errors = self.load(lanes, ready)
        given = states, self.sample[:, lanes], self.constants[:, lanes], self.forces
        return Begun(lanes, *begun(self.parts, *given), errors)

    def load(self, lanes: Indices, ready: Sequence[ReadyEpisodes]) -> tuple[Array, Array]:
        """Take up these episodes in n lanes; return their first states (STATES, n) and position errors (n,) [m]."""
        states, errors = np.empty((STATES, len(lanes))), np.empty(len(lanes))
        for places, scenario, episodes, tables, noise_seeds, constants, paths in ready:
            own = lanes[places]
            self._tape.load_rows(own, scenario, episodes, tables, noise_seeds)
            self.constants[:, own] = constants
            self.preview.load(own, paths, scenario.control_dt, tables)
            firsts: Any = tables[0][0].tolist() if len(tables) == 1 else np.array([table[0] for table in tables]).T
            states[:, places] = spread(episodes.initial_state(firsts), len(tables))
            errors[places] = np.hypot(*episodes.initial_error[:2])
        self.begun = True
        self.k[lanes], self._left = 0, 0
        self.ends.over[lanes] = False
        if self.row < 0:
            self._before[:, lanes] = self._tape.read(lanes, 1)[0]
        self._tape.read_into(self.samples[max(self.row, 0) :], lanes, lanes)
        return states, errors

    def read(self) -> None:
        """Read the next block of samples, the last of which is past."""
        self._before = self.samples[-1].copy()
        self._tape.read_into(self.samples, self.all, self.all)
        self.row, self.blocks = -1, self.blocks + 1

    def change(self, episodes: Sequence[Episode]) -> None:
        """Put the constants of other episodes in place of those of the running ones; their tapes run on.

        Raises:
            ValueError: not one for each lane, or one that the lane's scenario cannot have; nothing has changed then.
        """
        if len(episodes) != len(self.all):
            raise ValueError(f"{len(episodes)} episodes are given for {len(self.all)} vehicles; give one for each")
        given = zip(self.scenarios, episodes, strict=True)
        self.constants[:] = np.array([leaves(scenario.parameters(episode)) for scenario, episode in given]).T

    def with_preview(self, rows: Array, lanes: Indices) -> Array:
        """Return a copy of the observations of n lanes, (SIZE, n), with their previews behind them, (columns, n)."""
        if not self.preview.periods:
            return rows.copy()
        o = Observation._make(decode(rows, ARRAYS))
        return np.vstack((rows, encode_preview(self.preview.ahead(lanes, self.k[lanes]), o, ARRAYS, self.parts.span)))

    def fixed_table(self, scenario: Scenario) -> Array:
        """Return the reference table of a scenario whose path is not drawn.

        Raises:
            ValueError: see `reference_table`.
        """
        assert not isinstance(scenario.path, RandomPath)
        key = id(scenario.path), plan_of(scenario)
        if key not in self._fixed:
            self._fixed[key] = reference_table(scenario.path, *plan_of(scenario), many=len(self.all) > 1)
        return self._fixed[key]


def plan_of(scenario: Scenario) -> tuple[float, int, Vehicle, float, float, float, int]:
    """Return what a plan depends on besides the path, the arguments of `reference_table`."""
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
        path: of an episode.
        dt: control period [s].
        steps: control steps of an episode.
        vehicle: the known one.
        F_u_max: largest |F_u| [N].
        F_r_max: largest |F_r| [N m].
        fin: of the fins [kg], see `actuators.Actuators`.
        span: of the scenario, see `task.bounds`.
        many: see `planning.kernels.driver`.

    Raises:
        InfeasibleReferenceError: the path cannot be followed within these limits.
        ValueError: the reference is beyond what can be observed.
    """
    planner = planner_of(dt, steps, vehicle, F_u_max, F_r_max, fin, span, many=many)
    table = planner.table(path)
    if table is None:  # for a reason that there is an error for
        table = planner.plan(path).table
        check_reference(table, span)
    return table


def reference_tables(episodes: Sequence[Episode], *given: Any) -> list[Array]:
    """Return the `reference_table` of each episode's path; the other arguments are those of it."""
    return [reference_table(episode.path, *given) for episode in episodes]


@lru_cache(maxsize=64)
def planner_of(
    dt: float, steps: int, vehicle: Vehicle, F_u_max: float, F_r_max: float, fin: float, span: int, *, many: bool = True
) -> Planner:
    """Return what plans the paths of a scenario; the arguments are those of `reference_table`."""
    times: Array = dt * np.arange(steps + 1, dtype=np.float64)
    return Planner(vehicle, times, (F_u_max, F_r_max), fin, reference_bounds(span), many=many)
