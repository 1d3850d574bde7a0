"""Episodes in which an agent is watched: what it carries at some instants, and what is true then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.errors import to_body
from auv_gym.physics.namespaces import Array
from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import RandomPath, Scenario
from auv_gym.task.observation import decode_observation
from auv_gym.task.policy import preview_of
from baselines.agents.residual_policy import ResidualPolicy
from baselines.estimation.kalman import ExtendedKalmanFilter
from baselines.estimation.sea_model import Estimate
from baselines.evaluation.rollout import beginning, play
from baselines.evaluation.runner import drawn
from baselines.evaluation.score import regime_of
from baselines.policies import make_policy
from baselines.policy import Memory
from research.probing.watching import AT_ONCE, HIDDEN, Beside, Tapped, acting, remembering
from research.seeds import PROBING

SEED = PROBING.first  # of the first episode of each scenario
SOURCES = {
    "instant": "the observation of this instant",
    "untrained": "the memory of an untrained network that is shown the same",
    "inputs": "what the network is shown at this instant, integrals and filters included",
    "ekf": "what an extended Kalman filter believes on the same observations",
    "memory": "the memory of the network",
}
"""What a probe reads, and what it is."""
HULL = ("m11", "m22", "m33", "d11", "d22", "d33")
"""Parameters of the true vehicle, as shares of the known one."""
TARGETS = {
    **{name: f"{name} of the true vehicle beside the known one" for name in HULL},
    "drag": "surge drag at the path's speed, quadratic drag included, beside the known one",
    "quadratic": "how much quadratic drag there is",
    "lag": "time constant of the actuators",
    "V_u": "current along the hull, of the path's speed",
    "V_v": "current across the hull, of the path's speed",
    "X": "wave force in surge",
    "Y": "wave force in sway",
    "N": "wave moment in yaw",
}
"""What is asked of a probe, and what it is."""


@dataclass(frozen=True)
class Collected:
    """What was seen at T instants of n episodes."""

    sources: dict[str, Array]  # by name, see `SOURCES`, shape (T, n, columns)
    targets: dict[str, Array]  # by name, see `TARGETS`, shape (T, n)


def episodes_of(scenario: Scenario, count: int, first: int = 0) -> tuple[Episode, ...]:
    """Return so many episodes of a scenario that nothing was trained, tuned or compared on; raises as `drawn`."""
    return drawn(scenario, count, SEED + first).episodes


def at_speed(name: str, **changes: Any) -> Scenario:
    """Return a preset with other entries; `speed` [m/s] is that of its paths."""
    preset = PRESETS[name]
    assert isinstance(preset.path, RandomPath)
    speed = changes.pop("speed", preset.path.speed)
    return replace(preset, path=replace(preset.path, speed=speed), **changes)


def collected(name: str, scenario: Scenario, episodes: Sequence[Episode], instants: Sequence[int]) -> Collected:
    """Return what an agent carries at some control instants of episodes, and what is true there.

    Raises:
        ValueError: the policy is unknown, or no agent that remembers.
        PolicyError: its actions are not finite.
    """
    chunks = [episodes[i : i + AT_ONCE] for i in range(0, len(episodes), AT_ONCE)]
    parts = [_watched(name, scenario, chunk, instants) for chunk in chunks]

    def joined(tables: Sequence[dict[str, Array]]) -> dict[str, Array]:
        return {key: np.concatenate([table[key] for table in tables], axis=1) for key in tables[0]}

    return Collected(joined([p.sources for p in parts]), joined([p.targets for p in parts]))


def agent_of(name: str, vehicle: Vehicle) -> tuple[Any, ResidualPolicy]:
    """Return a policy by name, and the agent in it that remembers.

    Raises:
        ValueError: there is none.
    """
    policy = acting(name, vehicle)
    agent = remembering(policy)
    if agent is None:
        raise ValueError(f"policy {name!r} is no agent whose network remembers, such as helm or apg-cruise")
    return policy, agent


def _watched(name: str, scenario: Scenario, episodes: Sequence[Episode], instants: Sequence[int]) -> Collected:
    policy, agent = agent_of(name, scenario.vehicle)
    beside = Beside(agent.network)
    agent.network = cast(Any, beside)
    env, first = beginning([(scenario, episodes)], preview_of(policy))
    kalman = _kalman(scenario)
    belief = kalman.start(len(episodes))
    sources: list[dict[str, Array]] = []
    targets: list[dict[str, Array]] = []

    def watch(k: int, observation: Array, memory: Memory) -> None:
        nonlocal belief
        belief, z = kalman.update(belief, np.array(decode_observation(observation)))
        if k in instants:
            network = {"inputs": beside.inputs.T, "untrained": beside.hidden.T.copy(), "memory": memory[HIDDEN].copy()}
            sources.append({"instant": observation.copy(), "ekf": in_body(z).T, **network})
            targets.append(truth(env, scenario, episodes))

    for _ in play(Tapped(policy, watch), (env, first), max(instants) + 1):
        pass
    stack = [{key: np.stack([at[key] for at in rows]) for key in rows[0]} for rows in (sources, targets)]
    return Collected(stack[0], stack[1])


def _kalman(scenario: Scenario) -> ExtendedKalmanFilter:
    """Return the filter of the controller `ekf` in the regime of a scenario."""
    controller = cast(Any, make_policy("ekf", scenario.vehicle)).controller
    found: ExtendedKalmanFilter = getattr(controller, regime_of(scenario.name) or "cruise").filter
    return found


def in_body(z: Array) -> Array:
    """Return the rows of `Estimate`s with vectors along and across the hull, and without the heading."""
    e = Estimate._make(z[: len(Estimate._fields)])
    c, s = np.cos(e.psi), np.sin(e.psi)
    pairs = ("x_e", "y_e"), ("V_x", "V_y"), ("V_x_rate", "V_y_rate")
    turned = [row for a, b in pairs for row in to_body(getattr(e, a), getattr(e, b), c, s)]
    taken = {name for pair in pairs for name in pair} | {"psi"}
    return np.array([*turned, *(row for name, row in e._asdict().items() if name not in taken)])


def truth(env: UnderactuatedAUVTrackVectorEnv, scenario: Scenario, episodes: Sequence[Episode]) -> dict[str, Array]:
    """Return the targets of N running episodes now, by name, shape (N,)."""
    known, U = scenario.vehicle, np.array([e.path.speed for e in episodes])

    def of(name: str) -> Array:
        return np.array([getattr(e.vehicle, name) for e in episodes])

    psi, (V_x, V_y), (X, Y, N) = env.state[:, 2], env.current.T, env.load.T
    V_u, V_v = to_body(V_x, V_y, np.cos(psi), np.sin(psi))
    return {
        **{name: of(name) / getattr(known, name) for name in HULL},
        "drag": (of("d11") + of("X_uu") * U) / (known.d11 + known.X_uu * U),
        "quadratic": of("X_uu") - known.X_uu,
        "lag": np.array([e.lag for e in episodes]),
        "V_u": V_u / U,
        "V_v": V_v / U,
        "X": X / U,
        "Y": Y / U,
        "N": N / U,
    }
