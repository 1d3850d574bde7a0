"""The common part of the environments: N sub-environments whose episodes are drawn, planned and given samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_gym.envs.arguments import checked_reset, checked_steps, seeded
from auv_gym.physics.namespaces import Array, Indices
from auv_gym.physics.rows import spread
from auv_gym.planning.paths import Path
from auv_gym.scenarios.drawing import Drawing, drawn_as_rows
from auv_gym.scenarios.episode import Episode, with_options
from auv_gym.scenarios.exogenous import ExogenousInputs
from auv_gym.scenarios.scenario import RandomPath, Scenario
from auv_gym.task.kernels import started
from auv_gym.task.policy import Law
from auv_gym.task.preview import Preview, with_preview
from auv_gym.task.simulation import Parts, parameter_row

LARGEST_BLOCK = 64  # largest number of control steps that are read at once
BLOCK_SAMPLES = 2**15  # largest number of vehicles times control steps that are read at once; it bounds the memory
FEWEST_ROWS = 4  # fewer episodes of a scenario are drawn one by one, since calls on rows take more time than on floats


class ReadyEpisodes(NamedTuple):
    """Planned episodes of one scenario, for n of the sub-environments that need one."""

    places: Indices  # positions in the array of the sub-environments that need one, shape (n,)
    scenario: Scenario
    episodes: Episode  # n episodes as one whose numbers are rows (n,), or a single one
    tables: Sequence[Array]  # reference tables, shape (steps + 1, 8), in space (steps + 1, 13)
    noise_seeds: Sequence[int]
    constants: Array  # rows of their `simulation.Parameters`, shape (`Parts.parameter_rows`, n)
    paths: Sequence[Path]  # empty if there is no preview


class StartedEpisodes(NamedTuple):
    """The first states of n new episodes."""

    indices: Indices  # of the sub-environments, shape (n,)
    plant: Array  # rows of their `simulation.Plant`, shape (`Parts.plant_rows`, n)
    observation: Array  # first observations without previews, shape (columns, n), see `kernels.started`
    errors: Array  # [m] position errors, shape (n,)


class SubEnvironments:
    """N sub-environments without the simulation: drawing and planning of episodes, samples, previews.

    Args:
        scenarios: the scenario of each sub-environment, with equal `substeps`.
        preview: control periods ahead, see `Preview`.
        max_episode_steps: control steps after which episodes are truncated, if fewer than those of the scenario.
        parts: of the simulation; None: those of the scenarios.

    Attributes:
        all: the indices of all sub-environments, shape (N,).
        scenarios: the scenario of each sub-environment; a change has an effect from its next episode on.
        started: whether all sub-environments have been reset.
        samples: a block of samples, shape (block, `Parts.sample_rows`, N).
        row: index of the present sample in the block; -1 if it was the last one of the previous block.
        constants: the rows of `parameters`, shape (`Parts.parameter_rows`, N).
        k: control steps since the reset of each sub-environment, shape (N,).
        law: the control law whose actions are appended to observations; None without one.
        preview: positions of the references ahead.
        lengths: control steps until an episode of each sub-environment is truncated, shape (N,).

    Raises:
        ValueError: a wrong preview or number of steps.
    """

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        preview: Sequence[int] = (),
        max_episode_steps: int | None = None,
        parts: Parts | None = None,
    ) -> None:
        num_envs = len(scenarios)
        self.scenarios = list(scenarios)
        self.all: Indices = np.arange(num_envs)
        self.started = False
        self.law: Law | None = None
        self._generators: list[Any] = [None] * num_envs  # random generators, made when first used
        self._dt = np.array([s.control_dt for s in self.scenarios])
        self._steps = np.array([s.steps for s in self.scenarios])
        self.lengths = np.minimum(self._steps, checked_steps(max_episode_steps))
        block = max(1, min(LARGEST_BLOCK, BLOCK_SAMPLES // num_envs))
        self.parts = parts or reduce(Parts.joined, {s.parts: None for s in self.scenarios})
        self._exogenous = ExogenousInputs(num_envs, block, self.parts)
        self.preview = Preview(num_envs, preview, int(self._steps.max()), len(self.parts.model.position))
        self._fixed_tables: dict[tuple[int, Any], Array] = {}  # by fixed path and planner
        self.samples, self.row = np.zeros((block, self.parts.sample_rows, num_envs)), 0
        self._previous = self.samples[0]  # the last sample of the previous block
        self.constants = np.ones((self.parts.parameter_rows, num_envs))
        self.parameters = self.parts.parameters(tuple(self.constants))
        self.k: Indices = np.zeros(num_envs, dtype=np.int64)
        self._remaining = 0  # lower bound of the control steps until an episode is truncated

    @property
    def sample(self) -> Any:
        """The samples of the present time, shape (`Parts.sample_rows`, N)."""
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
        remaining = self.lengths - self.k - 1
        self._remaining = int(remaining.min())
        ending: NDArray[np.bool_] = remaining <= 0
        return ending

    def next_sample(self) -> Array:
        """Return the samples at the end of the next control step, as `sample`; the time does not change."""
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
        pose = len(self.parts.model.state) // 2
        indices, choices = checked_reset(options, len(self.all), self.started, pose)
        generators = seeded(self._generators, seed)
        planned = self.next_episodes(indices, generators, choices)
        for i in indices.tolist():
            self._generators[i] = generators[i]
        return self.begin(indices, planned)

    def next_episodes(
        self,
        indices: Indices,
        generators: Sequence[Any] | None = None,
        choices: Sequence[Mapping[str, Any]] | None = None,
    ) -> list[ReadyEpisodes]:
        """Return a planned episode for each of these sub-environments.

        Args:
            indices: of the sub-environments, shape (n,).
            generators: N random generators; None for those of the last resets.
            choices: checked options of `reset` for N sub-environments; None without any.

        Raises:
            ValueError: see `Scenario.drawn`; nothing has changed then.
        """
        generators = generators or self._generators
        states = {i: generators[i].bit_generator.state for i in indices.tolist()}
        single: list[int] = []  # positions in `indices` of the episodes that are drawn one by one
        groups: dict[int, list[int]] = {}  # those of the episodes that are drawn as rows, by scenario
        for place, i in enumerate(states):
            if choices and choices[i]:
                single.append(place)
            else:
                groups.setdefault(id(self.scenarios[i]), []).append(place)
        planned: list[ReadyEpisodes] = []
        try:
            for places in map(np.array, groups.values()):
                scenario = self.scenarios[int(indices[places[0]])]
                space = scenario.vertical is not None
                if len(places) < (2 if space else FEWEST_ROWS) or not (space or drawn_as_rows(scenario)):
                    single += places.tolist()
                    continue
                make = self._batch if space else self._rows
                some, refused = make(scenario, places, [generators[i] for i in indices[places].tolist()])
                for place in refused:
                    generators[indices[place]].bit_generator.state = states[int(indices[place])]
                planned += some
                single += refused
            for place in single:
                i = int(indices[place])
                planned.append(self._single(self.scenarios[i], place, generators[i], choices[i] if choices else {}))
        except ValueError:
            for i, state in states.items():
                generators[i].bit_generator.state = state
            raise
        return planned

    def _rows(
        self, scenario: Scenario, places: Indices, generators: Sequence[np.random.Generator]
    ) -> tuple[list[ReadyEpisodes], list[int]]:
        """Return planned episodes of a scenario, drawn as rows, and the places of those that are infeasible."""
        drawing = Drawing(scenario, generators)
        tables: dict[int, Array | None] = {}
        if not isinstance(scenario.path, RandomPath):
            tables = dict.fromkeys(range(len(places)), self.table(scenario, scenario.path))
        for members, stacked in drawing.paths:
            tables |= zip(members.tolist(), scenario.planner.tables(stacked, len(members)), strict=True)
        feasible = {j: table for j, table in sorted(tables.items()) if table is not None}
        if len(feasible) < FEWEST_ROWS:
            return [], places.tolist()
        members = np.array([*feasible])
        episodes = drawing.episodes(members)
        constants = spread(parameter_row(scenario.constants(episodes, self.parts)), len(members))
        paths = drawing.single(members) if self.preview.periods else []
        seeds = [drawing.seeds[j] for j in feasible]
        rows = ReadyEpisodes(places[members], scenario, episodes, [*feasible.values()], seeds, constants, paths)
        return [rows], np.delete(places, members).tolist()

    def _batch(
        self, scenario: Scenario, places: Indices, generators: Sequence[np.random.Generator]
    ) -> tuple[list[ReadyEpisodes], list[int]]:
        """Return episodes of a scenario in space, planned together, and the places of those that are infeasible."""
        episodes = [scenario.draw(rng) for rng in generators]
        tables = scenario.planner.tables([episode.path for episode in episodes])
        ready, refused = [], []
        for place, episode, table in zip(places.tolist(), episodes, tables, strict=True):
            if table is None:
                refused.append(place)
            else:
                ready.append(self._ready(scenario, place, episode, table))
        return ready, refused

    def _ready(self, scenario: Scenario, place: int, episode: Episode, table: Array) -> ReadyEpisodes:
        """Return a planned episode."""
        constants = spread(parameter_row(scenario.parameters(episode, self.parts)), 1)
        places, seeds = np.array([place]), [episode.noise_seed]
        return ReadyEpisodes(places, scenario, episode, [table], seeds, constants, [episode.path])

    def _single(
        self, scenario: Scenario, place: int, rng: np.random.Generator, options: Mapping[str, Any]
    ) -> ReadyEpisodes:
        """Return one planned episode: that of the options of `reset`, or a random feasible one."""
        if episode := options.get("episode"):
            table = self.table(scenario, episode.path)
        else:
            episode, table = scenario.drawn(rng, lambda drawn: self.table(scenario, drawn.path))
        return self._ready(scenario, place, with_options(episode, options), table)

    def begin(self, indices: Indices, ready: Sequence[ReadyEpisodes]) -> StartedEpisodes:
        """Start these episodes in n sub-environments and return their first states."""
        states, errors = self.load(indices, ready)
        sample, constants = self.sample[:, indices], self.constants[:, indices]
        return StartedEpisodes(indices, *started(self.parts, states, sample, constants, self.law), errors)

    def load(self, indices: Indices, ready: Sequence[ReadyEpisodes]) -> tuple[Array, Array]:
        """Load episodes into n sub-environments; return their first states (states, n) and position errors (n,) [m]."""
        states, errors = np.empty((len(self.parts.model.state), len(indices))), np.empty(len(indices))
        for places, scenario, episodes, tables, noise_seeds, constants, paths in ready:
            members = indices[places]
            self._exogenous.load_rows(members, scenario, episodes, tables, noise_seeds)
            self.constants[:, members] = constants
            self.preview.load(members, paths, scenario.control_dt, tables)
            firsts: Any = tables[0][0].tolist() if len(tables) == 1 else np.array([table[0] for table in tables]).T
            states[:, places] = spread(episodes.initial_state(firsts), len(tables))
            errors[places] = reduce(np.hypot, episodes.initial_error[: len(self.parts.model.position)])
        self.started = True
        self.k[indices], self._remaining = 0, 0
        if self.row < 0:
            self._previous[:, indices] = self._exogenous.read(indices, 1)[0]
        self._exogenous.read_into(self.samples[max(self.row, 0) :], indices, indices)
        return states, errors

    def read(self) -> None:
        """Read the next block of samples."""
        self._previous = self.samples[-1].copy()
        self._exogenous.read_into(self.samples, self.all, self.all)
        self.row = -1

    def with_preview(self, rows: Array, indices: Indices) -> Array:
        """Return the observations (SIZE, n) of n sub-environments with their previews, a new array (columns, n)."""
        if not self.preview.periods:
            return rows.copy()
        return with_preview(
            rows, self.preview.ahead(indices, self.k[indices]), self.parts.bound_factor, self.parts.model
        )

    def table(self, scenario: Scenario, path: Path) -> Array:
        """Return the reference table of a path in a scenario; that of a fixed path is planned once.

        Raises:
            ValueError: see `Planner.table`.
        """
        planner, many = scenario.planner, len(self.all) > 1
        if path is not scenario.path:
            table: Array = planner.table(path, many=many)
            return table
        key = id(path), planner
        if key not in self._fixed_tables:
            self._fixed_tables[key] = planner.table(path, many=many)
        return self._fixed_tables[key]
