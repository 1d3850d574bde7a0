"""The closed loop that trains, twice over: by kernels, and by torch's layers and autograd on the same equations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from auv_gym.envs.torch_sim import TENSORS
from auv_gym.scenarios.presets import PRESETS
from baselines.agents.features import STANDARD, Inputs
from baselines.agents.networks import Mlp
from baselines.control.backstepping import Backstepping
from baselines.control.open_loop import NO_EXPERT, Zero
from baselines.policies import make_policy
from baselines.training.apg.closed_loop import ClosedLoop, Loss, law_of
from baselines.training.apg.kernels import LoopKernels
from baselines.training.apg.vehicles import TrainingVehicles
from baselines.training.apg.window import Carried, Objective, Window
from baselines.training.vehicle_models import variants_of

AUTHORITY = (0.3, 0.6)  # largest corrections of surge and yaw
LOSS = Loss(effort=0.1, rate=0.01)  # weights of the loss
_SEED = 7  # of the episodes


class Setting:
    """Vehicles, with drawn models if a network wants them, and a window of control steps that they run through with it.

    Args:
        names: of the presets, one for each vehicle.
        net: a network of `baselines.training.apg.torch_network`.
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
        self.expert = Zero() if expert == NO_EXPERT else make_policy(expert)
        law, self.exact = law_of(self.expert)
        scenarios = [PRESETS[name] for name in names]
        variants = variants_of(scenarios, 1.0, _SEED) if inputs.nominal_vehicle else ()
        self.vehicles = TrainingVehicles(scenarios, _SEED, steps, inputs.preview, variants)
        informed = self.expert if inputs.nominal_vehicle and isinstance(self.expert, Backstepping) else None
        self.loop = ClosedLoop(law, inputs, self.vehicles.parts, informed)
        self.net = net
        kernels, objective = LoopKernels(self.loop, self.exact, precision), Objective(LOSS, **options)
        self.window = Window(kernels, net, len(names), steps, AUTHORITY, objective)
        self.carried: Carried = self.vehicles.reset(net.sizes.memory, inputs.memory)
        self._memory: Any = None

    def act(self, observation: Any) -> Any:
        """Return the actions, shape (2, N), of an expert on NumPy for observations (SIZE, N)."""
        action, self._memory = self.expert.predict(np.asarray(observation).T.astype(float), self._memory)
        return action.T

    def run(self) -> tuple[float, Any]:
        """Return the mean loss and the squared error at the end of the next window; the gradient is the network's."""
        act = None if self.exact else lambda _, observation: self.act(observation)
        given = (*self.vehicles.window(), self.vehicles.constants, act)
        loss, _, carried, squared_error = self.window.run(self.carried, *given, known=self.vehicles.known)
        self.carried = Carried(*(x.copy() for x in carried))
        return loss, squared_error

    def by_torch(self) -> Tensor:
        """Return the next window's loss as a tensor, by torch's layers and autograd; what is carried stays."""
        dtype = next(self.net.parameters()).dtype

        def rows(array: Any) -> Any:
            return torch.tensor(array, dtype=dtype).unbind()

        base: Any
        state, observation, integrals, correction = map(rows, self.carried[:-1])
        known = rows(self.vehicles.known)
        hidden, total = torch.tensor(self.carried.hidden, dtype=dtype).T, torch.zeros(())
        for ahead, sample in zip(*self.vehicles.window(), strict=True):
            base = self.loop.expert(observation, TENSORS, known)
            if not self.exact:  # the expert's value, the law's slope
                value = rows(self.act(torch.stack(observation).detach()))
                base = [v + (b - b.detach()) for v, b in zip(value, base, strict=True)]
            seen = observation, rows(ahead), base, correction, integrals
            features, integrals = self.loop.features(*seen, TENSORS, known)
            output, hidden = applied(self.net, torch.stack(features, dim=1), hidden)
            correction = output.unbind(dim=1)
            outside = rows(sample), rows(self.vehicles.constants), AUTHORITY, LOSS
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
