"""What a control step costs as a graph: recorded, compiled and called by ours and by CasADi."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np

from auv_gym import PRESETS
from auv_gym.codegen import native
from auv_gym.envs.lanes import Lanes
from auv_gym.physics.rows import filled, leaves
from auv_gym.task import simulation
from auv_gym.task.kernels import Vehicles, step_kernel
from auv_gym.task.simulation import PARAMETER_ROWS, PLANT, PLANT_ROWS, SAMPLE_ROWS, Parameters
from research.throughput.figures import SCENARIO, Figure, faster, takes
from research.throughput.timing import cpu_time, interleaved, timed, typical_time

_PARTS = PRESETS[SCENARIO].parts  # what is in use of the simulation
MANY = 1024  # vehicles side by side


def with_casadi(casadi: Any) -> Any:
    """Return `simulation.step` as CasADi's function of plant, action, sample and parameters."""
    casadi.SX.__or__, casadi.SX.__xor__ = casadi.logic_or, lambda x, _: casadi.logic_not(x)  # it has neither
    ns: Any = SimpleNamespace(
        sin=casadi.sin,
        cos=casadi.cos,
        sqrt=casadi.sqrt,
        floor=casadi.floor,
        where=casadi.if_else,
        clip=lambda x, low, high: casadi.fmin(casadi.fmax(x, low), high),
    )
    sizes = (PLANT_ROWS, 2, SAMPLE_ROWS, PARAMETER_ROWS)
    given = [casadi.SX.sym(f"a{i}", n) for i, n in enumerate(sizes)]
    plant, action, sample, numbers = map(casadi.vertsplit, given)
    after, terms, outcome = simulation.step(filled(PLANT, plant), action, sample, Parameters.of(numbers, _PARTS), ns)
    return casadi.Function("step", given, [casadi.cse(casadi.vertcat(*leaves(after), *terms, *outcome))])


def tracing_cases(quick: bool) -> Iterator[Figure]:
    """Recording, calling for one vehicle, and running for many."""
    import casadi

    def recorded() -> None:
        step_kernel.cache_clear()
        step_kernel(_PARTS)

    def stepping(n: int, calls: int) -> Callable[[], None]:
        lanes = Lanes(n, SCENARIO, None, None)
        beginning, vehicles = lanes.reset(0, None), Vehicles(_PARTS, lanes.samples, lanes.constants)
        vehicles.place(beginning.lanes, beginning.plant, beginning.seen)

        def work() -> None:
            for _ in range(calls):
                vehicles.step(0)

        return work

    rounds, calls = (1, 1) if quick else (9, 100)
    theirs = with_casadi(casadi)
    sizes = (PLANT_ROWS, 2, SAMPLE_ROWS, PARAMETER_ROWS)
    single, several = ([np.ones((rows, n)) for rows in sizes] for n in (1, MANY))
    side_by_side = theirs.map(MANY)
    times = interleaved(
        rounds,
        timed(recorded),
        timed(lambda: with_casadi(casadi)),
        timed(stepping(1, calls), calls),
        timed(lambda: [theirs(*single) for _ in range(calls)], calls),
        timed(stepping(MANY, calls), calls * MANY),
        timed(lambda: side_by_side(*several), MANY),
    )
    ours, casadis, call, their_call, lane, their_lane = map(typical_time, times)
    yield faster("recording a control step, against CasADi", ours, casadis)
    yield faster("  a call for one vehicle", call, their_call)
    yield faster(f"  a vehicle step of {MANY} side by side", lane, their_lane)
    yield takes("  ours, one vehicle", call)
    yield takes(f"  ours, a vehicle of {MANY}", lane)
    if native.wanted() and native.compiler():
        yield takes(
            "building the control step, once a machine", typical_time(interleaved(1 if quick else 5, building)[0])
        )


def building() -> list[float]:
    """Return how long compiling a control step takes, into a cache of its own."""
    with tempfile.TemporaryDirectory() as cache, mock.patch.dict(os.environ, {native.CACHE: cache}):
        begin = cpu_time()
        native.library(f"/* {cache} */\n{step_kernel(_PARTS).source}")
        return [cpu_time() - begin]
