"""A kind of motion with a third, idle actuator: all sizes follow from its `Model`, and the plane is unchanged in it."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np
import pytest

from auv_gym.effects.actuators import Actuators
from auv_gym.effects.faults import RandomFaults
from auv_gym.effects.sensors import Sensors
from auv_gym.envs.residual import ResidualAction, VectorResidualAction
from auv_gym.envs.sub_environments import SubEnvironments
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.namespaces import FLOATS, Number
from auv_gym.physics.vehicle import Coefficients
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.model import PLANE, Model, Plant, ReferencePoint, Sample
from auv_gym.task.observation import Observation
from auv_gym.task.policy import Law
from baselines.control.backstepping import Backstepping
from baselines.evaluation.cells import drawn
from baselines.evaluation.rollout import rollout


def inserted(kind, after, defaults=(), **added):
    """Return a NamedTuple with fields inserted after others of the same type: after -> new name."""
    fields = []
    for name in kind._fields:
        fields.append((name, kind.__annotations__[name]))
        fields += [(new, kind.__annotations__[name]) for new, where in added.items() if where == name]
    made = NamedTuple(kind.__name__, [(name, Any) for name, _ in fields])
    made.__new__.__defaults__ = defaults
    made._field_defaults.update(zip([name for name, _ in fields][len(fields) - len(defaults) :], defaults, strict=True))
    return made


class Response3(NamedTuple):
    gain: Number
    mean: Number
    slew_u: Number
    slew_r: Number
    slew_b: Number


class Parameters3(NamedTuple):
    h: Number
    coefficients: Coefficients
    F_u_max: Number
    F_r_max: Number
    F_b_max: Number
    response: Response3
    error_scale: Number
    rate_weight: Number
    lost_distance: Number
    thrust_u: Number
    thrust_r: Number
    thrust_b: Number
    parts: Any = None
    own: tuple = ()


class Observation3(NamedTuple):
    e_x: Annotated[Number, "m", 1.0, 64.0, ""]
    e_y: Annotated[Number, "m", 1.0, 64.0, ""]
    psi_e: Annotated[Number, "rad", 0.5, 2 * math.pi, ""]
    u_e: Annotated[Number, "m/s", 0.5, 32.0, ""]
    v_e: Annotated[Number, "m/s", 0.5, 32.0, ""]
    r_e: Annotated[Number, "rad/s", 0.125, 64.0, ""]
    u_R: Annotated[Number, "m/s", 0.5, 32.0, ""]
    v_R: Annotated[Number, "m/s", 0.5, 32.0, ""]
    r_R: Annotated[Number, "rad/s", 0.125, 64.0, ""]
    F_uR: Annotated[Number, "N", 128.0, 64.0, ""]
    F_rR: Annotated[Number, "N m", 64.0, 64.0, ""]
    F_bR: Annotated[Number, "N", 64.0, 64.0, ""]
    cos_psi: Annotated[Number, "1", 1.0, 1.0, ""]
    sin_psi: Annotated[Number, "1", 1.0, 1.0, ""]
    F_u_max: Annotated[Number, "N", 128.0, 64.0, ""]
    F_r_max: Annotated[Number, "N m", 64.0, 64.0, ""]
    F_b_max: Annotated[Number, "N", 64.0, 64.0, ""]
    a_u: Annotated[Number, "1", 1.0, 1.0, ""]
    a_r: Annotated[Number, "1", 1.0, 1.0, ""]
    a_b: Annotated[Number, "1", 1.0, 1.0, ""]
    dt: Annotated[Number, "s", 0.125, 80.0, ""]


THREE = Model(
    name="plane with a third actuator",
    Plant=inserted(Plant, (), ((),), F_b="F_r", a_b="a_r"),
    Sample=inserted(Sample, (), F_bR="F_rR"),
    Reference=inserted(ReferencePoint, (), F_b="F_r"),
    Parameters=Parameters3,
    Observation=Observation3,
    channels=("u", "r", "b"),
    driven=("X", "N", "Y"),
    position=PLANE.position,
    velocity=PLANE.velocity,
    current=PLANE.current,
    load=PLANE.load,
    advance=PLANE.advance,
    from_outside=PLANE.from_outside,
    over_ground=PLANE.over_ground,
    errors=PLANE.errors,
    terms=PLANE.terms,
)
"""The third actuator acts on the sway force, with no thrust."""
_THIRD = [i for i, name in enumerate(Observation3._fields) if name not in Observation._fields]
SHARED = [i for i in range(len(Observation3._fields)) if i not in _THIRD]


@dataclass(frozen=True)
class Tables:
    """The planner of a scenario, with a third force of zero in its tables."""

    planner: Any

    def table(self, path, **options):
        return self._wider(self.planner.table(path, **options))

    def tables(self, paths, n):
        return [None if table is None else self._wider(table) for table in self.planner.tables(paths, n)]

    def _wider(self, table):
        return np.hstack((table, np.zeros((len(table), 1))))


@dataclass(frozen=True)
class Scenario3(Scenario):
    """A scenario with a third actuator that has the surge limit and no thrust."""

    @cached_property
    def parts(self):
        return super().parts._replace(model=THREE)

    @property
    def planner(self):
        return Tables(super().planner)

    def constants(self, episode, parts=None):
        parts = parts or self.parts
        p = super().constants(replace(episode, reach=episode.reach), parts._replace(model=PLANE))
        values = {name: x for name, x in p._asdict().items() if name not in ("response", "parts", "own")}
        own = []
        for effect in parts.effects:
            numbers = effect.constants(self, episode)
            own += [*numbers, 1.0] if "Constants" in effect.repeated else numbers
        response = Response3(*p.response, math.inf)
        return Parameters3(**values, F_b_max=400.0, thrust_b=0.0, response=response, parts=parts, own=tuple(own))


def third(scenario):
    return Scenario3(**{name: getattr(scenario, name) for name in Scenario.__dataclass_fields__})


STORM = replace(
    PRESETS["cruise-storm"],
    sensors=Sensors(position=0.1, outages=3.0, low_pass=1.0),
    actuators=Actuators(lag=0.3, F_u_rate=300.0, delay=(1.0, 2.0), reach=(0.6, 0.9), astern=0.5),
    faults=RandomFaults(("surge stuck", "yaw dead", "all frozen"), rate=6.0),
)


class Law3(Law):
    """The paper's law, and nothing on the third actuator."""

    layout = THREE.layout

    def forces(self, o, ns=FLOATS):
        return (*Backstepping().forces([o[i] for i in SHARED], ns), 0.0 * o[0])

    def __eq__(self, other):
        return type(other) is Law3

    def __hash__(self):
        return 3


@pytest.mark.parametrize("scenario", [PRESETS["cruise-storm"], STORM], ids=["storm", "effects"])
def test_the_plane_is_unchanged_for_one_vehicle_and_for_many(scenario):
    """The same bits with and without the idle actuator, whatever its commands."""
    plane, wide = UnderactuatedAUVTrackVectorEnv(6, scenario), UnderactuatedAUVTrackVectorEnv(6, third(scenario))
    single = UnderactuatedAUVTrackEnv(third(scenario))
    assert (single.action_space.shape, single.observation_space.shape) == ((3,), (21,))
    seen, (broad, _), (alone, _) = plane.reset(seed=2)[0], wide.reset(seed=2), single.reset(seed=2)
    rng = np.random.default_rng(0)
    for _ in range(80):
        np.testing.assert_array_equal(broad[:, SHARED], seen)
        np.testing.assert_array_equal(broad[0], alone)
        action = rng.uniform(-1, 1, (6, 3))
        action[:, 2] = 0.0
        seen, rewards, *_ = plane.step(action[:, :2])
        broad, same, *_ = wide.step(action)
        alone, reward, *_ = single.step(action[0])
        np.testing.assert_array_equal(rewards, same)
        assert reward == same[0]
    assert wide.force.shape == (6, 3)
    assert single.reference._fields == (*ReferencePoint._fields, "F_b")
    np.testing.assert_array_equal(plane.state, wide.state)
    with pytest.raises(ValueError, match="it must be three finite numbers"):
        single.step(np.zeros(2))


def test_the_third_command_costs_reward_and_is_observed():
    env = UnderactuatedAUVTrackEnv(third(PRESETS["cruise-calm"]))
    env.reset(seed=0)
    _, still, *_ = env.step(np.zeros(3))
    env.reset(seed=0)
    observation, moved, *_, info = env.step(np.array([0.0, 0.0, 1.0]))
    assert still - moved == pytest.approx(env.scenario.rate_weight, rel=1e-9)
    assert info["saturated"]
    assert THREE.Observation._make(THREE.layout.terms_of(observation)).a_b == 1.0


def test_other_models_do_not_run_together():
    with pytest.raises(ValueError, match="of the models 'plane' and 'plane with a third actuator' cannot run"):
        UnderactuatedAUVTrackVectorEnv(2, [PRESETS["cruise-calm"], third(PRESETS["cruise-calm"])])


def test_an_evaluation_has_the_same_metrics():
    scenario = PRESETS["cruise-storm"]
    episodes = drawn(scenario, 4, 0).episodes
    plane, wide = (
        rollout(law, s, episodes).measures for law, s in ((Backstepping(), scenario), (Law3(), third(scenario)))
    )
    np.testing.assert_array_equal(plane.steady_rmse, wide.steady_rmse)
    np.testing.assert_allclose(wide.effort, plane.effort * 2 / 3, rtol=1e-12)


def test_corrections_of_a_law():
    """Compiled into the step, and around it, for one vehicle and for many."""
    scenario, rng = third(PRESETS["cruise-storm"]), np.random.default_rng(1)
    one = ResidualAction(UnderactuatedAUVTrackEnv(scenario), Law3(), (0.3, 0.2, 0.1))
    many = VectorResidualAction(UnderactuatedAUVTrackVectorEnv(3, scenario), Law3(), (0.3, 0.2, 0.1))

    class Around(Law3):
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return super().predict(observation, state, episode_start, deterministic)

    around = ResidualAction(UnderactuatedAUVTrackEnv(scenario), Around(), (0.3, 0.2, 0.1))
    seen, together, other = one.reset(seed=5)[0], many.reset(seed=5)[0], around.reset(seed=5)[0]
    assert seen.shape == (24,)
    for _ in range(40):
        np.testing.assert_array_equal(seen, together[0])
        np.testing.assert_allclose(other, seen, rtol=1e-6, atol=1e-6)
        action = rng.uniform(-1, 1, 3)
        seen, together, other = one.step(action)[0], many.step(np.tile(action, (3, 1)))[0], around.step(action)[0]
    with pytest.raises(ValueError, match="or one each for 3 channels"):
        ResidualAction(UnderactuatedAUVTrackEnv(scenario), Law3(), (0.3, 0.2))


@dataclass(frozen=True)
class Inputs3:
    """Features of the shared terms: the errors, and the last corrections."""

    preview: tuple = ()
    memory: int = 1
    nominal_vehicle: bool = False
    filters: bool = False
    features: tuple = tuple(range(9))
    constants: range = range(0)

    def update(self, o, ahead, base, correction, memory, ns, known=None):
        return (*o[:6], *correction), (memory[0] + o[0],)


def test_a_training_window_has_the_gradient_of_its_loss():
    """Compared with differences of the mean loss, for weights of all three outputs."""
    torch = pytest.importorskip("torch")
    from baselines.agents.networks import Mlp
    from baselines.training.apg.closed_loop import ClosedLoop, Loss
    from baselines.training.apg.kernels import LoopKernels
    from baselines.training.apg.network import torch_network
    from baselines.training.apg.window import Carried, Objective, TrainingWindow

    torch.manual_seed(0)
    n, steps, scenario = 3, 5, third(PRESETS["cruise-storm"])
    envs = SubEnvironments([scenario] * n)
    started = envs.reset(7, None)
    samples = np.empty((steps, *envs.sample.shape))
    for sample in samples:
        sample[:] = envs.next_sample()
        envs.advance()
    inputs = Inputs3()
    kernels = LoopKernels(ClosedLoop(Law3().forces, inputs, envs.parts), True, "float64")
    network = torch_network(Mlp(len(inputs.features), (8,), bound="tanh", outputs=3)).double()
    with torch.no_grad():
        for p in network.parameters():
            p.copy_(0.3 * torch.randn_like(p))
    window = TrainingWindow(kernels, network, steps, (0.3, 0.2, 0.1), Objective(Loss(0.1, 0.1), np.full(n, 1 / n)))

    def loss():
        carried = Carried(started.plant, started.observation, np.zeros((1, n)), np.zeros((3, n)), np.zeros((0, n)))
        value, *_ = window.run(carried, np.zeros((steps, 0, n)), samples, envs.constants, None, np.zeros((0, n)))
        return value

    loss()
    head = network.layers[-1]
    gradient = head.bias.grad.clone()
    for i in range(3):
        around = []
        for side in (1e-5, -1e-5):
            with torch.no_grad():
                head.bias[i] += side
            around.append(loss())
            with torch.no_grad():
                head.bias[i] -= side
        assert gradient[i].item() == pytest.approx((around[0] - around[1]) / 2e-5, rel=1e-4, abs=1e-9)
        assert gradient[i].abs() > 1e-6
