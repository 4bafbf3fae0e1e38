"""Rollouts: many sequences of torques played from many states, by the exact contact model.

Users call ``rollout``. It checks its arguments and calls :func:`run_rollouts`, which ``linearization.py``
and the planner of ``agents/`` call too. That runs ``exact/run.py`` on blocks of rows, on several threads.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Generic, Literal, NamedTuple, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike

from jackbox_env.exact.geometry import outside
from jackbox_env.exact.glide import write_scene_params
from jackbox_env.exact.run import PATIENCE, run
from jackbox_env.exact.score import block_scorer, score_block
from jackbox_env.exact.threads import Ended, Halt, Threads, run_blocks, thread_count
from jackbox_env.exact.workspace import (
    HEIGHT,
    SCENE_PARAMS,
    TIME,
    WIDEST,
    Call,
    Results,
    Rules,
    Scenes,
    Status,
    new_log,
    new_memory,
    states_of,
)
from jackbox_env.jit.compiler import address_of, compiled
from jackbox_env.model.mechanics import energy_of
from jackbox_env.model.scene import Scene, scenes_of
from jackbox_env.model.states import LATEST_TIME, Array, Counts, Flags, as_restored, deepest_restored
from jackbox_env.model.tasks import Task, TaskError, task_of
from jackbox_env.planning import card
from jackbox_env.simulators.agent_functions import CompiledFunctions
from jackbox_env.simulators.base import end_of_step
from jackbox_env.simulators.exact import NO_PIECES, WITH_PIECES, ExactSimulator, cut, drive_kind, failure
from jackbox_env.simulators.plain_functions import Interface
from jackbox_env.simulators.users_functions import compiled_for
from jackbox_env.tools import checks as check

OneOrMore = Scene | Mapping[str, Any] | None | Sequence[Scene | Mapping[str, Any] | None]

_GRAIN = 1000  # steps in a call, at least
FEWEST_PER_THREAD = 5000  # steps for each thread, at least
_ROOM = 256  # impacts in a log at first
_FEWEST, _PARTS = 32, 8  # rows in a block; blocks that threads share out, before a block has more rows


Rewards = TypeVar("Rewards")
Lengths = TypeVar("Lengths")


class Rollout(NamedTuple, Generic[Rewards, Lengths]):
    """Results of :func:`rollout` besides trajectories; None for what was not requested.

    >>> played = rollout(None, np.zeros(12), np.zeros(60), dt=0.02, impacts=True)
    >>> played.impacts.sum().item(), played.impulse.max().round(2).item(), played.energy
    (1, 78.45, None)

    Attributes:
        trajectories: shape (N, H + 1, 12); with ``trajectories=False`` the first and the last states, (N, 2, 12).
        energy: of each state [J], shape (N, H + 1).
        impacts: their number in each step, shape (N, H), int64.
        impulse: the sum of their impulses in each step [N s], shape (N, H).
        rewards: of each step, shape (N, H); 0 after the end of the task's episode.
        lengths: steps of the episode, at most H, shape (N,), int64; returned with the rewards.
    """

    trajectories: Array
    energy: Array | None
    impacts: Counts | None
    impulse: Array | None
    rewards: Rewards
    lengths: Lengths


class CudaRollout(Rollout[Rewards, Lengths]):
    """A rollout of ``device="cuda"``.

    Attributes:
        left_to_cpu: rows that the GPU has left to the CPU, as feet came to rest for example.
    """

    left_to_cpu = 0


@overload
def rollout(
    scene: OneOrMore, states: ArrayLike, torques: ArrayLike, dt: float, time: float = 0.0,
    *, energy: Literal[False] = False, impacts: Literal[False] = False, rewards: None = None, repeat: int = 1,
    trajectories: Literal[True] = True, num_threads: int | None = None, device: str | None = None,
) -> Array: ...  # fmt: skip


@overload
def rollout(
    scene: OneOrMore, states: ArrayLike, torques: ArrayLike, dt: float, time: float = 0.0,
    *, energy: bool = False, impacts: bool = False, rewards: str | Task, repeat: int = 1, trajectories: bool = True,
    num_threads: int | None = None, device: str | None = None,
) -> Rollout[Array, Counts]: ...  # fmt: skip


@overload
def rollout(
    scene: OneOrMore, states: ArrayLike, torques: ArrayLike, dt: float, time: float = 0.0,
    *, energy: bool = False, impacts: bool = False, rewards: str | Task | None = None, repeat: int = 1,
    trajectories: bool = True, num_threads: int | None = None, device: str | None = None,
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
    device: str | None = None,
) -> Array | Rollout[Any, Any]:
    """Simulate sequences of torques from many states by the exact contact model.

    Each torque is constant for ``dt``. The states equal those of ``make_simulator(scene, fidelity="exact")`` bitwise.

    >>> torques = np.zeros((2, 60))  # two sequences of 1.2 s
    >>> played = rollout(None, np.zeros(12), torques, dt=0.02, rewards="juggle", impacts=True)
    >>> played.trajectories.shape, played.impacts.sum(axis=1)
    ((2, 61, 12), array([1, 1]))

    Args:
        scene: a Scene, a dict of some of its fields, or None; or a list of N, one for each row. A drive's side forces
            act, not its torque.
        states: shape (N, 12), or (12,) for all sequences; a foot may be up to 1 m outside.
        torques: on the box [N m], shape (N, H), or (H,) for all states.
        dt: duration of a step [s], > 0.
        time: at which all start [s].
        energy: also return the energy of each state.
        impacts: also return the number of impacts in each step and their impulse.
        rewards: also return the rewards in this task, a name or a :class:`jackbox_env.Task`, and the ``lengths`` of
            the episodes. The states continue after the end of an episode, with rewards of 0.
        repeat: steps that each torque is repeated for, 1 to 1,000,000; H is then the number of all steps.
        trajectories: False: return only the first and the last states, which saves memory and time.
        num_threads: None: as many as the machine has. Results do not depend on it.
        device: "cuda": play on a GPU of NVIDIA, with the same bits; a few rows may be left to the CPU. Tensors of
            PyTorch or another library with DLPack are accepted, and the results then are tensors on the GPU.

    Returns:
        Trajectories, float64, shape (N, H + 1, 12), the first states included; a :class:`Rollout` if anything else is
        requested.

    Raises:
        TypeError, ValueError: unusable values.
        ImportError, RuntimeError, MemoryError: what ``device`` needs is missing, or too small.
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
    tensors = card.tensors(states, torques) if card.checked(device) else ()
    host = [one.cpu().numpy() for one in tensors] or [states, torques]
    starts, rows = sequences(scenes, several, *host)
    options = RolloutOptions(
        energy=energy, impacts=impacts, task=task, repeat=repeat, whole=whole, num_threads=num_threads, device=device,
        tensors=tensors,
    )  # fmt: skip
    played = run_rollouts(scenes, starts, rows, dt, time, options)
    return played.trajectories if whole and not (energy or impacts or task) else played


class Tape:
    """The record of a rollout for its derivatives, which :func:`run_rollouts` fills in."""

    rows: Array  # a wide log of all impacts, step by step
    hits: Counts  # (N, H) impacts of each step
    nonsmooth: Flags  # (N, H) steps without a derivative


class RolloutOptions(NamedTuple):
    """Options of :func:`run_rollouts`: what acts, and which results it adds to the last states."""

    side_forces: bool = True  # whether the drives' side forces act
    drives_turn: bool = False  # whether the drives' torques act, in place of the arguments'
    repeat: int = 1  # steps that each torque is repeated for
    num_threads: int | None = None  # as many at most; None: as many as the machine has
    whole: bool = False  # whether all states are returned
    energy: bool = False  # whether the energies are returned
    impacts: bool = False  # whether impacts and impulses are returned
    task: Task | None = None  # whose rewards are returned
    device: str | None = None  # that plays: None or "cuda"
    tensors: Sequence[Any] = ()  # states and torques on the device; the results then stay there
    numbers: Counts | None = None  # of the rows, in errors


_PLAIN = RolloutOptions()


def run_rollouts(
    scenes: list[Scene], starts: Array, torques: Array, dt: float, time: float | Array = 0.0,
    options: RolloutOptions = _PLAIN, tape: Tape | None = None,
) -> Rollout[Any, Any]:  # fmt: skip
    """:func:`rollout` of checked arguments: float64 rows, and one scene or one for each of them.

    Args:
        scenes: one for all rows, or one for each.
        starts: shape (N, 12).
        torques: [N m], shape (N, H / repeat).
        dt: duration of a step [s].
        time: at which all start [s]; or of each row, shape (N,), if there is a scene for each.
        options: how to play, and what to return.
        tape: to be filled in; needs ``impacts`` and ``whole``.
    """
    task, count, steps = options.task, len(torques), torques.shape[1] * options.repeat
    times = _times(time, dt, steps)
    if options.device:

        def left_rows(rows: Counts) -> Rollout[Any, Any]:
            own = scenes if len(scenes) == 1 else [scenes[row] for row in rows.tolist()]
            alone = options._replace(device=None, tensors=(), numbers=rows)
            return run_rollouts(own, starts[rows], torques[rows], dt, time, alone)

        *fields, left = card.played(scenes, starts, torques, dt, options, left_rows)
        made: CudaRollout[Any, Any] = CudaRollout(*fields)
        made.left_to_cpu = left
        return made
    ranges = count if options.num_threads is not None else min(count, count * steps // FEWEST_PER_THREAD)
    threads = Threads(thread_count(options.num_threads, ranges))
    # Of all numbers of threads, so that they name the same row in errors.
    width = max(1, min(count, WIDEST, max(_FEWEST, count // _PARTS)))
    blocks = np.zeros((2, -(-count // width), HEIGHT, width))
    _put_rows(blocks[0], starts, time)
    played = _scenes_played(scenes, times, dt, options.side_forces, None if options.drives_turn else 0.0, blocks.shape)
    score = compiled_for(task, score_block) if task else None
    results = _new_results(scenes, starts, steps, options, tape is not None)
    address = address_of(score, block_scorer)
    rules = Rules(dt, steps=steps, continue_after_done=True, score=address, patience=PATIENCE)
    controls = np.zeros((0, 0)) if options.drives_turn else np.ascontiguousarray(torques.T)
    calls = [Call(new_memory(width, 0 if tape is None else _ROOM, tape is not None)) for _ in range(threads.count)]
    for call in calls:
        call.set_arguments(played, rules, blocks[0], blocks[1], controls, results)
    loop, halt = compiled(run), Halt()

    # The score is called by its address, also in threads that a second interruption left at work: they keep it alive.
    def work(thread: int, low: int, high: int, _score: Any = score) -> Ended:
        return run_blocks(loop, calls, thread, low, high, halt)

    parts = threads.run(work, len(blocks[0]), grain=-(-_GRAIN // max(1, steps * width)), halt=halt)
    for ended, row, step, *_ in parts:
        if not ended:
            continue
        named = f"states[{row if options.numbers is None else options.numbers[row]}]"
        scene, at = scenes[row if len(scenes) > 1 else 0], float(times[step, row if times.shape[1] > 1 else 0])
        if ended == Status.BAD_REWARD and task is not None:
            simulator = ExactSimulator(scene if options.side_forces else scene.changed(drive=None))
            simulator.reset(blocks[step % 2, row // width, :12, row % width], at)
            functions, torque = CompiledFunctions(scene, Interface(task)), float(torques[row, step // options.repeat])
            try:
                functions.step_and_score(simulator, dt, torque, False)
            except TaskError as error:
                raise TaskError(f"{error}, in step {step} of {named}") from None
        raise failure(ended, scene, at, dt, f"the jack of {named}")
    hits, trajectories = np.ascontiguousarray(results.hits.T), results.trajectories
    if tape is not None:
        log = np.concatenate([new_log(0, True), *(rows for *_, logs in parts for rows in logs)])
        tape.rows, tape.hits, tape.nonsmooth = log[_by_row(hits, width)], hits, results.nonsmooth
    if not options.whole:
        trajectories = np.stack([starts, states_of(blocks[steps % 2], count)], axis=1)
    return Rollout(
        trajectories, results.energies if options.energy else None, hits if options.impacts else None,
        np.ascontiguousarray(results.impulses.T) if options.impacts else None,
        np.ascontiguousarray(results.rewards.T) if task else None, results.lengths if task else None,
    )  # fmt: skip


def _new_results(scenes: list[Scene], starts: Array, steps: int, options: RolloutOptions, taped: bool) -> Results:
    """Arrays for the requested results, with the first states; arrays of length 0 for the others."""
    count, scored = len(starts), options.task is not None
    results = Results(
        terminations=np.zeros(count, np.bool_),
        truncations=np.zeros(count, np.bool_),
        rewards=np.zeros((steps if scored else 0, count)),
        lengths=np.full(count if scored else 0, steps, np.int64),
        trajectories=np.empty((count if options.whole else 0, steps + 1, 12)),
        energies=np.empty((count if options.energy else 0, steps + 1)),
        hits=np.zeros((steps if options.impacts else 0, count), np.int64),
        impulses=np.zeros((steps if options.impacts else 0, count)),
        nonsmooth=np.zeros((count if taped else 0, steps), np.bool_),
    )
    results.trajectories[:, :1] = starts[: len(results.trajectories), None]
    for row in range(count if options.energy and not steps else 0):
        results.energies[row, 0] = energy_of(scenes[row if len(scenes) > 1 else 0].numbers, starts[row])
    return results


def _by_row(hits: Counts, width: int) -> Counts:
    """The order that sorts impacts, recorded block by block and step by step, by row; ``hits`` has shape (N, H)."""
    blocks = -(-len(hits) // width)
    padded = np.zeros((blocks * width, hits.shape[1]), np.int64)
    padded[: len(hits)] = hits
    recorded = padded.reshape(blocks, width, hits.shape[1]).transpose(0, 2, 1)
    row = np.broadcast_to(np.arange(blocks * width).reshape(blocks, 1, width), recorded.shape)
    return np.argsort(np.repeat(row.reshape(-1), recorded.reshape(-1)), kind="stable")


def _put_rows(blocks: Array, starts: Array, time: float | Array) -> None:
    """Write states, shape (N, 12), and their times into blocks, shape (blocks, 16, width)."""
    width = blocks.shape[2]
    number, lane = np.divmod(np.arange(len(starts)), width)
    blocks[number, :12, lane], blocks[number, TIME, lane] = starts, time


def _times(time: float | Array, dt: float, steps: int) -> Array:
    """Times at which each step begins and the last one ends [s], shape (steps + 1, 1 or N): added up one by one."""
    first = np.atleast_1d(np.asarray(time, np.float64))[None]
    times: Array = np.add.accumulate(np.concatenate([first, np.full((steps, first.size), dt)]))
    if (times[1:] == times[:-1]).any() or (times[-1] > LATEST_TIME).any():
        for start in times[:-1].ravel().tolist():
            end_of_step(start, dt)  # raises for one of them
    return times


def _scenes_played(
    scenes: list[Scene], times: Array, dt: float, driven: bool, torque: float | None, shape: tuple[int, ...]
) -> Scenes:
    """The scenes of rows in blocks, shape (2, blocks, 16, width), with their drives cut into pieces.

    A constant ``torque`` replaces that of the drives.
    """
    values = np.array([one.numbers for one in scenes])
    scene_params = np.zeros((shape[1] if len(scenes) > 1 else 1, SCENE_PARAMS, shape[3]))
    compiled(write_scene_params)(values, dt, scene_params, np.arange(len(scenes) if len(scenes) > 1 else shape[3]))
    drives = [one.drive if driven else None for one in scenes]
    kinds = np.array([drive_kind(drive, torque is not None) for drive in drives], np.int64)
    if not any(kind in WITH_PIECES for kind in kinds.tolist()):  # np.isin takes longer than a short rollout
        return Scenes(values, scene_params, kinds, *NO_PIECES)
    starts, steps = np.broadcast_to(times[0], len(scenes)), np.full(len(scenes), len(times) - 1)
    return Scenes(values, scene_params, kinds, *cut(drives, kinds, starts, steps, dt, torque))


def sequences(scenes: list[Scene], several: bool, states: ArrayLike, torques: ArrayLike) -> tuple[Array, Array]:
    """States, shape (N, 12), and torques, shape (N, H), checked against one scene, or ``several``: one for each row."""
    starts, held = _numbers("states", states), _numbers("torques", torques)
    if starts.ndim not in (1, 2) or starts.shape[-1] != 12:
        raise ValueError(f"states must have shape (N, 12) or (12,), got {starts.shape}")
    if held.ndim not in (1, 2):
        raise ValueError(f"torques must have shape (N, H) or (H,), got {held.shape}")
    if starts.ndim == held.ndim == 2 and len(starts) != len(held):
        raise ValueError(f"states must have as many rows as torques, got {len(starts)} and {len(held)}")
    check.finite("torques", held)
    counts = [len(rows) for rows in (starts, held) if rows.ndim == 2] or [len(scenes)]
    count = counts[0]
    if several and len(scenes) != count:
        raise ValueError(f"scene must be one scene or a list of {count}, as many as rows, got {len(scenes)} of them")
    # Read-only arrays and other orders of axes are other types to numba, which would compile anew for each.
    starts = np.array(np.broadcast_to(starts, (count, 12)), order="C")
    # The compiled check only detects a bad state; ``as_restored`` raises with the reason.
    deepest = np.array([deepest_restored(one) for one in scenes])
    if int(compiled(outside)(np.array([one.numbers for one in scenes]), starts, deepest)) >= 0:
        for number, state in enumerate(starts):
            try:
                as_restored(scenes[number if len(scenes) > 1 else 0], state)
            except (TypeError, ValueError) as error:
                raise type(error)(f"states[{number}]: {error}") from error
    return starts, np.array(np.broadcast_to(held, (count, held.shape[-1])), order="C")


def _numbers(name: str, values: ArrayLike) -> Array:
    return check.array(name, values, "be numbers").astype(np.float64, copy=False)  # only read
