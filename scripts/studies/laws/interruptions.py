"""Interrupt steps and rollouts by a timer at random moments, and compare what follows with twins never interrupted."""

from __future__ import annotations

import faulthandler
import os
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from jackbox_env import JackInBoxVectorEnv, rollout
from jackbox_env import _validation as check
from jackbox_env.commands.common import command_line

Array = NDArray[np.float64]
Kind = Literal["steps", "sb3", "rollouts"]

_HANGS = 120.0  # [s] after which a call that does not return is a hang
_EPISODE = 40  # steps
_WARM = 20  # calls timed to learn how long one takes
_TASKS = Path("/proc/self/task")


@dataclass(frozen=True)
class Arguments:
    """Interrupt steps and rollouts at random moments."""

    interrupts: int = 10_000
    """How many, for each kind of call and each number of threads."""
    environments: int = 8000
    """Environments in the vector environment, an eighth of them for sb3, and trajectories of a rollout."""
    threads: tuple[int, ...] = (2, 8)
    """Numbers of threads."""
    kinds: tuple[Kind, ...] = ("steps", "sb3", "rollouts")
    """Calls: the vector environment's step, Stable-Baselines3's, rollout."""
    seed: int = 0
    """Of actions and moments."""
    progress: bool = True
    """Show a progress bar."""


class Timer:
    """Interrupts a call after a random time. Half of the calls are interrupted again and again until they end."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.calls = self.strikes = 0  # calls interrupted, and how often
        self._rng, self._again, self._striking = rng, 0.0, False
        signal.signal(signal.SIGALRM, self._strike)

    def call(self, call: Callable[[], Any], typical: float) -> tuple[Any, bool]:
        """Return the call's result, or None, and whether it was interrupted; uninterrupted it takes ``typical`` [s]."""
        first = self._rng.uniform(1e-6, 1.2 * typical)
        self._again = 10.0 ** self._rng.uniform(-6.0, -3.0) if self._rng.uniform() < 0.5 else 0.0
        try:
            signal.setitimer(signal.ITIMER_REAL, first)
            return _exposed(call), False
        except KeyboardInterrupt:
            self.calls += 1
            return None, True
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)

    def _strike(self, _: int, frame: FrameType | None) -> None:
        if self._striking:  # a signal arrived while this method was running
            return
        self._striking = True
        while frame is not None and frame.f_code is not _exposed.__code__:
            frame = frame.f_back
        if frame is not None:  # else the call has not begun yet, or has ended
            self.strikes += 1
            if self._again:
                signal.setitimer(signal.ITIMER_REAL, self._again)
        self._striking = False
        if frame is not None:
            raise KeyboardInterrupt


def _exposed(call: Callable[[], Any]) -> Any:
    return call()


# -- what is interrupted ----------------------------------------------------------------------------------------------


class Steps:
    """Steps of a vector environment and of its twin of one thread."""

    def __init__(self, count: int, threads: int) -> None:
        self.made, self.twin = (self.make(count, number) for number in (threads, 1))
        starts = np.random.default_rng(0).integers(_EPISODE, size=self.vector(self.made).num_envs)
        for env in (self.made, self.twin):
            self.begin(env)
        for step in range(_EPISODE):  # episodes end at different times
            for env in (self.made, self.twin):
                vector = self.vector(env)
                vector.step(np.zeros(vector.num_envs))
                if (starts == step).any():
                    vector.reset(options={"reset_mask": starts == step})

    def make(self, count: int, threads: int) -> Any:
        """An environment."""
        return JackInBoxVectorEnv(
            count, contact="exact", num_threads=threads, max_episode_steps=_EPISODE, with_infos=True
        )

    def begin(self, env: Any) -> None:
        """Start it."""
        env.reset(seed=0)

    def vector(self, env: Any) -> JackInBoxVectorEnv:
        """The vector environment itself."""
        return env  # type: ignore[no-any-return]

    def step(self, env: Any, rng: np.random.Generator) -> Callable[[], Any]:
        """A call that makes a step under random actions."""
        actions = rng.uniform(-1.0, 1.0, (self.vector(env).num_envs, 1))
        return lambda: env.step(actions)

    def told(self, env: Any) -> list[Any]:
        """All that the environments are at present."""
        vector = self.vector(env)
        return [vector.states, vector.times, vector.observations]

    def trial(self, timer: Timer, typical: float, seed: int) -> str:
        """Interrupt a step, make the next one undisturbed, and return in one word what happened."""
        made, twin = (self.step(env, np.random.default_rng(seed)) for env in (self.made, self.twin))
        before = self.told(self.made)
        found, struck = timer.call(made, typical)
        after = self.told(self.made)
        if struck and same(after, before):
            happened = "before"
            found = made()
        else:
            happened = "after" if struck else "missed"
        expected = twin()
        right = (found is None or same(found, expected)) and same(self.told(self.made), self.told(self.twin))
        made, twin = (self.step(env, np.random.default_rng(seed + 1)) for env in (self.made, self.twin))
        right = right and same(made(), twin()) and same(self.told(self.made), self.told(self.twin))
        return happened if right else "wrong"

    def typical(self) -> float:
        """Time of an uninterrupted step [s]; the twin makes the same steps."""
        steps = [[self.step(env, np.random.default_rng(k)) for k in range(_WARM)] for env in (self.twin, self.made)]
        for step in steps[0]:
            step()
        return _seconds(steps[1])


class Sb3Steps(Steps):
    """Steps for Stable-Baselines3, with the statistics of episodes."""

    def make(self, count: int, threads: int) -> Any:
        """An environment."""
        from jackbox_env.sb3 import make_sb3_vec_env

        return make_sb3_vec_env(-(-count // 8), contact="exact", num_threads=threads, max_episode_steps=_EPISODE)

    def begin(self, env: Any) -> None:
        """Start it."""
        env.seed(0)
        env.reset()

    def vector(self, env: Any) -> JackInBoxVectorEnv:
        """The vector environment itself."""
        return env.vector_env  # type: ignore[no-any-return]

    def told(self, env: Any) -> list[Any]:
        """All that the environments are at present."""
        return [*super().told(env), env.reset_infos]


class Rollouts:
    """Rollouts, whose twin has one thread."""

    def __init__(self, count: int, threads: int) -> None:
        self._states, self._torques = np.zeros((count, 12)), np.random.default_rng(0).uniform(-9e4, 9e4, (count, 30))
        self._states[:, 9] = np.linspace(-9.0, 9.0, count)
        self._threads = threads
        self._expected = self.play(1)

    def play(self, threads: int) -> Array:
        """All trajectories."""
        played: Array = rollout(None, self._states, self._torques, 0.02, num_threads=threads)
        return played

    def trial(self, timer: Timer, typical: float, seed: int) -> str:
        """Interrupt a rollout, make the next one undisturbed, and return in one word what happened."""
        found, struck = timer.call(lambda: self.play(self._threads), typical)
        right = struck or same(found, self._expected)
        right = right and same(self.play(self._threads), self._expected)
        return "wrong" if not right else "before" if struck else "missed"

    def typical(self) -> float:
        """Time of an uninterrupted rollout [s]."""
        return _seconds([lambda: self.play(self._threads)] * _WARM)


def _seconds(calls: Sequence[Callable[[], Any]]) -> float:
    """Median time of the calls [s]."""
    clock = [time.perf_counter()]
    for call in calls:
        call()
        clock.append(time.perf_counter())
    return float(np.median(np.diff(clock)))


def same(found: Any, expected: Any) -> bool:
    """Whether two answers agree in every bit; an episode's time on the clock is not compared."""
    if isinstance(expected, dict):
        names = [name for name in expected if name != "t"]
        return set(found) == set(expected) and all(same(found[name], expected[name]) for name in names)
    if isinstance(expected, list | tuple) or (isinstance(expected, np.ndarray) and expected.dtype == object):
        return len(found) == len(expected) and all(map(same, found, expected))
    if isinstance(expected, np.ndarray):
        return bool(found.dtype == expected.dtype and found.tobytes() == expected.tobytes())
    return bool(found == expected)


# -- the command ------------------------------------------------------------------------------------------------------

KINDS: dict[str, Callable[[int, int], Any]] = {"steps": Steps, "sb3": Sb3Steps, "rollouts": Rollouts}


def torment(kind: str, count: int, threads: int, interrupts: int, seed: int, progress: bool = True) -> Counter[str]:
    """Interrupt ``interrupts`` calls of a kind; return how often each outcome happened."""
    rng = np.random.default_rng(seed)
    timer, given = Timer(rng), KINDS[kind](count, threads)
    typical = given.typical()
    happened: Counter[str] = Counter()
    armed = 0.0
    with tqdm(total=interrupts, unit=" interrupts", disable=not progress, leave=False) as bar:
        while timer.calls < interrupts:
            if time.monotonic() > armed + 1.0:
                faulthandler.dump_traceback_later(_HANGS, exit=True)  # a hang ends the process with a traceback
                armed = time.monotonic()
            happened[given.trial(timer, typical, int(rng.integers(2**32)))] += 1
            bar.update(timer.calls - bar.n)
    faulthandler.cancel_dump_traceback_later()
    happened["strikes"] = timer.strikes
    return happened


def threads_left(expected: int) -> int:
    """Threads of this process beyond those expected, after up to 5 s to end in; 0 if the system does not say."""
    latest = time.monotonic() + 5.0
    while _TASKS.exists():
        left = len(os.listdir(_TASKS)) - expected
        if left <= 0 or time.monotonic() > latest:
            return max(0, left)
        time.sleep(0.01)
    return 0


def _runs(arguments: Arguments) -> Iterator[tuple[str, int, Counter[str]]]:
    for kind in arguments.kinds:
        for threads in arguments.threads:
            given = kind, arguments.environments, threads, arguments.interrupts, arguments.seed, arguments.progress
            yield kind, threads, torment(*given)


@command_line
def main() -> None:
    """Parse, interrupt, say what happened."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__)
    for name in ("interrupts", "environments"):
        check.whole(name, getattr(arguments, name), at_least=1, at_most=10**9)
    tqdm.monitor_interval = 0  # without a thread of its own: threads are counted
    for needed in arguments.kinds:
        KINDS[needed](1, 1)  # imported libraries start their threads now
    bad, before = 0, len(os.listdir(_TASKS)) if _TASKS.exists() else 0
    for name, threads, happened in _runs(arguments):
        left = threads_left(before)
        bad += happened["wrong"] + left
        print(
            f"{name}, {threads} threads: interrupted before the call was done {happened['before']:,}, after "
            f"{happened['after']:,}, {happened['strikes']:,} times in all, missed {happened['missed']:,}; "
            f"wrong {happened['wrong']:,}, threads left {left}"
        )
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    main()
