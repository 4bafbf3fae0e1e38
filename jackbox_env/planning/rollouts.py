"""Rollouts for planning: many sequences of torques played from many states, by the exact contact model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jackbox_env import _validation as check
from jackbox_env.batches.threads import Halt, Threads, thread_count
from jackbox_env.compiled.address import address_of
from jackbox_env.compiled.compiler import compiled
from jackbox_env.compiled.rollouts import outside, roll
from jackbox_env.compiled.score import score_step
from jackbox_env.compiled.status import Status
from jackbox_env.compiled.workspace import new_workspace
from jackbox_env.scene import Scene, scenes_of
from jackbox_env.scoring import compiled_for
from jackbox_env.simulators.base import end_of_step
from jackbox_env.simulators.exact import drive_kind, failure, pieces_for
from jackbox_env.states import LATEST_TIME, Array, as_held, deepest_held
from jackbox_env.tasks import Task, task_of

OneOrMore = Scene | Mapping[str, Any] | None | Sequence[Scene | Mapping[str, Any] | None]

_GRAIN = 1000  # steps that are worth a call
_FEWEST_PER_THREAD = 5000  # steps that are worth waking a thread


class Rollout(NamedTuple):
    """What ``rollout`` returns when more than trajectories is asked for; what was not asked for is None."""

    trajectories: Array  # (N, H + 1, 12); without trajectories the first and the last states, (N, 2, 12)
    energy: Array | None  # (N, H + 1) [J]
    impacts: NDArray[np.int64] | None  # (N, H) impacts in each step
    impulse: Array | None  # (N, H) sum of their impulses [N s]
    rewards: Array | None = None  # (N, H)


@overload
def rollout(
    scene: OneOrMore, states: ArrayLike, torques: ArrayLike, dt: float, time: float = 0.0,
    *, energy: Literal[False] = False, impacts: Literal[False] = False, rewards: None = None, repeat: int = 1,
    trajectories: Literal[True] = True, num_threads: int | None = None,
) -> Array: ...  # fmt: skip


@overload
def rollout(
    scene: OneOrMore, states: ArrayLike, torques: ArrayLike, dt: float, time: float = 0.0,
    *, energy: bool = False, impacts: bool = False, rewards: str | Task, repeat: int = 1, trajectories: bool = True,
    num_threads: int | None = None,
) -> Rollout: ...  # fmt: skip


@overload
def rollout(
    scene: OneOrMore, states: ArrayLike, torques: ArrayLike, dt: float, time: float = 0.0,
    *, energy: bool = False, impacts: bool = False, rewards: str | Task | None = None, repeat: int = 1,
    trajectories: Literal[False], num_threads: int | None = None,
) -> Rollout: ...  # fmt: skip


@overload
def rollout(
    scene: OneOrMore, states: ArrayLike, torques: ArrayLike, dt: float, time: float = 0.0,
    *, energy: bool = False, impacts: bool = False, rewards: str | Task | None = None, repeat: int = 1,
    trajectories: bool = True, num_threads: int | None = None,
) -> Array | Rollout: ...  # fmt: skip


def rollout(
    scene: OneOrMore,
    states: ArrayLike,
    torques: ArrayLike,
    dt: float,
    time: float = 0.0,
    *,
    energy: bool = False,
    impacts: bool = False,
    rewards: str | Task | None = None,
    repeat: int = 1,
    trajectories: bool = True,
    num_threads: int | None = None,
) -> Array | Rollout:
    """Play torques, each held for ``dt``, from each state, by ``contact="exact"``.

    Equal bit for bit to stepping ``make_simulator(scene, contact="exact")`` from each state.

    Args:
        scene: a Scene, a dict of some of its fields, or None; or a list of N, one for each row. A drive's side forces
            act, not its torque.
        states: shape (N, 12), or (12,) for all sequences; a foot may be up to 1 m outside.
        torques: on the box [N m], shape (N, H), or (H,) for all states.
        dt: duration of a step [s], > 0.
        time: at which all start [s].
        energy: also return the energy of each state.
        impacts: also return the number of impacts in each step and their impulse.
        rewards: also return what each step earns in this task, a name or a :class:`jackbox_env.Task`.
        repeat: steps that each torque is held for, 1 to 1,000,000; H below is then the number of all steps.
        trajectories: False: only the first and the last states are kept, which saves memory and time.
        num_threads: None: as many as the machine has. Results do not depend on it.

    Returns:
        Trajectories, float64, shape (N, H + 1, 12), the first states included; a :class:`Rollout` if anything else is
        asked for.

    Raises:
        TypeError, ValueError: unusable values.
        JackLostError: a jack moves too fast to be followed.
    """
    scenes, several = scenes_of(scene)
    energy, impacts, whole = (
        check.flag("energy", energy), check.flag("impacts", impacts), check.flag("trajectories", trajectories)
    )  # fmt: skip
    repeat = check.whole("repeat", repeat, at_least=1, at_most=1_000_000)
    task = None if rewards is None else task_of(rewards, "rewards")
    dt = check.real("dt", dt, above=0.0)
    time = check.real("time", time, at_least=-LATEST_TIME, at_most=LATEST_TIME)
    starts, held = _sequences(scenes, several, states, torques)
    count, steps = len(held), held.shape[1] * repeat
    times = [time]
    for _ in range(steps):
        times.append(end_of_step(times[-1], dt))
    drives = {id(one.drive): one.drive for one in scenes}  # the functions of each are cut into pieces once
    starting = times[:-1] or [time]
    tables = [pieces_for(drive, start, dt, 0.0) for drive in drives.values() for start in starting]
    table, ends = np.concatenate(tables), np.cumsum([0, *map(len, tables)])
    firsts = np.array([list(drives).index(id(one.drive)) * len(starting) for one in scenes])
    played = np.empty((count, steps + 1 if whole else 2, 12))
    played[:, 0] = starts
    earned = np.zeros((0 if task is None else count, steps))
    score = compiled_for(task, score_step) if task else None  # kept alive, because it is called by its address
    hits = np.zeros((count, steps) if impacts else (0, steps), dtype=np.int64)
    impulses, energies = np.zeros(hits.shape), np.zeros((count, steps + 1) if energy else (0, steps + 1))
    ranges = count if num_threads is not None else min(count, count * steps // _FEWEST_PER_THREAD)
    threads = Threads(thread_count(num_threads, ranges))
    workspaces = [new_workspace() for _ in range(threads.count)]
    values, kinds = np.array([one.numbers for one in scenes]), [drive_kind(one.drive, held=True) for one in scenes]
    given, play, address = (values, np.array(kinds), firsts), compiled(roll), address_of(score)
    drive, results = (np.array(times), table, ends), (played, hits, impulses, energies, earned)
    halt = Halt()

    def work(thread: int, low: int, high: int) -> tuple[int, int, int]:
        first = 0
        while True:
            ended, who, when = play(given, dt, held, drive, (low, high, first), results, address, workspaces[thread])
            if ended != Status.PAUSED or halt.asked:
                return ended, who, when
            low, first = who, when  # after a while, so that an interruption is heard

    for ended, who, when in threads.run(work, count, grain=-(-_GRAIN // max(1, steps)), halt=halt):
        if ended:
            raise failure(ended, scenes[who if len(scenes) > 1 else 0], times[when], dt, f"the jack of states[{who}]")
    if not whole:
        played = np.stack([starts, played[:, steps % 2]], axis=1)
    if whole and not (energy or impacts or task):
        return played
    return Rollout(
        played, energies if energy else None, hits if impacts else None, impulses if impacts else None,
        earned if task else None,
    )  # fmt: skip


def _sequences(scenes: list[Scene], several: bool, states: ArrayLike, torques: ArrayLike) -> tuple[Array, Array]:
    """States, shape (N, 12), and torques, shape (N, H), checked against one scene, or ``several``: one for each row."""
    starts, held = _numbers("states", states), _numbers("torques", torques)
    if starts.ndim not in (1, 2) or starts.shape[-1] != 12:
        raise ValueError(f"states must have shape (N, 12) or (12,), got {starts.shape}")
    if held.ndim not in (1, 2):
        raise ValueError(f"torques must have shape (N, H) or (H,), got {held.shape}")
    if starts.ndim == held.ndim == 2 and len(starts) != len(held):
        raise ValueError(f"states and torques must be as many, got {len(starts)} and {len(held)}")
    if not np.isfinite(held).all():
        raise ValueError(f"torques must be finite, got {held[~np.isfinite(held)][0]}")
    counts = [len(rows) for rows in (starts, held) if rows.ndim == 2] or ([len(scenes)] if several else [1])
    count = counts[0]
    if several and len(scenes) != count:
        raise ValueError(f"scene must be one scene or a list of {count}, as many as rows, got {len(scenes)} of them")
    starts = np.ascontiguousarray(np.broadcast_to(starts, (count, 12)))
    # The quick check finds that a state is bad, the careful one says why.
    deepest = np.array([deepest_held(one) for one in scenes])
    if int(compiled(outside)(np.array([one.numbers for one in scenes]), starts, deepest)) >= 0:
        for number, state in enumerate(starts):
            try:
                as_held(scenes[number if len(scenes) > 1 else 0], state)
            except (TypeError, ValueError) as error:
                raise type(error)(f"states[{number}]: {error}") from error
    return starts, np.ascontiguousarray(np.broadcast_to(held, (count, held.shape[-1])))


def _numbers(name: str, given: ArrayLike) -> Array:
    return check.array(name, given, "hold numbers").astype(np.float64, copy=False)  # only read
