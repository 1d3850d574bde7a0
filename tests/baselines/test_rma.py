"""Rapid motor adaptation: extrinsics, gradients, the student on NumPy, and that it learns the latent."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from auv_gym.physics.actuators import Response
from auv_gym.physics.rows import filled
from auv_gym.physics.vehicle import LIFT, PAPER_VEHICLE
from auv_gym.scenarios.presets import PRESETS
from auv_gym.task.simulation import SAMPLE, Parameters, Parts
from baselines.agents.features import FEATURES
from baselines.agents.networks import OUTPUTS, Rma
from baselines.training.apg.passes import NetworkTape
from baselines.training.apg.torch_network import weights_of
from baselines.training.apg.vehicles import TrainingVehicles
from baselines.training.config import Config
from baselines.training.rma.extrinsics import EXTRINSICS, extrinsics
from baselines.training.rma.networks import Filters, Teacher, TeacherPass
from baselines.training.rma.trainer import RmaTrainer, check
from baselines.training.run_folder import RunFolder

SIZES = Rma(len(FEATURES), (7, 6), latent=3, channels=4)
ROW = {name: i for i, name in enumerate(EXTRINSICS)}


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)
    torch.manual_seed(0)


def known_to_a_teacher(name, n=3):
    vehicles = TrainingVehicles([PRESETS[name]] * n, 5, 4)
    vehicles.reset(0)
    _, samples = vehicles.window()
    return extrinsics(samples, vehicles.constants, PAPER_VEHICLE), samples, Parameters.of(vehicles.constants, Parts())


def test_extrinsics_are_zero_for_a_known_vehicle_in_still_water():
    found, *_ = known_to_a_teacher("slow-calm")
    assert found.shape == (4, len(EXTRINSICS), 3)
    np.testing.assert_allclose(found, 0.0, atol=1e-12)


def test_each_disturbance_shows_in_its_own_rows_alone():
    kinds = {
        "cruise-current": {"V_u", "V_v"},
        "slow-waves": {"X", "Y", "N"},
        "slow-actuator": {"lag"},
        "cruise-mismatch": set(PAPER_VEHICLE.coefficients._fields) - set(LIFT),
    }
    for name, rows in kinds.items():
        found, *_ = known_to_a_teacher(name)
        changed = np.abs(found).max(axis=(0, 2)) > 1e-9
        assert {row for row, i in ROW.items() if changed[i]} == rows, name
        assert 0.05 < np.abs(found).max() < 8


def test_extrinsics_are_what_acts_on_the_vehicle():
    found, samples, _ = known_to_a_teacher("cruise-storm", 4)
    s = filled(SAMPLE, samples.swapaxes(0, 1))
    speed = np.hypot(s.u_R, s.v_R)
    water = (s.V_x + 1j * s.V_y) * np.exp(-1j * s.psi_R)  # in the reference's axes
    np.testing.assert_allclose(found[:, ROW["V_u"]] + 1j * found[:, ROW["V_v"]], 2 * water / speed)
    _, _, p = known_to_a_teacher("cruise-storm", 4)
    np.testing.assert_allclose(found[:, ROW["m22"]], np.tile(5 * (p.coefficients.m22 / 265.0 - 1), (4, 1)))
    np.testing.assert_allclose(1 - found[:, ROW["lag"]], np.tile(p.response.gain, (4, 1)))
    assert Response.of(0.3, 1.0, 1.0, 0.1).gain == pytest.approx(1 - np.exp(-1 / 3))


def test_the_student_on_numpy_is_the_one_that_torch_trains():
    filters, teacher = Filters(SIZES).double(), Teacher(SIZES, 5).double()
    for layer in teacher.acting.layers:
        torch.nn.init.normal_(layer.weight, std=0.4)
    layers = SIZES.prepared(weights_of(filters) | weights_of(teacher.acting))
    x = torch.randn(70, SIZES.inputs, 5, dtype=torch.float64)
    hidden, seen, kept = np.zeros((SIZES.memory, 5)), [], None
    for k, row in enumerate(x.numpy()):
        if k == 60:
            kept = torch.from_numpy(hidden)
        latent, _ = SIZES.estimate(layers, row, hidden)
        action, hidden = SIZES.forward(layers, row, hidden)
        seen.append(latent)
        y = torch.cat((torch.from_numpy(row), torch.from_numpy(latent)))
        for layer in teacher.acting.layers:
            y = torch.tanh(layer(y.T).T)
        np.testing.assert_allclose(action, y.detach().numpy(), atol=1e-6)
    whole = filters(x, torch.zeros(SIZES.memory, 5, dtype=torch.float64)).detach().numpy()
    np.testing.assert_allclose(np.array(seen), whole, atol=1e-6)
    np.testing.assert_allclose(filters(x[60:], kept).detach().numpy(), whole[60:], atol=1e-6)  # going on


def test_an_estimate_is_of_the_last_48_steps():
    layers = SIZES.prepared(weights_of(Filters(SIZES)) | weights_of(Teacher(SIZES, 5).acting))
    rng = np.random.default_rng(0)
    x = rng.standard_normal((120, SIZES.inputs, 2))
    x[:, :, 1] = x[:, :, 0]
    x[40, :, 1] += 1.0
    hidden, differs = np.zeros((SIZES.memory, 2)), []
    for row in x:
        latent, hidden = SIZES.estimate(layers, row, hidden)
        differs.append(bool((latent[:, 0] != latent[:, 1]).any()))
    assert [k for k, d in enumerate(differs) if d] == list(range(40, 88))


def test_gradient_of_a_teacher_equals_that_of_torch():
    teacher, T, N = Teacher(SIZES, 5).double(), 6, 4
    for layer in teacher.acting.layers:
        torch.nn.init.normal_(layer.weight, std=0.4)
    features, rows = (torch.randn(T, n, N, dtype=torch.float64) for n in (SIZES.inputs, len(EXTRINSICS)))
    d = torch.randn(T, OUTPUTS, N, dtype=torch.float64)
    corrections = torch.zeros(T + 1, OUTPUTS, N, dtype=torch.float64)
    tape = NetworkTape(
        features, torch.zeros(T + 1, 0, N), corrections, torch.zeros_like(features[0]), torch.zeros_like(d[0])
    )
    way, by_features = TeacherPass(teacher, tape), []
    way.extrinsics = rows
    with torch.no_grad():
        way.begin()
        for k in range(T):
            way.forward(k)
        for k in reversed(range(T)):
            tape.d_correction.copy_(d[k])
            way.backward(k)
            by_features.append(tape.d_inputs.clone())
        way.finish()
    found = [p.grad.clone() for p in teacher.parameters()]
    teacher.zero_grad()
    y = torch.cat((features.requires_grad_(), teacher.latent(rows)), 1)
    for layer in teacher.acting.layers:
        y = torch.tanh(layer(y.transpose(1, 2)).transpose(1, 2))
    np.testing.assert_allclose(corrections[1:], y.detach(), atol=1e-12)
    (y * d).sum().backward()
    for mine, p in zip(found, teacher.parameters(), strict=True):
        np.testing.assert_allclose(mine, p.grad, atol=1e-10)
    np.testing.assert_allclose(torch.stack(by_features[::-1]), features.grad, atol=1e-10)


def config(**values):
    currents = replace(PRESETS["slow-current"], name="currents", steps=200)
    given = {"n_envs": 32, "n_steps": 50, "hidden_size": 16, "adaptation_share": 0.6, **values}
    return Config("rma", ((currents, 1.0),), authority=(0.6, 1.6), timesteps=160_000, hyperparameters=given)


def test_a_teacher_learns_and_its_student_learns_the_latent(tmp_path, monkeypatch):
    monkeypatch.setattr(RunFolder, "validate", lambda *_: 0.0)
    trainer = RmaTrainer(RunFolder(config(), tmp_path))
    lessons = [trainer._teach()["window_error_m"] for _ in range(40)]
    assert np.mean(lessons[-4:]) < 0.6 * np.mean(lessons[2:6])
    before = [p.detach().clone() for p in trainer.network.parameters()]
    trainer.updates = trainer.lessons
    adapted = [trainer._adapt() for _ in range(60)]
    assert all(torch.equal(a, b) for a, b in zip(before, trainer.network.parameters(), strict=True))
    errors = [row["latent_error"] / row["latent_variance"] for row in adapted]
    assert np.mean(errors[-10:]) < 0.5 < np.mean(errors[:3])  # 1: as good as the mean


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"memory": True}, "unknown hyper-parameter 'memory' of rma; allowed are latent, channels"),
        ({"groups": 2}, "unknown hyper-parameter 'groups' of rma"),
        ({"latent": 0}, r"latent is 0; it must be an integer in \[1, 4096\]"),
        ({"adaptation_share": 1.0}, "adaptation_share"),
        ({"n_steps": 300}, "n_steps is 300"),
        ({"expert": "ekf"}, "expert 'ekf' computes on NumPy; rma corrects laws alone"),
    ],
)
def test_wrong_hyperparameters_and_experts_without_a_law_are_refused(changes, message):
    expert = {"expert": changes["expert"]} if "expert" in changes else {}
    with pytest.raises(ValueError, match=message):
        check(replace(config(**({} if expert else changes)), **expert))
