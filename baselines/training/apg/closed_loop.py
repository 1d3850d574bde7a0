"""One control step of expert, network and vehicle together, with its loss: a pure function for torch to compile."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from auv_gym.envs.torch_residual import Law, expert_action
from auv_gym.envs.torch_sim import PLAIN, TENSORS, simulate
from auv_gym.namespaces import Namespace
from auv_gym.policy import Policy, corrected
from auv_gym.preview import encode_preview
from auv_gym.simulation import PARAMETERS, PLANT, PLANT_ROWS, Parts
from auv_gym.task import SIZE, Observation, decode
from baselines.agents.features import INTEGRALS, STANDARD, Inputs
from baselines.agents.networks import ACTIONS
from baselines.control.backstepping import Backstepping, tracking_forces
from baselines.control.ekf_law import EkfLaw
from baselines.control.open_loop import Zero
from baselines.policy import U_R, V_R, BySpeed, is_fast

NEAR = 2.0  # error in units of its scale where the loss turns from a parabola into a logarithm
CURVE = 0.3  # weight of the squared error, in units of its scale, in the parabola
TINY = 1e-6  # added to the squared error, in units of the scale's square: the distance has no slope at zero


class Carried(NamedTuple):
    """What goes from one control step to the next: tensors whose last axis counts the N vehicles, but `hidden`'s."""

    state: Tensor  # rows of a `simulation.Plant`, shape (PLANT_ROWS, N)
    observation: Tensor  # shape (SIZE, N)
    integrals: Tensor  # of the features, shape (INTEGRALS, N)
    correction: Tensor  # the last one, shape (ACTIONS, N)
    hidden: Tensor  # of the network, shape (N, hidden)

    @classmethod
    def zeros(cls, n: int, hidden: int, dtype: torch.dtype) -> Carried:
        """Return what n vehicles begin with, but for state and observation."""
        state, observation, integrals, correction = (
            torch.zeros(rows, n, dtype=dtype) for rows in (PLANT_ROWS, SIZE, INTEGRALS, ACTIONS)
        )
        return cls(state, observation, integrals, correction, torch.zeros(n, hidden, dtype=dtype))

    def detach(self) -> Carried:
        """Return the same without the graph behind it."""
        return Carried(*(x.detach() for x in self))


@dataclass(frozen=True)
class Loss:
    """Weights of the loss of a control step: tensors, as a number would be compiled into the step."""

    effort: Tensor  # of the squared command
    rate: Tensor  # [s^2] of its squared rate of change

    @classmethod
    def weighted(cls, effort: float = 0.003, rate: float = 0.003) -> Loss:
        """Return the loss with these weights."""
        return cls(torch.tensor(effort), torch.tensor(rate))

    def of(self, squared_error: Tensor, scale: Tensor, command: Tensor, previous: Tensor, dt: Tensor) -> Tensor:
        """Return the loss of a step, shape (N,).

        Near the reference it is e + 0.3 e^2 for an error of e scales; far from it, it grows like a logarithm, so that a
        vehicle that is lost neither outweighs all others nor ceases to be pulled back.

        Args:
            squared_error: of the position [m^2], shape (N,).
            scale: of the error [m], shape (N,).
            command: in [-1, 1], shape (ACTIONS, N).
            previous: the one before.
            dt: control period [s], shape (N,).
        """
        e = torch.sqrt(squared_error / (scale * scale) + TINY)
        near, far = e.clamp(max=NEAR), e.clamp(min=NEAR)
        slope = NEAR * (1 + 2 * CURVE * NEAR)
        error = near + CURVE * near * near + slope * torch.log(far / NEAR)
        change = (command - previous) / dt
        return error + self.effort * (command * command).sum(0) + self.rate * (change * change).sum(0)


@dataclass(frozen=True)
class ClosedLoop:
    """Expert, network and vehicle; `step` is one control step of N of them."""

    law: Law
    authority: Tensor  # shape (2,)
    loss: Loss
    parts: Parts = PLAIN  # of the simulation that are in use
    inputs: Inputs = STANDARD  # of the network

    def act(
        self, network: nn.Module, carried: Carried, ahead: Tensor, outside: Tensor | None = None
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return the command, shape (ACTIONS, N), integrals, correction and hidden state; see `step`."""
        o = Observation._make(decode(carried.observation.unbind(), TENSORS))
        base = expert_action(self.law, o)
        if outside is not None:  # the expert's value, the law's slope
            base = (outside[0] + (base[0] - base[0].detach()), outside[1] + (base[1] - base[1].detach()))
        seen = encode_preview(ahead.reshape(-1, 2, ahead.shape[-1]), o, TENSORS).unbind() if len(ahead) else ()
        rows, integrals = self.inputs.update(
            o, seen, base, carried.correction.unbind(), carried.integrals.unbind(), TENSORS
        )
        correction, hidden = network(torch.stack(rows, dim=1), carried.hidden)
        corrections = correction.unbind(dim=1)
        rule = zip(base, self.authority.unbind(), corrections, strict=True)
        command = torch.stack([corrected(b, authority, c, TENSORS) for b, authority, c in rule])
        return command, torch.stack(integrals), torch.stack(corrections), hidden

    def step(
        self,
        network: nn.Module,
        carried: Carried,
        ahead: Tensor,
        sample: Tensor,
        parameters: Tensor,
        outside: Tensor | None = None,
    ) -> tuple[Carried, Tensor, Tensor]:
        """Return what is carried on, the loss and the squared position error [m^2], shape (N,).

        Args:
            network: see `TorchGru`.
            carried: from the step before.
            ahead: the preview of `inputs` in the world [m], shape (2 P, N), see `TorchSimulator.window`.
            sample: the rows of a `simulation.Sample`, shape (SAMPLE_ROWS, N).
            parameters: the rows of `simulation.Parameters`, shape (PARAMETER_ROWS, N).
            outside: the action of an expert that does not compute on tensors, shape (ACTIONS, N); `law` has its slope.
        """
        command, integrals, correction, hidden = self.act(network, carried, ahead, outside)
        t = simulate(carried.state, command, sample, parameters, self.parts)
        previous, dt = carried.state[PLANT.a_u : PLANT.a_r + 1], self.parts.substeps * parameters[PARAMETERS.h]
        loss = self.loss.of(t.squared_error, parameters[PARAMETERS.error_scale], command, previous, dt)
        return Carried(t.state, t.observation, integrals, correction, hidden), loss, t.squared_error


def law_of(expert: Policy) -> tuple[Law, bool]:
    """Return an expert's law on tensors, and whether that is the expert itself.

    An expert that computes on NumPy alone, with a memory perhaps, has its slope taken from a law near it: the one on an
    extended Kalman filter from the same law on the measurements, every other from the paper's law.
    """
    if isinstance(expert, Zero):
        return lambda o, _: (0.0 * o[0], 0.0 * o[0]), True
    controller = getattr(expert, "controller", None)
    if (
        isinstance(controller, BySpeed)
        and isinstance(controller.slow, EkfLaw)
        and isinstance(controller.cruise, EkfLaw)
    ):
        return partial(_by_speed, controller.slow, controller.cruise), False
    forces: Law | None = getattr(expert, "forces", None)
    return (forces, True) if forces else (Backstepping().forces, False)


def _by_speed(slow: EkfLaw, cruise: EkfLaw, o: Any, ns: Namespace) -> tuple[Any, Any]:
    fast = is_fast(o[U_R], o[V_R])
    slow_forces, cruise_forces = (tracking_forces(o, law.vehicle, law.gains, ns) for law in (slow, cruise))
    return ns.where(fast, cruise_forces[0], slow_forces[0]), ns.where(fast, cruise_forces[1], slow_forces[1])
