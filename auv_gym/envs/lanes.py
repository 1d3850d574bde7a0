"""What the environments of many vehicles share: N lanes of episodes, drawn, planned and supplied with samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from auv_gym.envs.arguments import checked_reset, checked_steps, scenarios_of, seeded
from auv_gym.envs.vector_api import AutoresetMode, Ends, checked_mode
from auv_gym.physics.namespaces import ARRAYS, Array, Indices
from auv_gym.physics.rows import leaves
from auv_gym.physics.vehicle import Vehicle
from auv_gym.planning.planner import plan
from auv_gym.scenarios.episode import Episode, with_options
from auv_gym.scenarios.exogenous import Tape
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import VehicleModel
from auv_gym.task.kernels import begun
from auv_gym.task.observation import Observation, check_reference, decode
from auv_gym.task.policy import Forces
from auv_gym.task.preview import Preview, encode_preview
from auv_gym.task.simulation import PARAMETER_ROWS, SAMPLE_ROWS, Parameters, Parts

ScenarioLike = Scenario | str | Mapping[str, Any]

LARGEST_BLOCK = 64  # most control steps of tape that are read at once
BLOCK_SAMPLES = 2**18  # most vehicles times control steps that are read at once: it bounds the memory
PLANNED_AT_ONCE = 64  # most references planned in one batch, so that they stay in the processor's cache


class ReadyEpisode(NamedTuple):
    """An episode that is ready to begin."""

    episode: Episode
    table: Array  # of the reference, shape (steps + 1, 8)
    constants: tuple[float, ...]  # the numbers of its `simulation.Parameters`


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
        self._generators = [seeding.np_random(None)[0] for _ in range(num_envs)]
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
        ending: NDArray[np.bool_] = self.k + 1 >= self._lengths
        return ending

    def coming(self) -> Array:
        """Return the samples at the end of the coming control step, an array (SAMPLE_ROWS, N); time stays."""
        if self.row + 1 == len(self.samples):
            self._before = self.samples[-1].copy()
            self._tape.read(self.all, len(self.samples), self.samples)
            self.row, self.blocks = -1, self.blocks + 1
        coming: Array = self.samples[self.row + 1]
        return coming

    def advance(self) -> None:
        """Go on by one control step, whose samples `coming` has returned."""
        self.row += 1
        self.k += 1

    def reset(self, seed: int | Sequence[int | None] | None, options: Mapping[str, Any] | None) -> Begun:
        """Begin new episodes everywhere, or where `options["reset_mask"]` says; lane i gets seed + i.

        Raises:
            ValueError: unknown or wrong options, a wrong number of seeds, or an episode that cannot be planned; nothing
                has changed then.
            gymnasium.error.Error: a seed is no integer, or negative; nothing has changed then.
        """
        lanes, choices = checked_reset(options or {}, len(self.all), self.begun)
        generators = seeded(self._generators, seed)
        planned = self._planned(lanes, generators, choices)
        for i in lanes.tolist():
            self._generators[i] = generators[i]
        return self.begin(lanes, planned)

    def planned(self, lanes: Indices) -> list[ReadyEpisode]:
        """Return the next episode of each of the lanes, ready to begin.

        Raises:
            ValueError: see `Scenario.drawn`; nothing has changed then.
        """
        return self._planned(lanes, self._generators, [{}] * len(self.all))

    def _planned(
        self, lanes: Indices, generators: Sequence[np.random.Generator], choices: Sequence[Mapping[str, Any]]
    ) -> list[ReadyEpisode]:
        """Return an episode for each of the lanes, with every lane's checked options of `reset`."""
        states = [generators[i].bit_generator.state for i in lanes.tolist()]
        try:
            drawn = [choices[i].get("episode") or self.scenarios[i].draw(generators[i]) for i in lanes.tolist()]
            tables = self._tables(lanes, drawn)
            for j, i in enumerate(lanes.tolist()):
                if tables[j] is None:  # cannot be followed
                    generators[i].bit_generator.state = states[j]
                    drawn[j], tables[j] = self._feasible(i, choices[i].get("episode"), generators[i])
            episodes = [with_options(episode, choices[i]) for i, episode in zip(lanes.tolist(), drawn, strict=True)]
            return [
                ReadyEpisode(episode, table, leaves(self.scenarios[i].parameters(episode)))
                for i, episode, table in zip(lanes.tolist(), episodes, tables, strict=True)
            ]
        except ValueError:
            for i, state in zip(lanes.tolist(), states, strict=True):
                generators[i].bit_generator.state = state
            raise

    def begin(self, lanes: Indices, planned: Sequence[ReadyEpisode]) -> Begun:
        """Begin these episodes in the lanes."""
        for i, (episode, table, constants) in zip(lanes.tolist(), planned, strict=True):
            self._tape.load(i, self.scenarios[i], episode, table)
            self.constants[:, i] = constants
        self.preview.load(lanes, [episode.path for episode, _, _ in planned], self._dt[lanes])
        self.begun = True
        self.k[lanes] = 0
        self.ends.over[lanes] = False
        if self.row < 0:
            self._before[:, lanes] = self._tape.read(lanes, 1)[0]
        ahead = self.samples[max(self.row, 0) :]
        ahead[:, :, lanes] = self._tape.read(lanes, len(ahead))
        states = np.array([episode.initial_state(table[0].tolist()) for episode, table, _ in planned]).T
        errors = np.hypot(*np.array([episode.initial_error[:2] for episode, _, _ in planned]).T)
        return Begun(
            lanes, *begun(self.parts, states, self.sample[:, lanes], self.constants[:, lanes], self.forces), errors
        )

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

    def _feasible(self, lane: int, episode: Episode | None, rng: np.random.Generator) -> tuple[Episode, Array]:
        """Return an episode of a lane, the given one or one that can be followed, and its reference table."""

        def table_of(episode: Episode) -> Array:
            return reference_tables([episode], *plan_of(self.scenarios[lane]))[0]

        return (episode, table_of(episode)) if episode else self.scenarios[lane].drawn(rng, table_of)

    def _tables(self, lanes: Indices, episodes: Sequence[Episode]) -> list[Any]:
        """Return the reference table of each episode, None where it cannot be followed.

        Those of one clock and vehicle are planned together, paths of one family side by side.
        """
        tables: list[Any] = [None] * len(episodes)
        groups: dict[Any, list[int]] = {}
        for j, (i, episode) in enumerate(zip(lanes.tolist(), episodes, strict=True)):
            given, path = plan_of(self.scenarios[i]), self.scenarios[i].path
            if episode.path is path:
                fixed = (*given, id(path))
                if fixed not in self._fixed:
                    self._fixed[fixed] = reference_tables([episode], *given)[0]
                tables[j] = self._fixed[fixed]
            else:
                groups.setdefault(given, []).append(j)
        for given, members in groups.items():
            members.sort(key=lambda j: type(episodes[j].path).__name__)
            for first in range(0, len(members), PLANNED_AT_ONCE):
                batch = members[first : first + PLANNED_AT_ONCE]
                with suppress(ValueError):  # about one of them: all are planned alone then
                    for j, table in zip(batch, reference_tables([episodes[j] for j in batch], *given), strict=True):
                        tables[j] = table
        return tables


def plan_of(scenario: Scenario) -> tuple[float, int, Vehicle, float, float, float, int]:
    """Return what a plan depends on besides the path, the arguments of `reference_tables`."""
    s, act = scenario, scenario.actuators
    return s.control_dt, s.steps, s.vehicle, act.F_u_max, act.F_r_max, act.fin, s.span


def reference_tables(
    episodes: Sequence[Episode],
    dt: float,
    steps: int,
    vehicle: Vehicle,
    F_u_max: float,
    F_r_max: float,
    fin: float,
    span: int,
) -> list[Array]:
    """Return the reference tables of episodes, shape (steps + 1, 8) each.

    Args:
        episodes: whose paths are planned.
        dt: control period [s].
        steps: control steps of an episode.
        vehicle: the known one.
        F_u_max: largest |F_u| [N].
        F_r_max: largest |F_r| [N m].
        fin: of the fins [kg], see `actuators.Actuators`.
        span: of the scenario, see `task.bounds`.

    Raises:
        InfeasibleReferenceError: an episode's path cannot be followed within these limits.
        ValueError: a reference is beyond what can be observed.
    """
    paths = [episode.path for episode in episodes]
    reference = plan(paths, vehicle, dt * np.arange(steps + 1, dtype=np.float64), (F_u_max, F_r_max), fin).table
    check_reference(reference, span)
    return list(np.ascontiguousarray(reference.transpose(2, 0, 1)))
