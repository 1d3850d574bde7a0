"""The simulation on torch tensors: differentiable and compiled, on the CPU or a GPU.

`simulate` is the pure step, `TorchSimulator` the vector environment. Random numbers and plans are computed on the host,
outside of the compiled graph. Their samples are copied to the device in blocks.

`step` keeps the graph of the action, so back-propagation through time works directly:

    sim = TorchSimulator(256, "cruise-storm")
    observation, _ = sim.reset(seed=0)
    for _ in range(updates):
        total = torch.zeros(())
        for _ in range(32):
            observation, reward, *_ = sim.step(policy(observation))
            total = total + reward.mean()
        (-total).backward()
        optimizer.step()
        observation = sim.detach()
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import torch
from gymnasium.error import ResetNeeded
from gymnasium.vector.utils import batch_space
from torch import Tensor

from auv_gym.envs.sub_environments import ScenarioLike, StartedEpisodes, SubEnvironments
from auv_gym.envs.vector_api import AutoresetMode, VectorEnv
from auv_gym.physics.namespaces import tensors
from auv_gym.physics.rows import flatten, unflatten
from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.vehicles import VehicleModel
from auv_gym.task import simulation
from auv_gym.task.observation import Observation, encode
from auv_gym.task.preview import encode_preview, observation_bounds
from auv_gym.task.simulation import PARAMETER_ROWS, PLANT, PLANT_ROWS, SAMPLE_ROWS, Parameters, Parts

logger = logging.getLogger(__name__)

TENSORS = tensors()  # the namespace of tensors
_PLAIN = Parts()  # vehicle and actuators only
_VARIANTS = 256  # number of compiled forms of the step in a process, for its types and parts
CONSTANT_GLOBALS: Any = {"guard_filter_fn": torch.compiler.skip_guard_on_globals_unsafe}
"""Option of `torch.compile`: constant tables are not checked for changes at every call."""
DTYPES = {"float32": torch.float32, "float64": torch.float64}  # by name


class TorchTransition(NamedTuple):
    """The results of a control step; tensors of the type of the state."""

    state: Tensor  # shape (PLANT_ROWS, N)
    observation: Tensor  # shape (SIZE, N)
    reward: Tensor  # shape (N,)
    done: Tensor  # 1 where the episode has failed, else 0, shape (N,)
    squared_error: Tensor  # [m^2] of the position, shape (N,)
    saturated: Tensor  # 1 where an actuator was commanded to its limit, else 0, shape (N,)


def simulate(
    state: Tensor, action: Tensor, sample: Tensor, parameters: Tensor, parts: Parts = _PLAIN
) -> TorchTransition:
    """Return the results of `simulation.step` for N vehicles, differentiable with respect to state and action.

    Args:
        state: the rows of a `simulation.Plant`, shape (PLANT_ROWS, N).
        action: surge and yaw command as fractions of the limits, shape (2, N).
        sample: the rows of a `simulation.Sample`, shape (SAMPLE_ROWS, N).
        parameters: the rows of `simulation.Parameters`, shape (PARAMETER_ROWS, N).
        parts: the parts of the simulation in use.
    """
    p = Parameters.of(parameters.unbind(), parts)
    plant, terms, (reward, failed, squared_error, saturated) = simulation.step(
        unflatten(PLANT, state.unbind()), action.unbind(), sample.unbind(), p, TENSORS
    )
    rows, observation = torch.stack(flatten(plant)), encode(terms, TENSORS, parts.span)
    return TorchTransition(rows, observation, reward, failed.to(state.dtype), squared_error, saturated.to(state.dtype))


@cache
def step_function(
    device: torch.device, dtype: torch.dtype, parts: Parts, compiled: bool
) -> Callable[..., TorchTransition]:
    """Return `simulate` for these constants, compiled if requested and possible on the device.

    Compilation takes up to a minute per process. torch caches the result on disk for later processes.
    """
    eager = partial(simulate, parts=parts)
    if not (compiled and can_compile(device)):
        return eager
    logger.info("compiling the simulation step for %s, %s; the first time takes up to a minute", device, dtype)
    step: Callable[..., TorchTransition] = torch.compile(eager, dynamic=True, fullgraph=True, options=CONSTANT_GLOBALS)
    torch._dynamo.config.cache_size_limit = max(_VARIANTS, torch._dynamo.config.cache_size_limit)
    with torch._dynamo.config.patch(specialize_float=True):  # floats are constants here
        return step if _runs(step, *_ones(device, dtype)) else eager


@cache
def can_compile(device: torch.device) -> bool:
    """Return whether torch can compile for the device; if not, warn what is missing."""
    return _runs(torch.compile(torch.sin), torch.ones(8, device=device))


def _ones(device: torch.device, dtype: torch.dtype) -> list[Tensor]:
    return [torch.ones(rows, 8, device=device, dtype=dtype) for rows in (PLANT_ROWS, 2, SAMPLE_ROWS, PARAMETER_ROWS)]


def _runs(function: Callable[..., Any], *inputs: Tensor) -> bool:
    try:
        with torch.no_grad():
            function(*inputs)
    except Exception as error:  # noqa: BLE001 - torch's compiler has no common class of errors
        warnings.warn(
            "the simulation step cannot be compiled, so it runs eagerly and several times slower; torch.compile needs "
            f"a C++ compiler such as g++ on the PATH (torch says: {str(error).strip().splitlines()[0]})",
            RuntimeWarning,
            stacklevel=2,
        )
        return False
    return True


class TorchSimulator(VectorEnv[Tensor, Tensor, Tensor]):
    """The vector environment on tensors; see `UnderactuatedAUVTrackVectorEnv` for the task.

    If an episode ends in mode SAME_STEP, `info["final_obs"]` (N, columns) holds the observations before the reset, and
    `info["_final_obs"]` (N,) is the mask of these episodes. A seed gives the same episodes as in the NumPy environment.

    Observations and rewards have gradients with respect to the actions of all steps since the last `reset` or `detach`,
    but not beyond the start of an episode. Actions that require no gradient build no graph.

    Args:
        num_envs: N, the number of sub-environments.
        scenario: a `Scenario`, the name of a preset or a dict; or a sequence of N of them.
        vehicle: replaces the known vehicle of the scenarios: a `Vehicle`, a name or a dict.
        control_dt: control period [s], replaces that of the scenarios; the duration of episodes does not change.
        device: a torch device, "cpu" or "cuda".
        dtype: "float32" or "float64", or the torch dtype.
        compiled: whether to compile the step.
        preview: control periods ahead at which the reference is observed, see `auv_gym.task.preview.Preview`.
        autoreset_mode: "SameStep", "NextStep" or "Disabled", see `UnderactuatedAUVTrackVectorEnv`.
        max_episode_steps: control steps after which episodes are truncated, if fewer than those of the scenario.

    Raises:
        ValueError: an unknown type, an unavailable device, or a wrong scenario.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012 - as in VectorEnv

    def __init__(
        self,
        num_envs: int = 1,
        scenario: ScenarioLike | Sequence[ScenarioLike] = "paper-circle",
        vehicle: Vehicle | VehicleModel | str | Mapping[str, Any] | None = None,
        control_dt: float | None = None,
        device: str | torch.device = "cpu",
        dtype: str | torch.dtype = "float32",
        compiled: bool = True,
        preview: Sequence[int] = (),
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        max_episode_steps: int | None = None,
    ) -> None:
        self.device, self.dtype = checked_device(device), checked_dtype(dtype)
        self._sub_envs = sub_envs = SubEnvironments(
            num_envs, scenario, vehicle, control_dt, preview, autoreset_mode, max_episode_steps
        )
        self.autoreset_mode = sub_envs.autoreset.mode
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.num_envs, self.scenarios = num_envs, sub_envs.scenarios
        kind: Any = np.float32 if self.dtype == torch.float32 else np.float64
        bounds: Any = observation_bounds(sub_envs.preview.periods, sub_envs.parts.span).astype(kind)
        self.single_action_space = gym.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.single_observation_space = gym.spaces.Box(-bounds, bounds, dtype=kind)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._compiled = compiled
        self._step = step_function(self.device, self.dtype, sub_envs.parts, compiled)
        self._samples, self._block = self._tensor(sub_envs.samples), sub_envs.blocks
        self._constants = self._tensor(sub_envs.constants)
        self._state: Tensor | None = None
        self._observation = self._tensor(np.zeros((num_envs, len(bounds))))

    def __getstate__(self) -> dict[str, Any]:
        """Return all attributes except the compiled step."""
        return {name: value for name, value in self.__dict__.items() if name != "_step"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Set the attributes, and compile the step."""
        self.__dict__.update(state)
        self._step = step_function(self.device, self.dtype, self._sub_envs.parts, self._compiled)

    def _tensor(self, array: np.typing.ArrayLike) -> Tensor:
        return torch.tensor(np.asarray(array), dtype=self.dtype, device=self.device)

    @property
    def state(self) -> Tensor:
        """The rows of the `simulation.Plant`s, shape (PLANT_ROWS, N)."""
        if self._state is None:
            raise ResetNeeded("no episode has begun: call reset() first")
        return self._state

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Tensor, dict[str, Any]]:
        """Start new episodes in all sub-environments, or in those of `options["reset_mask"]`; i has seed + i.

        Raises:
            ValueError: unknown or wrong options, or a wrong number of seeds; nothing has changed then.
        """
        started = self._sub_envs.reset(seed, options)
        self._state = None if len(started.indices) == self.num_envs else self.state.detach()
        self._observation = self._begin(started, self._observation.detach())
        errors = np.zeros(self.num_envs)
        errors[started.indices] = started.errors
        return self._observation.clone(), self._info(self._tensor(errors), torch.zeros_like(self._observation[:, 0]))

    def _begin(self, started: StartedEpisodes, observation: Tensor) -> Tensor:
        """Set the first states of episodes; return the observations (N, columns) with their first ones."""
        sub_envs, indices = self._sub_envs, started.indices
        where = torch.as_tensor(indices, device=self.device)
        self._constants = self._constants.index_copy(1, where, self._tensor(sub_envs.constants[:, indices]))
        if self._block == sub_envs.blocks:
            # A graph may hold the samples up to `row`; later ones are changed without a record by autograd.
            later = self._tensor(sub_envs.samples[sub_envs.row + 1 :, :, indices])
            self._samples.data[sub_envs.row + 1 :, :, where] = later
        plant = self._tensor(started.plant)
        self._state = plant if self._state is None else self._state.index_copy(1, where, plant)
        return observation.index_copy(0, where, self._tensor(sub_envs.with_preview(started.seen, indices).T))

    def _with_preview(self, rows: Tensor) -> Tensor:
        """Return observations (SIZE, N) with their previews, (columns, N)."""
        sub_envs = self._sub_envs
        if not sub_envs.preview.periods:
            return rows
        ahead = self._tensor(sub_envs.preview.ahead(sub_envs.all, sub_envs.k))
        o = Observation._make(rows.unbind())  # the preview needs sine and cosine only, whose scale is 1
        return torch.cat((rows, encode_preview(ahead, o, TENSORS, sub_envs.parts.span)))

    def step(self, actions: Any) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        """Advance all vehicles by one control period, and start the next episode after the end of one.

        Args:
            actions: a tensor or an array of shape (N, 2).

        Raises:
            ValueError: an action is not two finite numbers; the message names the first bad sub-environment, and no
                vehicle has advanced.
            ResetNeeded: no episode has begun, or an episode is over in mode DISABLED; no vehicle has advanced.
        """
        commands, state, sub_envs = self.checked(actions), self.state, self._sub_envs
        resetting = sub_envs.autoreset.resetting
        sub_envs.next_sample()
        if self._block != sub_envs.blocks:
            self._samples, self._block = self._tensor(sub_envs.samples), sub_envs.blocks
        sample = self._samples[sub_envs.row + 1]
        graph = torch.is_grad_enabled() and (commands.requires_grad or state.requires_grad)
        if graph and not state.requires_grad:
            state = state.detach().requires_grad_()
        # One memory layout, and a graph for all or for none: other combinations would be compiled separately.
        inputs = state, commands.T.contiguous(), sample, self._constants
        with torch.set_grad_enabled(graph):
            next_state, rows, reward, failed, squared, saturated = self._step(*inputs)
        terminated, truncated = failed > 0.5, torch.as_tensor(sub_envs.truncating, device=self.device)
        if resetting is not None:
            running = torch.as_tensor(~resetting, device=self.device)
            reward, terminated, truncated = torch.where(running, reward, 0.0), terminated & running, truncated & running
        done = terminated | truncated
        ended = done.cpu().numpy()
        to_reset = sub_envs.autoreset.to_reset(ended)
        planned = sub_envs.next_episodes(to_reset) if len(to_reset) else []  # before any change, since it may fail
        sub_envs.advance()
        sub_envs.autoreset.advance(ended)
        self._state = next_state
        observation, errors = self._with_preview(rows).T, squared.detach().sqrt()
        info: dict[str, Any] = {}
        if planned and self.autoreset_mode == AutoresetMode.SAME_STEP:
            info = {"final_obs": observation, "_final_obs": done, "_final_info": done.clone()}
            info["final_info"] = self._info(errors, saturated)
        if planned:
            started = sub_envs.begin(to_reset, planned)
            observation = self._begin(started, observation)
            where = torch.as_tensor(to_reset, device=self.device)
            errors = errors.index_copy(0, where, self._tensor(started.errors))
            saturated = saturated.index_fill(0, where, 0.0)
        info.update(self._info(errors, saturated))
        self._observation = observation.clone()
        return observation, reward, terminated, truncated, info

    def detach(self) -> Tensor:
        """Detach state and observation from the graph of gradients; return the last observation (N, columns)."""
        self._state, self._observation = self.state.detach(), self._observation.detach()
        return self._observation.clone()

    def checked(self, actions: Any) -> Tensor:
        """Return actions, a tensor or an array of shape (N, 2), as a tensor of the simulator's type.

        Raises:
            ValueError: they have another type or shape, or are not finite; the message names the first bad one.
        """
        if isinstance(actions, np.ndarray) and actions.dtype.kind in "fiu":
            actions = torch.as_tensor(actions)
        if not isinstance(actions, Tensor) or actions.shape != (self.num_envs, 2):
            given = f"shape {tuple(actions.shape)}" if isinstance(actions, Tensor) else f"type {type(actions).__name__}"
            raise ValueError(f"actions have {given}; they must be a tensor or array of shape ({self.num_envs}, 2)")
        finite = torch.isfinite(actions.detach()).all(dim=1)
        if not finite.all():
            i = int(finite.to(torch.int8).argmin())
            raise ValueError(
                f"action of sub-environment {i} is {actions[i].tolist()}; it must be two finite numbers in [-1, 1]"
            )
        return actions.to(self.device, self.dtype)

    def _info(self, errors: Tensor, saturated: Tensor) -> dict[str, Any]:
        """Return the scalar environment's info as tensors of shape (N,)."""
        return {"position_error": errors, "saturated": saturated > 0.5, "time": self._tensor(self._sub_envs.time)}


def checked_device(device: str | torch.device) -> torch.device:
    """Return the device; raise ValueError if it is unknown or not available."""
    try:
        found = torch.device(device)
        torch.empty(0, device=found)
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        raise ValueError(
            f"device {device!r} is not available ({str(error).splitlines()[0]}); choose 'cpu', "
            "or install a torch build and driver for it"
        ) from error
    return found


def checked_dtype(dtype: str | torch.dtype) -> torch.dtype:
    """Return the torch dtype of a name or dtype; raise ValueError if it is not a float of 32 or 64 bits."""
    found = DTYPES.get(dtype) if isinstance(dtype, str) else dtype
    if found is None or found not in DTYPES.values():
        raise ValueError(f"dtype is {dtype!r}; it must be float32 or float64")
    return found
