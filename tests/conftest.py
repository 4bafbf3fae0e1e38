"""Settings and fixtures of all tests.

The compiled code is ready before several workers ask for it at once. Sweeps over random cases draw a quarter of them,
and all under ``--whole``, as ``make test-all`` runs them. A module is skipped if an optional library that it needs is
missing.
"""

from __future__ import annotations

import contextlib
import os
from collections import Counter
from collections.abc import Callable, Generator, Iterable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")  # pictures need no display
os.environ.setdefault("PYTHONUNBUFFERED", "1")  # output and errors of processes come in the order of their lines

import jackbox_env
from tests.browser import browser  # noqa: F401  # a fixture

# What the extras and make test install beyond the package's dependencies, pytest and Hypothesis.
OPTIONAL = {"flint", "imageio", "jsonschema", "matplotlib", "mpmath", "scipy", "stable_baselines3", "sympy"}
OPTIONAL |= {"PIL", "torch", "tqdm", "tyro"}
INSTALL = "pip install -e '.[all,dev]'"
COMPILING = "jackbox/compiling"  # key in pytest's cache of the processor time [s] of compiling


class Module(pytest.Module):
    """A test module that is skipped where a library of ``OPTIONAL`` is missing, and names it."""

    def collect(self) -> Iterable[pytest.Item | pytest.Collector]:
        """The tests of the module."""
        try:
            return super().collect()
        except self.CollectError as failed:
            cause: BaseException | None = failed
            while cause and not (isinstance(cause, ModuleNotFoundError) and cause.name in OPTIONAL):
                cause = cause.__cause__
            if cause:
                pytest.skip(str(cause), allow_module_level=True)
            raise


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> Module:
    """Use the class above for every test module."""
    return Module.from_parent(parent, path=module_path)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Put the values of a failure into its one line of the summary, which numpy has in later lines."""
    report = yield
    crash: Any = getattr(report.longrepr, "reprcrash", None)
    if crash:
        crash.message = " ".join(crash.message.split())[:500]
    return report


def processor_seconds() -> float:
    """Processor time [s] of this process and of those it started that have ended."""
    return sum(os.times()[:4])


@pytest.hookimpl(trylast=True)
def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print what was skipped and why, then the processor time of a run of several workers: machines differ."""
    os.environ.setdefault("CI", "1")  # the lines of failures that follow are not cut
    reasons = [report.longrepr[2].removeprefix("Skipped: ") for report in terminalreporter.stats.get("skipped", ())]
    counted = Counter(f"{one}: {INSTALL}" if "No module named" in one else one for one in reasons)
    if counted:
        skipped = "; ".join(f"{number} where {reason}" for reason, number in counted.most_common())
        terminalreporter.write_line(f"Skipped: {skipped}")
    seconds, cache = processor_seconds(), getattr(config, "cache", None)
    compiling = cache.get(COMPILING, 0.0) if cache else 0.0
    if config.getoption("numprocesses", None):
        line = f"{seconds:.0f} s of processor time"
        if compiling:
            line += f", {seconds / compiling:.0f} times what compiling the exact model took ({compiling:.1f} s)"
        terminalreporter.write_line(line)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_setupnodes(config: pytest.Config) -> None:
    """Compile the code that is cached on disk, once, before the workers start, and store how long it took."""
    before = processor_seconds()
    jackbox_env.make_simulator(contact="exact").step(0.02)
    envs = gym.make_vec("JackInBox-v0", num_envs=2, vectorization_mode="vector_entry_point", contact="exact")
    envs.reset(seed=0)
    envs.step(np.zeros((2, 1)))
    envs.close()
    env = gym.make("JackInBox-v0", contact="exact")
    env.reset(seed=0)
    env.close()
    jackbox_env.rollout(None, np.zeros(12), np.zeros((2, 3)), 0.02)
    jackbox_env.simulate(duration=0.1)(0.05)
    spent, cache = processor_seconds() - before, getattr(config, "cache", None)
    if cache and spent > 0.5 * cache.get(COMPILING, 6.0):  # else it was on disk
        cache.set(COMPILING, spent)
    with contextlib.suppress(ImportError):  # of the agents' libraries
        from scripts.site.build import ensure_page

        ensure_page()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that have slow tests, so that no worker ends long before the other."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let a run draw every case."""
    parser.addoption("--whole", action="store_true", help="draw all cases of the sweeps, not a quarter")


@pytest.fixture
def cases(request: pytest.FixtureRequest) -> Callable[[int], int]:
    """How many cases of a sweep to draw: all or a quarter."""
    whole = request.config.getoption("--whole")
    return lambda number: number if whole else (number + 3) // 4
