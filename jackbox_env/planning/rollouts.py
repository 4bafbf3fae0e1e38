"""Rollouts for planning: many sequences of torques played from many states, by the exact contact model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Generic, Literal, NamedTuple, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jackbox_env import checks as check
from jackbox_env.batches.threads import Halt, Threads, thread_count
from jackbox_env.exact.compiler import address_of, compiled
from jackbox_env.exact.drives import TABLE_WIDTH
from jackbox_env.exact.run import PATIENCE, outside, roll
from jackbox_env.exact.score import score_step
from jackbox_env.exact.workspace import Status, new_log, new_workspaces
from jackbox_env.scene import Drive, Scene, scenes_of
from jackbox_env.scoring import bad_reward, compiled_for
from jackbox_env.simulators.base import end_of_step
from jackbox_env.simulators.exact import ExactSimulator, drive_kind, failure, pieces_for
from jackbox_env.states import LATEST_TIME, Array, as_restored, deepest_restored
from jackbox_env.tasks import Task, task_of

Counts = NDArray[np.int64]
Flags = NDArray[np.bool_]
OneOrMore = Scene | Mapping[str, Any] | None | Sequence[Scene | Mapping[str, Any] | None]

_NO_TABLE: Array = np.zeros((0, TABLE_WIDTH))
_GRAIN = 1000  # steps that are worth a call
FEWEST_PER_THREAD = 5000  # steps that are worth waking a thread
_ROOM = 64  # impacts; it grows


Rewards = TypeVar("Rewards")
Lengths = TypeVar("Lengths")


class Rollout(NamedTuple, Generic[Rewards, Lengths]):
    """What ``rollout`` returns when more than trajectories is asked for; what was not asked for is None.

    Attributes:
        trajectories: shape (N, H + 1, 12); without trajectories the first and the last states, (N, 2, 12).
        energy: of each state [J], shape (N, H + 1).
        impacts: in each step, shape (N, H), int64.
        impulse: their sum in each step [N s], shape (N, H).
        rewards: of each step, shape (N, H); 0 after the step that ends the task's episode.
        lengths: steps up to that one, H where there is none, shape (N,), int64; asked for with the rewards.
    """

    trajectories: Array
    energy: Array | None
    impacts: Counts | None
    impulse: Array | None
    rewards: Rewards
    lengths: Lengths


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
) -> Rollout[Array, Counts]: ...  # fmt: skip


@overload
def rollout(
    scene: OneOrMore, states: ArrayLike, torques: ArrayLike, dt: float, time: float = 0.0,
    *, energy: bool = False, impacts: bool = False, rewards: None = None, repeat: int = 1,
    trajectories: Literal[False], num_threads: int | None = None,
) -> Rollout[None, None]: ...  # fmt: skip


@overload
def rollout(
    scene: OneOrMore, states: ArrayLike, torques: ArrayLike, dt: float, time: float = 0.0,
    *, energy: bool = False, impacts: bool = False, rewards: str | Task | None = None, repeat: int = 1,
    trajectories: bool = True, num_threads: int | None = None,
) -> Array | Rollout[Array | None, Counts | None]: ...  # fmt: skip


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
) -> Array | Rollout[Any, Any]:
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
        rewards: also return what each step earns in this task, a name or a :class:`jackbox_env.Task`. Where the task
            ends an episode, ``lengths`` tells when. Later steps earn 0, and the states go on.
        repeat: steps that each torque is held for, 1 to 1,000,000; H below is then the number of all steps.
        trajectories: False: only the first and the last states are kept, which saves memory and time.
        num_threads: None: as many as the machine has. Results do not depend on it.

    Returns:
        Trajectories, float64, shape (N, H + 1, 12), the first states included; a :class:`Rollout` if anything else is
        asked for.

    Raises:
        TypeError, ValueError: unusable values.
        JackLostError: a jack moves too fast to be followed.
        jackbox_env.TaskError: a reward is NaN or infinite.
    """
    scenes, several = scenes_of(scene)
    energy, impacts, whole = (
        check.flag("energy", energy), check.flag("impacts", impacts), check.flag("trajectories", trajectories)
    )  # fmt: skip
    repeat = check.whole("repeat", repeat, at_least=1, at_most=1_000_000)
    task = None if rewards is None else task_of(rewards, "rewards")
    dt = check.real("dt", dt, above=0.0)
    time = check.real("time", time, at_least=-LATEST_TIME, at_most=LATEST_TIME)
    starts, held = sequences(scenes, several, states, torques)
    played = run_rollouts(
        scenes, starts, held, dt, time, energy=energy, impacts=impacts, task=task, repeat=repeat, whole=whole,
        num_threads=num_threads,
    )  # fmt: skip
    return played.trajectories if whole and not (energy or impacts or task) else played


@dataclass
class Tape:
    """What the derivatives of a rollout need of it besides its states."""

    rows: Array = field(default_factory=lambda: new_log(0, True))  # a wide log of all impacts, step by step
    hits: Counts = field(default_factory=lambda: np.zeros((0, 0), np.int64))  # (N, H) how many of each step
    rough: Flags = field(default_factory=lambda: np.zeros((0, 0), np.bool_))  # (N, H) steps without a derivative


def run_rollouts(
    scenes: list[Scene], starts: Array, held: Array, dt: float, time: float = 0.0, *, driven: bool = True,
    energy: bool = False, impacts: bool = False, task: Task | None = None, repeat: int = 1, whole: bool = False,
    until_impact: bool = False, num_threads: int | None = None, free: bool = False, tape: Tape | None = None,
) -> Rollout[Any, Any]:  # fmt: skip
    """:func:`rollout` of what is checked: float64 rows, and one scene or one for each of them.

    Args:
        scenes: whose drives' side forces act if ``driven``.
        starts: shape (N, 12).
        held: torques [N m], shape (N, H / repeat).
        dt: duration of a step [s].
        time: at which all start [s].
        driven: whether the drives' side forces act.
        energy: whether the energies are asked for.
        impacts: whether impacts and impulses are asked for.
        task: whose rewards are asked for; None: nobody's.
        repeat: steps that each torque is held for.
        whole: whether all states are kept.
        until_impact: end each row with the step of its first impact; needs ``impacts``.
        num_threads: as many at most; None: as many as the machine has.
        free: whether the drives act and ``held`` does not.
        tape: to be filled in; needs ``impacts`` and ``whole``.
    """
    count, steps = len(held), held.shape[1] * repeat
    times = _times(time, dt, steps)
    kinds, firsts, table, ends = _drives(scenes, times, dt, driven, None if free else 0.0)
    played = np.empty((count, steps + 1 if whole else 2, 12))
    played[:, 0] = starts
    earned = np.zeros((0 if task is None else count, steps))
    score = compiled_for(task, score_step) if task else None  # kept alive, because it is called by its address
    hits = np.zeros((count, steps) if impacts else (0, steps), dtype=np.int64)
    impulses, energies = np.zeros(hits.shape), np.zeros((count, steps + 1) if energy else (0, steps + 1))
    ranges = count if num_threads is not None else min(count, count * steps // FEWEST_PER_THREAD)
    threads = Threads(thread_count(num_threads, ranges))
    noted = tape or Tape()
    if tape is not None:
        noted.hits, noted.rough = hits, np.zeros(hits.shape, np.bool_)
    memories = [new_workspaces() for _ in range(threads.count)]
    given, call, address = (np.array([one.numbers for one in scenes]), kinds, firsts), compiled(roll), address_of(score)
    lengths = np.full(count, steps)
    drive, results, halt = (times, table, ends), (played, hits, impulses, energies, earned, lengths), Halt()

    def work(thread: int, low: int, high: int) -> tuple[int, int, int, Array]:
        first, used = 0, np.zeros(1, np.int64)
        log, rows = new_log(0 if tape is None else _ROOM, True), new_log(0 if tape is None else _ROOM, True)
        while True:
            span, memory, kept = (low, high, first), (memories[thread], log), (rows, used, noted.rough)
            ended, who, when = call(
                given, dt, held, drive, span, results, address, until_impact, PATIENCE, memory, kept
            )
            if ended == Status.FULL:
                log, rows = (np.concatenate([one, np.zeros_like(one)]) for one in (log, rows))
            elif ended != Status.PAUSED or halt.asked:
                return ended, who, when, rows[: used[0]]
            low, first = who, when  # after a while, so that an interruption is heard

    done = threads.run(work, count, grain=-(-_GRAIN // max(1, steps)), halt=halt)
    noted.rows = np.concatenate([rows for *_, rows in done])
    for ended, who, when, _ in done:
        if ended == Status.BAD_REWARD and task is not None:
            scene = scenes[who if len(scenes) > 1 else 0]
            simulator = ExactSimulator(scene if driven else scene.changed(drive=None))
            simulator.reset(played[who, when if whole else when % 2], times[when])
            simulator.step(dt, held[who, when // repeat])
            raise bad_reward(task, simulator, f"step {when} of states[{who}]")
        if ended:
            raise failure(ended, scenes[who if len(scenes) > 1 else 0], times[when], dt, f"the jack of states[{who}]")
    if not whole:
        taken = np.full(count, steps)
        if until_impact:
            taken = np.where(hits.any(axis=1), (hits > 0).argmax(axis=1) + 1, steps)
        played = np.stack([starts, played[np.arange(count), taken % 2]], axis=1)
    return Rollout(
        played, energies if energy else None, hits if impacts else None, impulses if impacts else None,
        earned if task else None, lengths if task else None,
    )  # fmt: skip


@cache
def ensure_compiled() -> None:
    """Compile rollouts, or load them: when a search is made, and not behind somebody's progress bar."""
    run_rollouts([Scene()], np.zeros((1, 12)), np.zeros((1, 1)), 0.02)


def _times(time: float, dt: float, steps: int) -> Array:
    """When each step begins and the last one ends [s], shape (steps + 1,): added up one by one."""
    times: Array = np.add.accumulate(np.concatenate([[time], np.full(steps, dt)]))
    if (times[1:] == times[:-1]).any() or times[-1] > LATEST_TIME:
        for start in times[:-1].tolist():
            end_of_step(start, dt)  # refuses one of them
    return times


def _drives(
    scenes: list[Scene], times: Array, dt: float, driven: bool, torque: float | None
) -> tuple[Counts, Counts, Array, Counts]:
    """What turns each scene's box, besides a torque that is held, and the functions' pieces, as ``roll`` takes them."""
    drives = {id(one.drive): one.drive for one in scenes} if driven else {0: None}
    starts = (times[:-1] if len(times) > 1 else times).tolist()
    tables = [_NO_TABLE]
    for drive in drives.values():  # the functions of each are cut into pieces once
        cut = isinstance(drive, Drive)
        tables += [pieces_for(drive, start, dt, torque) for start in starts] if cut else [_NO_TABLE] * len(starts)
    places = {key: number for number, key in enumerate(drives)}
    kinds = np.array([drive_kind(drive, torque is not None) for drive in drives.values()])
    own = np.array([places[id(one.drive) if driven else 0] for one in scenes])
    return kinds[own], own * len(starts), np.concatenate(tables), np.cumsum(list(map(len, tables)))


def sequences(scenes: list[Scene], several: bool, states: ArrayLike, torques: ArrayLike) -> tuple[Array, Array]:
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
    # Views that cannot be written and other orders of the axes are other types to numba, which compiles anew for each.
    starts = np.array(np.broadcast_to(starts, (count, 12)), order="C")
    # The quick check finds that a state is bad, the careful one says why.
    deepest = np.array([deepest_restored(one) for one in scenes])
    if int(compiled(outside)(np.array([one.numbers for one in scenes]), starts, deepest)) >= 0:
        for number, state in enumerate(starts):
            try:
                as_restored(scenes[number if len(scenes) > 1 else 0], state)
            except (TypeError, ValueError) as error:
                raise type(error)(f"states[{number}]: {error}") from error
    return starts, np.array(np.broadcast_to(held, (count, held.shape[-1])), order="C")


def _numbers(name: str, given: ArrayLike) -> Array:
    return check.array(name, given, "hold numbers").astype(np.float64, copy=False)  # only read
