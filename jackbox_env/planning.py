"""Rollouts for planning: many sequences of torques played from many states, by the exact contact model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jackbox_env import _validation as check
from jackbox_env.batches.threads import Halt, Threads, thread_count
from jackbox_env.compiled.compiler import compiled
from jackbox_env.compiled.rollouts import outside, roll
from jackbox_env.compiled.status import Status
from jackbox_env.compiled.workspace import new_workspace
from jackbox_env.scene import Scene
from jackbox_env.simulators.base import end_of_step
from jackbox_env.simulators.exact import drive_kind, failure, pieces_for
from jackbox_env.states import LATEST_TIME, Array, as_held, deepest_held

_GRAIN = 1000  # steps that are worth a call
_FEWEST_PER_THREAD = 5000  # steps that are worth waking a thread


class Rollout(NamedTuple):
    """What ``rollout`` returns when more than trajectories is asked for; what was not asked for is None."""

    trajectories: Array  # (N, H + 1, 12)
    energy: Array | None  # (N, H + 1) [J]
    impacts: NDArray[np.int64] | None  # (N, H) impacts in each step
    impulse: Array | None  # (N, H) sum of their impulses [N s]


@overload
def rollout(
    scene: Scene | Mapping[str, Any] | None, states: ArrayLike, torques: ArrayLike, dt: float, time: float = 0.0,
    *, energy: Literal[False] = False, impacts: Literal[False] = False, num_threads: int | None = None,
) -> Array: ...  # fmt: skip


@overload
def rollout(
    scene: Scene | Mapping[str, Any] | None, states: ArrayLike, torques: ArrayLike, dt: float, time: float = 0.0,
    *, energy: bool = False, impacts: bool = False, num_threads: int | None = None,
) -> Array | Rollout: ...  # fmt: skip


def rollout(
    scene: Scene | Mapping[str, Any] | None,
    states: ArrayLike,
    torques: ArrayLike,
    dt: float,
    time: float = 0.0,
    *,
    energy: bool = False,
    impacts: bool = False,
    num_threads: int | None = None,
) -> Array | Rollout:
    """Play torques, each held for ``dt``, from each state, by ``contact="exact"``.

    Equal bit for bit to stepping ``make_simulator(scene, contact="exact")`` from each state.

    Args:
        scene: a Scene, a dict of some of its fields, or None. Its drive's side forces act, not its torque.
        states: shape (N, 12), or (12,) for all sequences; a foot may be up to 1 m outside.
        torques: on the box [N m], shape (N, H), or (H,) for all states.
        dt: duration of a step [s], > 0.
        time: at which all start [s].
        energy: also return the energy of each state.
        impacts: also return the number of impacts in each step and their impulse.
        num_threads: None: as many as the machine has. Results do not depend on it.

    Returns:
        Trajectories, float64, shape (N, H + 1, 12), the first states included; a :class:`Rollout` if more is asked for.

    Raises:
        TypeError, ValueError: unusable values.
        JackLostError: a jack moves too fast to be followed.
    """
    scene = Scene.of(scene)
    energy, impacts = check.flag("energy", energy), check.flag("impacts", impacts)
    dt = check.real("dt", dt, above=0.0)
    time = check.real("time", time, at_least=-LATEST_TIME, at_most=LATEST_TIME)
    starts, held = _sequences(scene, states, torques)
    count, steps = held.shape
    times = [time]
    for _ in range(steps):
        times.append(end_of_step(times[-1], dt))
    tables = [pieces_for(scene, start, dt, 0.0) for start in times[:-1]] or [pieces_for(scene, time, dt, 0.0)]
    table, ends = np.concatenate(tables), np.cumsum([0, *map(len, tables)])
    trajectories = np.empty((count, steps + 1, 12))
    trajectories[:, 0] = starts
    hits = np.zeros((count, steps) if impacts else (0, steps), dtype=np.int64)
    impulses, energies = np.zeros(hits.shape), np.zeros((count, steps + 1) if energy else (0, steps + 1))
    ranges = count if num_threads is not None else min(count, count * steps // _FEWEST_PER_THREAD)
    threads = Threads(thread_count(num_threads, ranges))
    workspaces = [new_workspace() for _ in range(threads.count)]
    numbers, kind, play = np.array(scene.numbers), drive_kind(scene, held=True), compiled(roll)
    drive, results = (np.array(times), table, ends), (trajectories, hits, impulses, energies)
    halt = Halt()

    def work(thread: int, low: int, high: int) -> tuple[int, int, int]:
        first = 0
        while True:
            ended, who, when = play(numbers, dt, kind, held, drive, (low, high, first), results, workspaces[thread])
            if ended != Status.PAUSED or halt.asked:
                return ended, who, when
            low, first = who, when  # after a while, so that an interruption is heard

    for ended, who, when in threads.run(work, count, grain=-(-_GRAIN // max(1, steps)), halt=halt):
        if ended:
            raise failure(ended, scene, times[when], dt, f"the jack of states[{who}]")
    if not (energy or impacts):
        return trajectories
    return Rollout(trajectories, energies if energy else None, hits if impacts else None, impulses if impacts else None)


def _sequences(scene: Scene, states: ArrayLike, torques: ArrayLike) -> tuple[Array, Array]:
    """States, shape (N, 12), and torques, shape (N, H), checked."""
    starts, held = _numbers("states", states), _numbers("torques", torques)
    if starts.ndim not in (1, 2) or starts.shape[-1] != 12:
        raise ValueError(f"states must have shape (N, 12) or (12,), got {starts.shape}")
    if held.ndim not in (1, 2):
        raise ValueError(f"torques must have shape (N, H) or (H,), got {held.shape}")
    if starts.ndim == held.ndim == 2 and len(starts) != len(held):
        raise ValueError(f"states and torques must be as many, got {len(starts)} and {len(held)}")
    if not np.isfinite(held).all():
        raise ValueError(f"torques must be finite, got {held[~np.isfinite(held)][0]}")
    count = len(starts) if starts.ndim == 2 else len(held) if held.ndim == 2 else 1
    starts = np.ascontiguousarray(np.broadcast_to(starts, (count, 12)))
    # The quick check finds that a state is bad, the careful one says why.
    if int(compiled(outside)(np.array(scene.numbers), starts, deepest_held(scene))) >= 0:
        for number, state in enumerate(starts):
            try:
                as_held(scene, state)
            except (TypeError, ValueError) as error:
                raise type(error)(f"states[{number}]: {error}") from error
    return starts, np.ascontiguousarray(np.broadcast_to(held, (count, held.shape[-1])))


def _numbers(name: str, given: ArrayLike) -> Array:
    return check.array(name, given, "hold numbers").astype(np.float64, copy=False)  # only read
