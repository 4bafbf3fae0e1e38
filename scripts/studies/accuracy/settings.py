"""What is swept: contact models with their settings, the usual way, and other engines where they are installed."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from jackbox_env import Scene, make_simulator, rollout
from jackbox_env.accuracy import Look, between
from jackbox_env.simulators import Simulator
from jackbox_env.simulators.fidelity import FIDELITIES
from scripts.studies import rivals
from scripts.studies.accuracy.cases import DT, STEPS, seeded
from scripts.studies.timing import Timed, repeat

EXACT, BATCH, NAIVE, PYMUNK = "exact", "exact, 1,024 at once", "usual way", "pymunk"
SUBSTEPS = (1, 2, 4, 8, 16, 32, 64, 128, 256)
ITERATIONS = (1, 2, 5, 10, 20)
RIVAL_SUBSTEPS = (1, 4, 16, 64)
TOGETHER = 1024


class Setting(NamedTuple):
    """One point of the sweep."""

    name: str
    family: str  # points of one family make a line
    make: Callable[[Scene], Simulator] | None  # None: nothing but the cost is its own
    substeps: int | None = None  # per control step of 0.02 s
    contact: str | None = None  # for the environment's keywords; None: it is not offered


def pymunk(substeps: int, iterations: int | None = None) -> Setting:
    """pymunk with these substeps, and the solver's iterations where they are not the scene's own."""
    note = f", {iterations} iteration{'s' * (iterations > 1)}" if iterations else ""
    name = f"pymunk, {substeps} substep{'s' * (substeps > 1)}{note}"
    family = f"pymunk, {substeps} substeps, iterations 1 to {ITERATIONS[-1]}" if iterations else PYMUNK
    make = partial(make_simulator, contact="pymunk", substeps=substeps, iterations=iterations)
    return Setting(name, family, make, substeps, None if iterations else "pymunk")


def _of_rival(factory: rivals.Factory, substeps: int) -> Callable[[Scene], Simulator]:
    return lambda scene: factory(scene, substeps)


def rival_settings(substeps: tuple[int, ...]) -> list[Setting]:
    """The usual way, and other engines that are installed."""
    found = []
    for name, factory in rivals.available().items():
        if name == "naive":
            found.append(Setting(f"{NAIVE}, RK4 at 0.01 s", NAIVE, _of_rival(factory, 2), 2))
            continue
        for count in substeps:
            label = f"{name}, {count} substep{'s' * (count > 1)}"
            found.append(Setting(label, name, _of_rival(factory, count), count))
    return found


def settings(quick: bool) -> list[Setting]:
    """All settings of the sweep, or those of the quick one."""
    exact = Setting(EXACT, EXACT, partial(make_simulator, contact="exact"), None, "exact")
    batch = Setting(BATCH, BATCH, None)
    if quick:
        few = sorted({16, *(fidelity.substeps for fidelity in FIDELITIES.values() if fidelity.substeps)})
        return [exact, batch, *(pymunk(count) for count in few), pymunk(4, 1), *rival_settings((4, 64))]
    return [
        exact,
        batch,
        *(pymunk(count) for count in SUBSTEPS),
        *(pymunk(count, iterations) for count in (4, 64) for iterations in ITERATIONS),
        *rival_settings(RIVAL_SUBSTEPS),
    ]


def look_of(simulator: Any) -> Look:
    """Who tells of the inside of a step: the model itself, where it is none of this package's."""
    look: Look = getattr(simulator, "look", between)
    return look


def cost_of(setting: Setting, seconds: float) -> Timed:
    """Simulated seconds per second of this thread's own time, which stands still while others have the processor."""
    cases = [seeded(kind, seed) for kind in ("chirp", "held", "weightless") for seed in range(2)]
    if setting.make is None:
        return _cost_of_many(seconds)
    made = [setting.make(case.scene) for case in cases]

    def block() -> int:
        for simulator, case in zip(made, cases, strict=True):
            simulator.reset(case.state)
            try:
                for number in range(case.steps):
                    simulator.step(DT, None if case.torques is None else case.torques[number])
            except RuntimeError:  # it lost the jack: what it did until then counts
                pass
        return sum(round(simulator.time / DT) for simulator in made)

    timed = repeat(block, seconds, clock=time.thread_time)
    return lambda: DT * timed()


def _cost_of_many(seconds: float) -> Timed:
    """The exact model under held torques in one compiled loop on one thread."""
    cases = [seeded("held", seed) for seed in range(TOGETHER)]
    states = np.array([case.state for case in cases])
    torques = np.array([case.torques for case in cases])

    def block() -> int:
        rollout(cases[0].scene, states, torques, DT, num_threads=1)
        return TOGETHER * STEPS

    timed = repeat(block, seconds, clock=time.thread_time)
    return lambda: DT * timed()
