"""Check this installation: versions, extras, compiled code, restored states, energy balance, the page to play."""

from __future__ import annotations

import platform
import re
import sys
import time
from collections.abc import Callable
from functools import partial
from importlib import metadata

import numpy as np

from jackbox_env import Scene, __version__, make_simulator
from jackbox_env.commands import play
from jackbox_env.commands.options import parser_of
from jackbox_env.measure.accuracy import Case, follow
from jackbox_env.planning import linearization
from jackbox_env.simulators import exact
from jackbox_env.tools.command_line import command_line, in_checkout

_DT = 0.02  # [s]
_TOLERANCE = 1e-9  # relative, of energy and work
_CORE = ("gymnasium", "numba", "numpy", "pymunk")


def extra_lines() -> list[str]:
    """A line for each extra: installed, or the command that installs its packages."""
    missing = dict[str, list[str]]()
    for line in metadata.requires("jackbox") or []:
        requirement, _, condition = line.partition(";")
        extra = re.search(r"extra == ['\"](\w+)['\"]", condition)
        if extra and extra[1] not in ("all", "dev", "docs", "peers"):  # the others together; for work on the project
            absent = missing.setdefault(extra[1], [])
            name = re.split(r"[^\w.-]", requirement)[0]  # "torch" of "torch<3,>=2.3"
            if not any(metadata.distributions(name=name)):
                absent.append(f'"{requirement.strip()}"')
    return [
        f"{name}: " + (f"not installed, pip install {' '.join(absent)}" if absent else "installed")
        for name, absent in missing.items()
    ]


def _compiled(ready: Callable[[], None]) -> str:
    """Compile a part of the exact model, or load its compiled code."""
    began = time.perf_counter()
    ready()
    return f"ready after {time.perf_counter() - began:.1f} s; later processes load the compiled code"


def restores(contact: str) -> str:
    """Restore a state, and check that it leads to the same steps.

    Raises:
        RuntimeError: a bit of the final state differs.
    """
    whole, again = make_simulator(contact=contact), make_simulator(contact=contact)
    for _ in range(75):
        whole.step(_DT)
    again.reset(whole.state, whole.time)
    for simulator in [whole, again] * 75:
        simulator.step(_DT)
    if whole.state.tobytes() != again.state.tobytes():
        raise RuntimeError("a restored state leads to another motion")
    return "75 steps from a restored state are the same, bit for bit"


def obeys_the_law() -> str:
    """Compare the energy that the exact model gains within 3 s, impacts included, with the work of the torque.

    Raises:
        RuntimeError: they differ, or there was no impact.
    """
    course = follow(make_simulator(contact="exact"), Case("check", Scene(), np.zeros(12), 150))
    count, off = len(course.impacts), course.imbalance / course.energy
    if not (count and off <= _TOLERANCE):
        raise RuntimeError(f"over {count} impacts energy and work differ by {off:.1e} of the energy")
    return f"over {count} impacts energy and work agree to {off:.0e}"


def has_page() -> str:
    """Find the page of `jackbox play`.

    Raises:
        FileNotFoundError: this package was built without it.
    """
    if in_checkout() and not play.PAGE.is_file():
        return "built at the first `jackbox play`"
    return f"{play.packaged().stat().st_size / 1e3:.0f} kB, `jackbox play` opens it"


_CHECKS: dict[str, Callable[[], str]] = {
    "exact model, environments": lambda: _compiled(partial(exact.ensure_compiled, lossy=True)),
    "exact model, derivatives": lambda: _compiled(linearization.ensure_compiled),
    "exact model, states": lambda: restores("exact"),
    "exact model, law": obeys_the_law,
    "pymunk, states": lambda: restores("pymunk"),
    "page to play": has_page,
}


@command_line
def main() -> None:
    """Run all checks; exit with 1 if any fails."""
    parser_of(__doc__).parse_args()
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in _CORE)
    print(f"jackbox {__version__}, Python {platform.python_version()}, {versions}")
    for line in extra_lines():
        print(f"  extra {line}")
    failed = False
    for name, check in _CHECKS.items():
        try:
            print(f"ok      {name}: {check()}", flush=True)
        except Exception as error:  # the other checks still run
            failed = True
            print(f"FAILED  {name}: {type(error).__name__}: {error}", flush=True)
    print("This installation does not work." if failed else "This installation works.")
    if failed:
        sys.exit(1)


if __name__ == "__main__":
    main()
