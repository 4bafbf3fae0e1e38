"""The settings of the sweep: both contact models, and the baselines that are installed."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from jackbox_env import Scene, make_simulator
from jackbox_env.simulators import Simulator
from jackbox_env.simulators.fidelity import FIDELITIES
from scripts.studies import baselines

TOGETHER = 1024
EXACT, BATCH, PYMUNK, NAIVE = "exact", f"exact, {TOGETHER:,} at once", "pymunk", "usual way"  # families: lines
USUAL = f"{NAIVE}, RK4 at 0.01 s"
SUBSTEPS = (1, 2, 4, 8, 16, 32, 64, 128, 256)  # per control step of 0.02 s
ITERATIONS = (1, 2, 5, 10, 20)


class Setting(NamedTuple):
    """One point of the sweep."""

    name: str
    family: str
    substeps: int | None = None
    make: Callable[[Scene], Simulator] | None = None  # None: a batch, which only costs less

    @property
    def takes_loss(self) -> bool:
        """Whether it is measured in scenes with loss: MuJoCo is tuned for elastic ones, the usual way has no loss."""
        return self.make is not None and self.family.split(",")[0] in (EXACT, PYMUNK, "box2d")


def named(family: str, substeps: int, iterations: int | None = None) -> str:
    """Name of a setting."""
    note = f", {iterations} iteration{'s' * (iterations > 1)}" if iterations else ""
    return f"{family}, {substeps} substep{'s' * (substeps > 1)}{note}"


def pymunk(substeps: int, iterations: int | None = None) -> Setting:
    """pymunk with these substeps, and these iterations of its solver in place of the default's 64."""
    family = f"{named(PYMUNK, substeps)}, iterations {ITERATIONS[0]} to {ITERATIONS[-1]}" if iterations else PYMUNK
    make = partial(make_simulator, contact="pymunk", substeps=substeps, iterations=iterations)
    return Setting(named(PYMUNK, substeps, iterations), family, substeps, make)


def _of_others(counts: tuple[int, ...]) -> list[Setting]:
    usual = Setting(USUAL, NAIVE, 2, partial(baselines.baseline("threshold"), substeps=2))
    engines = [name for name in ("box2d", "mujoco") if name not in baselines.missing()]
    settings = [(name, n, partial(baselines.baseline(name), substeps=n)) for name in engines for n in counts]
    return [usual, *(Setting(named(name, n), name, n, make) for name, n, make in settings)]


def settings(quick: bool) -> list[Setting]:
    """All settings of the sweep, or those of the quick one."""
    both = [Setting(EXACT, EXACT, None, partial(make_simulator, contact="exact")), Setting(BATCH, BATCH)]
    if quick:
        few = sorted({16, *(fidelity.substeps for fidelity in FIDELITIES.values() if fidelity.substeps)})
        return [*both, *map(pymunk, few), pymunk(4, 1), *_of_others((4, 64))]
    fewer = [pymunk(substeps, iterations) for substeps in (4, 64) for iterations in ITERATIONS]
    return [*both, *map(pymunk, SUBSTEPS), *fewer, *_of_others((1, 4, 16, 64))]


def of_fidelity(fidelity: str) -> str:
    """Name of the setting that a fidelity stands for."""
    contact, substeps = FIDELITIES[fidelity]
    return EXACT if contact == "exact" else pymunk(substeps or 4).name
