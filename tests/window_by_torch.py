"""The closed loop that trains, computed twice: by kernels, and by torch's layers and autograd on the same equations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from auv_gym.envs.differentiable import TENSORS
from auv_gym.scenarios.presets import PRESETS
from baselines.agents.features import STANDARD, Inputs
from baselines.agents.networks import Mlp
from baselines.control.backstepping import Backstepping
from baselines.training.apg.closed_loop import ClosedLoop, Loss, law_of
from baselines.training.apg.kernels import LoopKernels
from baselines.training.apg.settings import Settings
from baselines.training.apg.vehicle_group import Members, VehicleGroup
from baselines.training.apg.window import Carried, Objective, TrainingWindow
from baselines.training.config import Config
from baselines.training.vehicle_models import variants_of

AUTHORITY = (0.3, 0.6)  # largest corrections of surge and yaw
LOSS = Loss(effort=0.1, rate=0.01)  # weights of the loss
_SEED = 7  # of the episodes


def group_of(variants: Any, seed: int = 0, expert: str = "backstepping", misinformed: bool = False, **settings: Any):
    """Return vehicles with these scenarios, a sequence for each vehicle, and windows of `n_steps` control steps."""
    config = Config(scenarios=((PRESETS["cruise-calm"], 1.0),), expert=expert)
    members = Members(variants, Objective(LOSS, np.full(len(variants), 1 / len(variants))), seed, misinformed)
    return VehicleGroup(config, Settings(len(variants), **settings), members)


class Setting:
    """Vehicles, with drawn models if a network wants them, and a window of control steps that they run through with it.

    Args:
        names: of the presets, one for each vehicle.
        net: a network of `baselines.training.apg.network`.
        expert: by its name.
        inputs: of the network.
        steps: of a window.
        precision: of the kernels, "float64" or "float32".
        options: of the window's `Objective`, but for its loss.
    """

    def __init__(
        self,
        names: Sequence[str],
        net: Any,
        expert: str = "backstepping",
        inputs: Inputs = STANDARD,
        steps: int = 5,
        precision: str = "float64",
        **options: Any,
    ) -> None:
        scenarios, memory = [PRESETS[name] for name in names], net.sizes.memory
        variants = variants_of(scenarios, 1.0, _SEED) if inputs.nominal_vehicle else [[s] for s in scenarios]
        sizes = {"n_steps": steps, "hidden_size": memory or 1, "memory": memory > 0}
        self.group = group_of(variants, _SEED, expert, **sizes, **vars(inputs))
        law, self.exact = law_of(self.group.expert)
        informed = self.group.expert if inputs.nominal_vehicle and isinstance(self.group.expert, Backstepping) else None
        self.loop, self.net = ClosedLoop(law, inputs, self.group.sub_envs.parts, informed), net
        objective = Objective(**{"loss": LOSS, "shares": np.full(len(names), 1 / len(names)), **options})
        self.window = TrainingWindow(LoopKernels(self.loop, self.exact, precision), net, steps, AUTHORITY, objective)
        self.carried: Carried = self.group.carried

    def run(self) -> tuple[float, Any]:
        """Return the mean loss and the squared error at the end of the next window; the gradient is the network's."""
        ahead, samples = self.group.exogenous_inputs()
        given = ahead, samples, self.group.sub_envs.constants, self.act, self.group.known
        loss, _, carried, squared_error = self.window.run(self.carried, *given)
        self.carried = Carried(*(x.copy() for x in carried))
        return loss, squared_error

    def act(self, _: int, observation: Any) -> Any:
        """Return the actions, shape (2, N), of an expert on NumPy for observations (SIZE, N)."""
        return self.group.expert_action(observation, np.empty(0), np.zeros(observation.shape[1], dtype=bool))

    def by_torch(self) -> Tensor:
        """Return the next window's loss as a tensor, by torch's layers and autograd; the carried state stays."""
        dtype = next(self.net.parameters()).dtype

        def rows(array: Any) -> Any:
            return torch.tensor(array, dtype=dtype).unbind()

        base: Any
        state, observation, integrals, correction = map(rows, self.carried[:-1])
        known = rows(self.group.known)
        hidden, total = torch.tensor(self.carried.hidden, dtype=dtype).T, torch.zeros(())
        for k, (ahead, sample) in enumerate(zip(*self.group.exogenous_inputs(), strict=True)):
            base = self.loop.expert(observation, TENSORS, known)
            if not self.exact:  # the expert's value, the law's slope
                value = rows(self.act(k, torch.stack(observation).detach().numpy()))
                base = [v + (b - b.detach()) for v, b in zip(value, base, strict=True)]
            seen = observation, rows(ahead), base, correction, integrals
            features, integrals = self.loop.features(*seen, TENSORS, known)
            output, hidden = applied(self.net, torch.stack(features, dim=1), hidden)
            correction = output.unbind(dim=1)
            outside = rows(sample), rows(self.group.sub_envs.constants), AUTHORITY, LOSS
            state, observation, _, loss = self.loop.move(state, base, correction, *outside, TENSORS)
            total = total + loss.mean() / self.window.steps
        return total


def applied(net: Any, x: Tensor, hidden: Tensor) -> tuple[Tensor, Tensor]:
    """Return what a network makes of inputs (N, inputs) and its hidden state (N, memory), by torch's own layers."""
    if isinstance(net.sizes, Mlp):
        for layer in net.layers:
            x = torch.tanh(layer(x))
        return x, hidden
    hidden = net.gru(torch.tanh(net.encoder(x)), hidden)
    return torch.tanh(net.head(torch.tanh(net.decoder(hidden)))), hidden
