"""The kernels of a window: the computations before and after the network in a control step, and their adjoints.

An adjoint computes its step again from the inputs of the step, so that no intermediate values are stored. An array
named d_X holds the derivatives of the window's loss with respect to X.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

from auv_gym.codegen.derivatives import gradient
from auv_gym.codegen.graph import SYMBOLS, Symbol
from auv_gym.codegen.kernel import Equation, Kernel
from auv_gym.physics.namespaces import Number
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.task.observation import ERROR_TERMS, SIZE, Observation
from auv_gym.task.simulation import Parts
from baselines.agents.networks import OUTPUTS
from baselines.training.apg.closed_loop import ClosedLoop, Loss, Moved, known_rows

_Symbols = Sequence[Symbol]
_Results = Mapping[str, _Symbols]


class RunConstants(NamedTuple):
    """Constants of a run. They are inputs of the kernels, so that all runs use the same compiled library."""

    authority_u: Number
    authority_r: Number
    effort: Number  # see `Loss`
    rate: Number
    share: Number  # weight of a control step of a vehicle in the window's loss


_SEEN = {"observation": SIZE, "correction": OUTPUTS}
"""Inputs of the features with their numbers of rows, without memory, `ahead` and the expert's action."""
_STEERED = (*Observation._fields[:ERROR_TERMS], "cos_psi", "sin_psi", "F_r_max", "a_u", "a_r")
STEERED = tuple(map(Observation._fields.index, _STEERED))
"""Terms of an observation that depend on the vehicle's motion; only these have derivatives. The largest torque is
included, since that of fins depends on the speed."""
FIXED = frozenset(
    ("parameters", "chosen", "known", "d_state", "d_observation", "d_base", "d_correction", "d_features", "d_integrals")
)
"""Arrays without a time axis."""
_PAPER = PAPER_VEHICLE.coefficients


def moved_rows(parts: Parts) -> dict[str, int]:
    """Return the inputs of a control step with their numbers of rows."""
    return {
        "state": parts.plant_rows,
        "base": OUTPUTS,
        "correction": OUTPUTS,
        "sample": parts.sample_rows,
        "parameters": parts.parameter_rows,
        "chosen": len(RunConstants._fields),
    }


@dataclass(frozen=True)
class LoopKernels:
    """The four kernels of a closed loop.

    Args:
        loop: the equations.
        exact: whether `loop.law` is the expert; else the action is an input, and the law only gives the derivatives.
        precision: "float32" or "float64".
    """

    loop: ClosedLoop
    exact: bool
    precision: str = "float32"

    @cached_property
    def observe(self) -> Kernel:
        """The kernel of features and expert's action, from observation, preview, last correction and integrals."""

        def equation(**arrays: _Symbols) -> _Results:
            action, features, following = self._observed(**arrays)
            return {"features": features, "following": following, **({} if "base" in arrays else {"base": action})}

        return self._traced(equation, self.seen if self.exact else self.seen | {"base": OUTPUTS})

    @cached_property
    def observe_adjoint(self) -> Kernel:
        """The adjoint of `observe`, from the derivatives of its results to those of its inputs."""

        def equation(d_features: _Symbols, d_base: _Symbols, d_integrals: _Symbols, **arrays: _Symbols) -> _Results:
            _, features, following = self._observed(**arrays)
            observation = arrays["observation"]
            steered = [observation[i] for i in STEERED]
            within = (*steered, *arrays["correction"], *arrays["integrals"], *arrays["base"])
            shares = _split(
                gradient((*features, *following), (*d_features, *d_integrals), within),
                len(steered), OUTPUTS, self.loop.inputs.memory, OUTPUTS,
            )  # fmt: skip
            action = self.loop.expert(observation, SYMBOLS, arrays.get("known", _PAPER))
            through_law = gradient(action, _sum(d_base, shares[3]), steered)
            terms: dict[int, Any] = dict(zip(STEERED, _sum(shares[0], through_law), strict=True))
            return {
                "d_observation": [terms.get(i, 0.0) for i in range(SIZE)],
                "d_correction": shares[1],
                "d_integrals": shares[2],
            }

        after = {
            "d_features": len(self.loop.inputs.features),
            "d_base": OUTPUTS,
            "d_integrals": self.loop.inputs.memory,
        }
        return self._traced(equation, self.seen | {"base": OUTPUTS} | after)

    @cached_property
    def move(self) -> Kernel:
        """The kernel of a control step: next state, observation and squared error, from state, actions and sample."""

        def equation(**arrays: _Symbols) -> _Results:
            moved = self._moved(**arrays)
            return {
                "next_state": moved.state,
                "observation": moved.observation,
                "squared_error": (moved.squared_error,),
            }

        return self._traced(equation, moved_rows(self.loop.parts))

    @cached_property
    def move_adjoint(self) -> Kernel:
        """The adjoint of `move`, from the derivatives of its results to those of state, action and correction."""

        def equation(
            d_state: _Symbols, d_observation: _Symbols, d_correction: _Symbols, **arrays: _Symbols
        ) -> _Results:
            moved = self._moved(**arrays)
            share = RunConstants._make(arrays["chosen"]).share
            within = (*arrays["state"], *arrays["base"], *arrays["correction"])
            shares = gradient((*moved.state, *moved.observation, moved.loss), (*d_state, *d_observation, share), within)
            state, base, correction = _split(shares, len(arrays["state"]), OUTPUTS, OUTPUTS)
            return {"d_state": state, "d_base": base, "d_correction": _sum(d_correction, correction)}

        rows = moved_rows(self.loop.parts)
        after = {"d_state": rows["state"], "d_observation": SIZE, "d_correction": OUTPUTS}
        return self._traced(equation, rows | after)

    @property
    def seen(self) -> dict[str, int]:
        """Inputs of the features with their numbers of rows; `known` if the network has the nominal models."""
        inputs = self.loop.inputs
        known = {"known": known_rows(self.loop.parts)} if inputs.nominal_vehicle else {}
        return _SEEN | {"integrals": inputs.memory, "ahead": 2 * len(inputs.preview)} | known

    def _observed(
        self,
        observation: _Symbols,
        correction: _Symbols,
        integrals: _Symbols,
        ahead: _Symbols,
        base: _Symbols = (),
        known: _Symbols = _PAPER,
    ) -> tuple[_Symbols, _Symbols, _Symbols]:
        """Return the expert's action, which is `base` if it is an input, the features, and their new memory."""
        action = base or self.loop.expert(observation, SYMBOLS, known)
        return action, *self.loop.features(observation, ahead, action, correction, integrals, SYMBOLS, known)

    def _moved(
        self,
        state: _Symbols,
        base: _Symbols,
        correction: _Symbols,
        sample: _Symbols,
        parameters: _Symbols,
        chosen: _Symbols,
    ) -> Moved:
        authority_u, authority_r, effort, rate, _ = chosen
        authority, loss = (authority_u, authority_r), Loss(effort, rate)
        return self.loop.move(state, base, correction, sample, parameters, authority, loss, SYMBOLS)

    def _traced(self, equation: Equation, rows: Mapping[str, int]) -> Kernel:
        arrays = {*rows, "features", "following", "next_state", "observation", "squared_error", "base"}
        over_time = sorted(arrays - FIXED)
        long = self.loop.inputs.filters and "ahead" in rows  # the equations of the filters
        return Kernel.traced(equation, rows, over_time, precision=self.precision, structural=True, blocked=long)


def _sum(a: _Symbols, b: _Symbols) -> list[Symbol]:
    return [x + y for x, y in zip(a, b, strict=True)]


def _split(symbols: _Symbols, *sizes: int) -> list[_Symbols]:
    parts, at = [], 0
    for size in sizes:
        parts.append(symbols[at : at + size])
        at += size
    return parts
