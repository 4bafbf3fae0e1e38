"""What is measured in processes of its own: start-up, import and memory. Each function prints its numbers.

Nothing is imported at the top, so that a process loads what it measures and no more.
"""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any


def run(function: str, *arguments: object, cache: str | None = None) -> list[float]:
    """Call a function of this module in a new process, compiled code kept in ``cache``; return what it prints.

    Raises:
        RuntimeError: it fails.
    """
    environment = {**os.environ, "NUMBA_CACHE_DIR": cache} if cache else None
    root = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    code = f"from scripts import fresh; fresh.{function}{arguments}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, cwd=root)
    if done.returncode:
        raise RuntimeError(f"{function}{arguments} failed in its own process:\n{done.stderr}")
    return [float(number) for number in done.stdout.split()]


def first_step(kind: str) -> None:
    """Make an environment of the exact model, step it once, and print when that was done on the system's clock [s]."""
    import gymnasium as gym

    import jackbox_env  # noqa: F401

    env: Any
    if kind == "one":
        env = gym.make("JackInBox-v0", contact="exact")
    else:
        env = gym.make_vec("JackInBox-v0", 1024, vectorization_mode="vector_entry_point", contact="exact")
    env.reset(seed=0)
    env.step(env.action_space.sample())
    import time

    print(time.monotonic())


def importing(package: str) -> None:
    """Print how long an import takes [s]."""
    import importlib
    import time

    began = time.perf_counter()
    importlib.import_module(package)
    print(time.perf_counter() - began)


def memory(count: int) -> None:
    """Print by how much the process grows per environment [B]: at rest after two steps, and at most on the way."""
    import gc

    import gymnasium as gym
    import numpy as np

    import jackbox_env  # noqa: F401

    def resident(name: str) -> int:
        with open("/proc/self/status") as lines:
            return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(name))

    def stepped(number: int, actions: Any) -> Any:
        env = gym.make_vec("JackInBox-v0", number, vectorization_mode="vector_entry_point", contact="exact")
        env.reset()
        for _ in range(2):
            env.step(actions[:number])
        return env

    actions = np.zeros((count, 1), dtype=np.float32)
    actions[:] = 0.5  # so that its pages are there before
    small = stepped(1024, actions)
    before = resident("VmRSS")
    env = stepped(count, actions)
    gc.collect()
    print((resident("VmRSS") - before) / count, (resident("VmHWM") - before) / count)
    del small, env
