"""What is kept of traced equations: a warm process traces nothing, and no two equations share a key."""

import copy
import pickle
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from native_cache import forget

from auv_gym.codegen import graph, native, traces
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.vehicles import vehicle_names
from auv_gym.task.kernels import start_kernel, step_kernel
from baselines import run_episode
from baselines.control.backstepping import Backstepping
from baselines.control.open_loop import OpenLoop, Zero

needs_compiler = pytest.mark.skipif(not native.has_compiler(), reason="without a compiler equations are always traced")


@needs_compiler
@pytest.mark.parametrize("policy", ["los-pid", "ekf"])
def test_a_warm_process_traces_nothing(policy, cache, monkeypatch):
    cold = run_episode(policy, "cruise-storm", seed=3)
    forget()
    monkeypatch.setattr(graph.Graph, "apply", lambda *_: pytest.fail("an equation is traced"))
    monkeypatch.setattr(native, "_compile", lambda *_: pytest.fail("a library is compiled"))
    warm = run_episode(policy, "cruise-storm", seed=3)
    np.testing.assert_array_equal(warm.actions, cold.actions)
    np.testing.assert_array_equal(warm.observations, cold.observations)


@needs_compiler
def test_changed_sources_are_traced_again(cache, monkeypatch):
    expected = step_kernel(PRESETS["cruise-storm"].parts).digest
    for function in (step_kernel, start_kernel):
        function.cache_clear()
    forget()
    monkeypatch.setattr(traces, "_AT_IMPORT", "other sources")
    runs = []
    real = graph.Graph.apply
    monkeypatch.setattr(graph.Graph, "apply", lambda *given: runs.append(1) or real(*given))
    assert step_kernel(PRESETS["cruise-storm"].parts).digest == expected
    assert runs
    assert not (cache / f"{traces.trace_key(1)}.json").exists(), "the files differ from the sources at the import"


def values():
    """Return values that equations may use, all different."""
    law = Backstepping()
    vehicles = [PAPER_VEHICLE, replace(PAPER_VEHICLE, d22=np.nextafter(PAPER_VEHICLE.d22, np.inf))]
    parts = PRESETS["cruise-storm"].parts
    plain = [None, True, 1, 1.0, "1", b"1", (), (1,), [1], (1, 2), ((1,), 2), {"a": 1}, {"b": 1}, {"a": 2}]
    arrays = [np.arange(3.0), np.arange(3.0)[:, None], np.arange(3), np.array([0.0, 1.0, np.nextafter(2.0, 3.0)])]
    laws = [law, Backstepping("paper"), Backstepping(horizon=2.0)]
    laws += [OpenLoop(), Zero(), *(Backstepping(vehicle=name) for name in vehicle_names()[:3])]
    functions = [law.forces, law.check, OpenLoop().forces, Backstepping.forces, OpenLoop, Backstepping]
    return [*plain, *arrays, *vehicles, parts, parts._replace(substeps=7), *laws, *functions]


def test_different_values_have_different_keys():
    for a, b in combinations(values(), 2):
        assert traces.trace_key(a) != traces.trace_key(b), (a, b)


def test_equal_values_have_equal_keys():
    for value in values():
        assert traces.trace_key(copy.deepcopy(value)) == traces.trace_key(value) != ""


def test_what_other_code_defines_has_no_key():
    class Mine:
        pass

    def equation(x):
        return {"y": x}

    assert [traces.trace_key(value) for value in (Mine, Mine(), equation, lambda: 0, object())] == [""] * 5


def test_equal_laws_share_their_kernels():
    parts = PRESETS["cruise-storm"].parts
    first, second = (step_kernel(parts, Backstepping()) for _ in range(2))
    assert first is second
    assert first is not step_kernel(parts, Backstepping(horizon=1.0))
    assert start_kernel(parts, Backstepping()) is start_kernel(parts, Backstepping())


def test_copies_of_kernels():
    kernel = Kernel.traced(lambda a: {"out": (a[0] * 2.0,)}, {"a": 1})
    assert copy.deepcopy(kernel) is kernel
    restored = pickle.loads(pickle.dumps(kernel))
    assert (restored.digest, restored.rows) == (kernel.digest, kernel.rows)
    np.testing.assert_array_equal(restored(a=np.array([[1.5, 2.5]]))["out"], [[3.0, 5.0]])
