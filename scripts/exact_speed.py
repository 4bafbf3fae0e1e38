"""What ``scripts/speed.py`` times of the exact contact model: its compiled loop alone, batches, rollouts.

All play the same game: episodes of 500 steps from the environment's own starts, a fresh random torque in each step.
Where a batch is too large for whole episodes it starts from a mixture of the moments of such episodes.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from jackbox_env import Scene
from jackbox_env._compiled import compiled, compiled_with
from jackbox_env.batches.rollouts import outside, roll
from jackbox_env.planning import rollout
from jackbox_env.simulators.drives import TABLE_WIDTH
from jackbox_env.simulators.exact import drive_kind
from jackbox_env.simulators.workspace import new_workspace
from jackbox_env.tasks import sample_start
from scripts.naive import next_impact
from scripts.timing import Timed, repeat

Array = NDArray[np.float64]

DT = 0.02  # [s]
EPISODE = 500  # steps
SOME = 50  # steps that a large batch goes on from a mixture of moments
TRAJECTORIES = 1024
_GAMES = 4  # sets of starts and torques drawn beforehand
_STRETCHES = 65536  # of actions drawn beforehand, of which each step takes one
_AT_ONCE = 2**22  # steps of environments in one block, at most, of a large batch
_WRONG = 1e-6  # difference, or depth outside the box [m], that is no rounding


class Kernel:
    """The compiled loop over trajectories: physics alone, no observation, no reward, no memory touched anew."""

    def __init__(self, unguarded: bool = False) -> None:
        """``unguarded``: with Newton's method from the step's end in place of the certified search."""
        scene, rng = Scene(), np.random.default_rng(0)
        self.trajectories = np.zeros((TRAJECTORIES, EPISODE + 1, 12))
        self._games = [
            (
                np.array([sample_start(scene, rng) for _ in range(TRAJECTORIES)]),
                rng.uniform(-scene.torque_limit, scene.torque_limit, (TRAJECTORIES, EPISODE)),
            )
            for _ in range(_GAMES)
        ]
        self._game = 0
        self._numbers, self._drive, self._workspace = np.array(scene.numbers), drive_kind(scene), new_workspace()
        self._play = compiled_with(roll, next_impact=next_impact) if unguarded else compiled(roll)
        self.prepare()
        self.play()

    def prepare(self, game: int | None = None) -> None:
        """Go to the next starts and torques, or to those of this number."""
        self._game = (self._game + 1) % _GAMES if game is None else game
        self.trajectories[:, 0] = self._games[self._game][0]

    def play(self, counted: bool = False) -> NDArray[np.int64]:
        """Play all trajectories; return the impacts in each step, shape (N, H), or (0, H) unless they are counted.

        What follows a step that fails is NaN.
        """
        hits = np.zeros((TRAJECTORIES if counted else 0, EPISODE), dtype=np.int64)
        impulses, energies = np.zeros(hits.shape), np.zeros((0, EPISODE + 1))
        times: Array = DT * np.arange(EPISODE + 1, dtype=np.float64)
        ends = np.zeros(EPISODE + 1, dtype=np.int64)
        table, first = np.zeros((0, TABLE_WIDTH)), 0
        while first < TRAJECTORIES:
            ended, who, when = self._play(
                self._numbers, DT, self._drive, self.trajectories, self._games[self._game][1], times, table, ends,
                first, TRAJECTORIES, 0, hits, impulses, energies, self._workspace,
            )  # fmt: skip
            if not ended:
                break
            self.trajectories[who, when + 1 :] = np.nan
            first = who + 1
        return hits

    def escaped(self) -> NDArray[np.bool_]:
        """Which trajectories have a foot outside the box at the end of a step, or failed."""
        look = compiled(outside)
        return np.array([look(self._numbers, states, _WRONG) >= 0 for states in self.trajectories])

    def mixture(self, rng: np.random.Generator, count: int) -> Array:
        """States at random moments of the trajectories, shape (count, 12), at least ``SOME`` steps before the end."""
        moments = rng.integers(EPISODE - SOME + 1, size=count)
        states: Array = self.trajectories[rng.integers(TRAJECTORIES, size=count), moments]
        return states


def steps_of_kernel(kernel: Kernel, seconds: float) -> Timed:
    """Control steps per second of the compiled loop alone."""

    def block() -> int:
        kernel.play()
        return TRAJECTORIES * EPISODE

    return repeat(block, seconds, kernel.prepare)


class Lost(NamedTuple):
    """How many of ``TRAJECTORIES`` the unguarded search gets wrong."""

    at_first: int  # miss an impact in the first step that has one
    missed: int  # miss an impact in a step before which they are level with the certified ones
    escaped: int  # have a foot outside the box at the end of a step


def lost(certified: Kernel, unguarded: Kernel) -> Lost:
    """Play the same game with both and compare, as long as chaos has not parted them.

    Raises:
        RuntimeError: a certified trajectory leaves the box.
    """
    for kernel in (certified, unguarded):
        kernel.prepare(0)
    hits, found = certified.play(counted=True), unguarded.play(counted=True)
    if certified.escaped().any():
        raise RuntimeError(f"a foot of {certified.escaped().sum()} certified trajectories is outside the box")
    difference = np.abs(certified.trajectories - unguarded.trajectories).max(axis=2)[:, :-1]  # before each step
    level = np.logical_and.accumulate(difference <= _WRONG, axis=1)
    missed = level & (found < hits)
    first = (hits > 0) & (np.cumsum(hits, axis=1) == hits)
    return Lost(int((missed & first).any(axis=1).sum()), int(missed.any(axis=1).sum()), int(unguarded.escaped().sum()))


def drawn(space: gym.Space[Any], count: int) -> Callable[[], NDArray[Any]]:
    """Random actions for ``count`` environments: each call hands out another stretch of one long array.

    So nothing is drawn while time is taken, and yet no environment sees a few actions again and again, whose mean would
    spin its box up.
    """
    many = batch_space(space, count + _STRETCHES)
    many.seed(0)
    pool: NDArray[Any] = many.sample()
    order = itertools.cycle(np.random.default_rng(0).integers(_STRETCHES, size=4099).tolist())

    def action() -> NDArray[Any]:
        first = next(order)
        return pool[first : first + count]

    return action


def steps_of_batch(
    step: Callable[[Any], object],
    space: gym.Space[Any],
    count: int,
    seconds: float,
    steps: int = EPISODE,
    prepare: Callable[[], None] | None = None,
) -> Timed:
    """Environment steps per second of a batch that has been reset, in blocks of ``steps``; ``space``: of one action."""
    action = drawn(space, count)

    def block() -> int:
        for _ in range(steps):
            step(action())
        return steps * count

    return repeat(block, seconds, prepare)


def steps_of_make_vec(env_id: str, count: int, seconds: float, **settings: Any) -> Timed:
    """Environment steps per second of an environment's own vector environment, restarts included."""
    env = gym.make_vec(env_id, num_envs=count, vectorization_mode="vector_entry_point", **settings)
    env.reset(seed=0)
    return steps_of_batch(env.step, env.single_action_space, count, seconds)


def exact_batch(count: int, threads: int = 1) -> Any:
    """A vector environment of the exact model that has been reset."""
    env = gym.make_vec(
        "JackInBox-v0", count, vectorization_mode="vector_entry_point", contact="exact", num_threads=threads
    )
    env.reset()
    return env


def steps_of_mixed(kernel: Kernel, count: int, threads: int, seconds: float) -> Timed:
    """Environment steps per second of a batch of any size, from a mixture of an episode's moments."""
    env, rng = exact_batch(count, threads), np.random.default_rng(0)
    everyone, times = np.ones(count, dtype=np.bool_), np.zeros(count)

    def prepare() -> None:
        env.unwrapped._place(everyone, kernel.mixture(rng, count), times, anew=True)

    steps = max(5, min(SOME, _AT_ONCE // count))
    return steps_of_batch(env.step, env.single_action_space, count, seconds, steps, prepare)


def steps_of_rollout(kernel: Kernel, count: int, steps: int, threads: int, seconds: float) -> Timed:
    """Control steps per second of ``jackbox_env.rollout``, from a mixture of an episode's moments."""
    scene, rng = Scene(), np.random.default_rng(0)
    torques = [rng.uniform(-scene.torque_limit, scene.torque_limit, (count, steps)) for _ in range(_GAMES)]
    turns = itertools.cycle(torques)
    states = np.zeros((count, 12))

    def prepare() -> None:
        states[:] = kernel.mixture(rng, count)

    def block() -> int:
        rollout(scene, states, next(turns), DT, num_threads=threads)
        return count * steps

    return repeat(block, seconds, prepare)


def bytes_held(count: int = 1024) -> float:
    """Bytes per environment in the arrays that a batch holds."""
    env = exact_batch(count)
    env.step(env.action_space.sample())
    return float(env.unwrapped._batch.nbytes / count)
