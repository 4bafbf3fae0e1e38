"""Does this installation work? Versions, extras, the exact model's compiling, states put back, the law of impact."""

from __future__ import annotations

import platform
import sys
import time
from collections.abc import Callable
from importlib import metadata

import numpy as np

from jackbox_env import Scene, __version__, make_simulator
from jackbox_env.commands.common import command_line, extras, package_of, parser_of
from jackbox_env.mechanics import impact_map
from jackbox_env.simulators.replay import replayed
from jackbox_env.states import Array

_DT = 0.02  # [s]
_AGREES = 1e-9  # relative
_CORE = ("gymnasium", "numba", "numpy", "pymunk")


def _versions() -> str:
    found = ", ".join(f"{name} {metadata.version(name)}" for name in _CORE)
    return f"jackbox {__version__}, Python {platform.python_version()}, {found}"


def _installed(requirement: str) -> bool:
    try:
        metadata.version(package_of(requirement))
    except metadata.PackageNotFoundError:
        return False
    return True


def extra_lines() -> list[str]:
    """A line for each extra: installed, or how to get what is missing."""
    lines = []
    for name, asked in extras().items():
        if name in ("all", "dev", "docs", "peers"):  # the others together; for work on the project itself
            continue
        missing = [requirement for requirement in asked if not _installed(requirement)]
        state = "installed"
        if missing:
            wanted = " ".join(f'"{requirement}"' for requirement in missing)
            state = f"not installed; to get it: pip install {wanted}"
        lines.append(f"{name}: {state}")
    return lines


def _compiles() -> str:
    began = time.perf_counter()
    simulator = make_simulator(contact="exact")
    simulator.step(_DT)
    return f"ready after {time.perf_counter() - began:.1f} s; later processes load what was compiled"


def _run(contact: str, start: tuple[Array, float] | None, steps: int) -> tuple[list[Array], float]:
    simulator = make_simulator(contact=contact)
    if start is not None:
        simulator.reset(*start)
    states = []
    for _ in range(steps):
        simulator.step(_DT)
        states.append(simulator.state)
    return states, simulator.time


def restores(contact: str) -> str:
    """Put back a state on the way, and step on from it.

    Raises:
        RuntimeError: the rest of the way differs in a bit.
    """
    whole, _ = _run(contact, None, 150)
    first, when = _run(contact, None, 75)
    again, _ = _run(contact, (first[-1], when), 75)
    if np.array(again).tobytes() != np.array(whole[75:]).tobytes():
        raise RuntimeError("a state that was put back leads elsewhere")
    return "a state put back gives the same 75 steps, bit for bit"


def obeys_the_law() -> str:
    """Compare each impact of the exact model within 3 s with the impact map.

    Raises:
        RuntimeError: an impulse, or the state after the step, is another.
    """
    scene, worst, count = Scene(), 0.0, 0
    simulator = make_simulator(scene, contact="exact")
    simulator.reset([0.0] * 12)
    for _ in range(150):
        state, begun = simulator.state, simulator.time
        simulator.step(_DT)
        if not simulator.impacts:
            continue
        replay = replayed(scene, state.tolist(), begun, simulator.impacts, simulator.time, None)
        for impact, moment in zip(simulator.impacts, replay.moments, strict=True):
            after, impulse = impact_map(scene, moment.before, impact.wall, impact.foot)
            worst = max(worst, abs(impulse - impact.impulse) / impulse, float(np.abs(after - moment.after).max()))
            count += 1
        worst = max(worst, float(np.abs(simulator.state - replay.state).max()))
    if not (count and worst <= _AGREES):
        raise RuntimeError(f"{count} impacts differ from the impact map by up to {worst:.1e}")
    return f"{count} impacts agree with the impact map to {worst:.0e}"


_CHECKS: dict[str, Callable[[], str]] = {
    "exact model": _compiles,
    "exact model, states": lambda: restores("exact"),
    "exact model, law": obeys_the_law,
    "pymunk, states": lambda: restores("pymunk"),
}


@command_line
def main() -> None:
    """Check one thing after the other; exit with 1 if any fails."""
    parser_of(None, __doc__).parse_args()
    print(_versions())
    for line in extra_lines():
        print(f"  extra {line}")
    failed = False
    for name, check in _CHECKS.items():
        try:
            print(f"ok      {name}: {check()}", flush=True)
        except Exception as error:  # whatever is wrong, the other checks tell more
            failed = True
            print(f"FAILED  {name}: {type(error).__name__}: {error}", flush=True)
    print("This installation does not work." if failed else "This installation works.")
    if failed:
        sys.exit(1)


if __name__ == "__main__":
    main()
