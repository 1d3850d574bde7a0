"""Groups of vehicles that learn at a time: who is in them, what they count for, and where they compute."""

import os
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
import torch

from auv_gym.scenarios.presets import PRESETS
from baselines.tools.command_line import WorkerError
from baselines.tools.workers import ProcessObject, Workers
from baselines.training import vehicle_models
from baselines.training.apg.groups import Groups, VehicleGroup, divided
from baselines.training.apg.settings import check
from baselines.training.apg.torch_network import torch_network, weights_of
from baselines.training.apg.window import divided_by_error
from baselines.training.config import Config

GROUPED = {"n_envs": 20, "n_steps": 10, "hidden_size": 16, "groups": 3, "derivative_bound": 3, "error_exponent": 0.75}


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)
    torch.manual_seed(0)


def grouped(**changes):
    """Return a training whose vehicles are in groups, and its settings."""
    scenarios = tuple((replace(PRESETS[name], steps=50), 1.0) for name in ("slow-current", "cruise-storm"))
    config = Config(scenarios=scenarios, authority=(0.5, 0.5), hyperparameters=GROUPED | changes)
    return config, check(config)


@pytest.fixture
def weights():
    net = torch_network(grouped()[1].network)
    torch.nn.init.normal_(net.head.weight, std=0.5)
    return weights_of(net)


def test_groups_have_all_vehicles_and_their_shares():
    config, settings = grouped()
    groups = divided(config, settings)
    assert [len(group.scenarios) for group in groups] == [8, 6, 6]
    scenarios = config.env_scenarios(settings.n_envs)
    names = [scenario.name for group in groups for scenario in group.scenarios]
    assert sorted(names) == sorted(scenario.name for scenario in scenarios)
    seeds = [group.seed + i for group in groups for i in range(len(group.scenarios))]
    assert seeds == list(range(config.episode_seed, config.episode_seed + 20))
    whole = settings.objective([scenario.name for scenario in scenarios])
    shares = np.concatenate([group.objective.shares for group in groups])
    assert sorted(shares) == sorted(whole.shares)
    for group in groups:
        of = settings.objective([scenario.name for scenario in group.scenarios])
        np.testing.assert_array_equal(group.objective.loss.rate, of.loss.rate)
        even = divided_by_error(group.objective.shares, np.geomspace(0.01, 1, len(group.scenarios)), 0.75)
        assert even.sum() == pytest.approx(group.objective.shares.sum())


def test_half_of_each_group_has_drawn_models(monkeypatch):
    monkeypatch.setattr(vehicle_models, "SEVERAL", 2)
    for group in divided(*grouped(n_envs=8, groups=2, nominal_vehicle=True, drawn_share=0.5)):
        assert sorted(len(own) for own in group.variants) == [1, 1, 2, 2]


@pytest.mark.slow
def test_gradients_do_not_depend_on_the_number_of_processes(weights):
    """Not in the last bit; nor on when a checkpoint is taken, and by how many processes it was left."""
    config, settings = grouped()
    found = []
    for before, after in ((1, 1), (2, 1), (1, 4)):
        with closing(Groups(config, settings, before)) as groups:
            learned, state = [groups.learn(weights) for _ in range(2)], groups.state()
        with closing(Groups(config, settings, after)) as groups:
            groups.restore(state)
            found.append([*learned, groups.learn(weights)])
    for windows in zip(*found, strict=True):
        assert len({(each.loss, each.error) for each in windows}) == 1
        for name, gradient in windows[0].gradients.items():
            assert all(np.array_equal(each.gradients[name], gradient) for each in windows)


def test_the_gradient_of_groups_is_the_sum_of_theirs(weights):
    """Each weighed as in the mean over all vehicles: against a window of the group alone, whose shares add up to 1."""
    config, settings = grouped()
    with closing(Groups(config, settings)) as groups:
        both, loss, error = groups.learn(weights), 0.0, 0.0
    summed = {name: np.zeros_like(w) for name, w in weights.items()}
    for members in divided(config, settings):
        share = members.objective.shares.sum()
        alone = replace(members, objective=replace(members.objective, shares=members.objective.shares / share))
        part = VehicleGroup(config, settings, alone).learn(weights)
        loss, error = loss + share * part.loss, error + part.error
        for name, gradient in part.gradients.items():
            summed[name] += share * gradient
    assert (both.loss, both.error) == (pytest.approx(loss), pytest.approx(error))
    for name, gradient in both.gradients.items():
        np.testing.assert_allclose(summed[name], gradient, rtol=1e-4, atol=1e-6 * np.abs(gradient).max())


class Counter:
    def __init__(self, count):
        if count < 0:
            raise ValueError("none can be there")
        self.count = count

    def add(self, more):
        self.count += more
        return self.count, os.getpid()

    def end(self):
        os._exit(3)


def test_methods_in_another_process_are_called_in_order():
    with closing(ProcessObject(Counter, 3)) as there:
        answers = [there.call("add", more) for more in (4, 5)]
        (first, process), (second, same) = (answer() for answer in answers)
        assert (first, second) == (7, 12)
        assert process == same != os.getpid()
        with pytest.raises(TypeError):
            there.call("add", "x")()
        answer = there.call("end")
        for failed in (answer, lambda: there.call("add", 1)):
            with pytest.raises(WorkerError, match="a worker process ended unexpectedly"):
                failed()


def test_an_error_of_the_constructor_is_raised_by_the_first_call():
    with closing(ProcessObject(Counter, -1)) as there, pytest.raises(ValueError, match="none can be there"):
        there.call("add", 1)()


def test_parallel_trainings_share_the_processes():
    assert [Workers(5).each_of(tasks) for tasks in (1, 2, 5, 9)] == [5, 2, 1, 1]
