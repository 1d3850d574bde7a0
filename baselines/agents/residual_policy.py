"""A trained agent as a policy: an expert's action plus a bounded correction by a network, without torch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from auv_gym.codegen.graph import SYMBOLS, Symbol, single
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.namespaces import Array
from auv_gym.physics.units import Units
from auv_gym.physics.vehicle import PAPER_VEHICLE, Coefficients
from auv_gym.task.observation import SIZE, action_of, decode
from auv_gym.task.policy import Forces, Law, Policy, corrected, preview_of, traceable
from auv_gym.task.preview import shared_preview
from baselines.agents.features import STANDARD, Inputs, scaled_errors
from baselines.agents.networks import OUTPUTS, Network, Weights
from baselines.policy import ALL_SPEEDS, Batched, Memory, Starts, renewed
from baselines.similar import shown_factors

BLOCK = 128
"""Most vehicles that go through the network at once: what it computes on the way stays in the processor's cache."""
_Symbols = Sequence[Symbol]


@lru_cache(maxsize=64)
def feature_kernel(
    inputs: Inputs,
    forces: Forces | None,
    hull: Coefficients = PAPER_VEHICLE.coefficients,
    units: Units = Units(),  # noqa: B008, it is frozen
) -> Kernel:
    """Return the kernel from an observation, with its preview's columns `ahead`, to the features.

    Its results: terms, the observation's in SI units; errors, see `scaled_errors`; features and integrals, see
    `Inputs.update`; base, the expert's action.

    Args:
        inputs: what the network sees.
        forces: of the expert, if it is a law; None: its action, base, is an argument.
        hull: the known vehicle, see `Inputs.update`.
        units: in which everything is seen, while the observation is in SI units; none, and neither is scaled.
    """
    factors = () if units == Units() else shown_factors(units)

    def equation(
        observation: _Symbols, ahead: _Symbols, correction: _Symbols, integrals: _Symbols, base: _Symbols = ()
    ) -> Mapping[str, _Symbols]:
        o = decode(observation, SYMBOLS)
        if factors:
            o = [term * factor for term, factor in zip(o, factors, strict=True)]
            ahead = [way * (1 / units.length) for way in ahead]
        if forces is not None:
            base = [single(a) for a in action_of(forces(o, SYMBOLS), o, SYMBOLS)]  # as `Law.predict` gives it
        features, sums = inputs.update(o, ahead, base, correction, integrals, SYMBOLS, hull)
        errors = scaled_errors(o, SYMBOLS)
        return {"terms": o, "errors": errors, "features": features, "integrals": sums, "base": base}

    rows = {"observation": SIZE, "ahead": 2 * len(inputs.preview), "correction": OUTPUTS, "integrals": inputs.memory}
    rows = rows if forces is not None else rows | {"base": OUTPUTS}
    return Kernel.traced(equation, rows, blocked=inputs.filters)


@lru_cache(maxsize=1)
def command_kernel() -> Kernel:
    """Return the kernel of `corrected`, in single precision as every policy's action."""

    def equation(base: _Symbols, authority: _Symbols, correction: _Symbols) -> Mapping[str, _Symbols]:
        rule = zip(base, authority, correction, strict=True)
        return {"command": [single(corrected(b, a, c, SYMBOLS)) for b, a, c in rule]}

    return Kernel.traced(equation, dict.fromkeys(("base", "authority", "correction"), OUTPUTS))


class _Desk:
    """The arrays of n vehicles that the kernels read and write."""

    def __init__(self, n: int, features: Kernel) -> None:
        command = command_kernel()
        rows = features.rows | command.rows
        self.arrays = {name: np.zeros((size, n)) for name, size in rows.items()}
        self.see = features.bound(**{name: self.arrays[name] for name in features.rows})
        self.command = command.bound(**{name: self.arrays[name] for name in command.rows})


class ResidualPolicy(Batched):
    """command = clip(expert + authority * network(features)).

    Its memory: what its inputs remember, (N, `Inputs.memory`); the last correction, (N, 2); the network's hidden
    state, (N, hidden); and behind them whatever the expert remembers. A network that gives zero leaves the expert's
    actions as they are, bit for bit. It is for one thread at a time.
    """

    remembers = True
    OWN = 3
    """Arrays of its memory in front of the expert's."""

    def __init__(
        self,
        expert: Policy,
        network: Network,
        weights: Weights,
        authority: tuple[float, float],
        region: Sequence[float] | None = None,
        inputs: Inputs = STANDARD,
        precision: str = "float64",
        speeds: tuple[float, float] = ALL_SPEEDS,
        hull: Coefficients = PAPER_VEHICLE.coefficients,
    ) -> None:
        """Make the policy of checked weights.

        With a region, see `trust`, corrections fade outside of it; the network computes in a precision, "float64" or
        "float32". For the speeds see `Batched`. The hull is the known vehicle, see `Inputs.update`.
        """
        self.speeds = speeds
        self.region, self.inputs = None if region is None else np.array(region), inputs
        self.preview, self._seen, self._seen_by_expert = shared_preview(inputs.preview, preview_of(expert))
        self.expert, self.network, self.authority = expert, network, np.array(authority)
        self._layers, self.precision = network.prepared(weights, precision), np.dtype(precision)
        self._law = cast(Law, expert) if traceable(expert) else None
        self._hull = hull if inputs.hull else PAPER_VEHICLE.coefficients  # who does not look shares one kernel
        self._desk: tuple[int, _Desk] | None = None
        self._at(1)  # what is to be compiled is compiled before it has to decide

    def __getstate__(self) -> dict[str, Any]:
        """Return everything but the addresses of memory."""
        return self.__dict__ | {"_desk": None}

    def actions(
        self, rows: NDArray[Any], state: Memory | None, episode_start: Starts, deterministic: bool
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return actions and memory, see `Batched`."""
        del deterministic
        n = len(rows)
        integrals, correction, hidden = self._renewed(state, n, episode_start)
        desk = self._at(n)
        arrays = desk.arrays
        arrays["observation"][:] = rows[:, :SIZE].T
        if self._seen:
            arrays["ahead"][:] = rows[:, SIZE:].T[self._seen]
        arrays["correction"][:], arrays["integrals"][:] = correction.T, integrals.T
        past: Memory | None = state[self.OWN :] if state else ()
        if self._law is None:
            seen = np.hstack((rows[:, :SIZE], rows[:, SIZE:][:, self._seen_by_expert]))
            action, past = self.expert.predict(seen, past or None, episode_start)
            arrays["base"][:] = action.T
        desk.see(0, 1)
        if self._law is not None:
            terms = arrays["terms"]
            self._law.check(terms.ravel().tolist() if n == 1 else terms)
        correction, hidden = self._applied(arrays["features"].astype(self.precision, copy=False), hidden.T)
        if self.region is not None:
            correction = correction * trust(arrays["errors"], self.region)
        arrays["correction"][:], arrays["authority"][:] = correction, self.authority[:, None]
        desk.command(0, 1)
        memory = arrays["integrals"].T.copy(), arrays["correction"].T.copy(), hidden.T, *(past or ())
        return arrays["command"].T.astype(np.float32), memory

    def _applied(self, features: Array, hidden: Array) -> tuple[Array, Array]:
        """Return correction and hidden state of `Network.forward`, block by block."""
        n = features.shape[1]
        if n <= BLOCK:
            return self.network.forward(self._layers, features, hidden)
        blocks = [slice(first, first + BLOCK) for first in range(0, n, BLOCK)]
        parts = [self.network.forward(self._layers, features[:, block], hidden[:, block]) for block in blocks]
        correction, hidden = (np.concatenate(rows, axis=1) for rows in zip(*parts, strict=True))
        return correction, hidden

    def _renewed(self, state: Memory | None, n: int, episode_start: Starts) -> Memory:
        """Return this policy's own memory of n vehicles."""
        if state and len(state[0]) == n and (episode_start is None or not np.count_nonzero(episode_start)):
            return state[: self.OWN]
        held_out = (
            np.zeros((n, self.inputs.memory)),
            np.zeros((n, OUTPUTS)),
            np.zeros((n, self.network.memory), self.precision),
        )
        return renewed(state and state[: self.OWN], held_out, episode_start)

    def _at(self, n: int) -> _Desk:
        """Return the arrays of n vehicles, those of the last call if it was of as many."""
        if self._desk is None or self._desk[0] != n:
            forces = None if self._law is None else self._law.forces
            self._desk = n, _Desk(n, feature_kernel(self.inputs, forces, self._hull))
        return self._desk[1]


def trust(errors: Array, region: Array) -> Array:
    """Return the share of a correction that is applied, shape (N,): 1 inside a region, falling to 0 at twice its size.

    Args:
        errors: the first features, `features.ERROR_FEATURES` rows of shape (N,).
        region: the largest magnitude of each that the network has learned from, shape (ERROR_FEATURES,).
    """
    farthest = (np.abs(errors) / region[:, None]).max(axis=0)
    return np.asarray(np.clip(2.0 - farthest, 0.0, 1.0))
