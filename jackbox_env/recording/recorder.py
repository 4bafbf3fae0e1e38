"""Records of simulations: step by step by the exact contact model or any other, to the end, an event or a failure."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from jackbox_env.exact.motion import leave_frames
from jackbox_env.exact.run import PATIENCE, run
from jackbox_env.exact.threads import Halt, run_blocks
from jackbox_env.exact.workspace import (
    AFTER,
    BEFORE,
    HEIGHT,
    HELD_SO_FAR,
    JUMPS,
    SCENE_PARAMS,
    SCRATCH,
    TIME,
    Call,
    Results,
    Rules,
    Scenes,
    ThreadMemory,
    new_workspaces,
)  # fmt: skip
from jackbox_env.jit.compiler import compiled
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import Array
from jackbox_env.recording.events import Event
from jackbox_env.recording.record import IMPACT, JUMP, Record, slack_of
from jackbox_env.simulators import JackLostError, Simulator, StepResult
from jackbox_env.simulators.exact import (
    NO_PIECES,
    WITH_PIECES,
    drive_kind,
    ensure_compiled,
    failure,
    joined,
    pieces_for,
)
from jackbox_env.simulators.plain_functions import ControlStep
from jackbox_env.tools.command_line import bar

MOST_STEPS = 10_000_000  # some 2 GB
_ROOM = 1024  # impacts in a log at first
_CHUNK = 64  # steps between two searches for an event at first, then twice as many each time

# Simulates from a state and a time [s] in steps of dt [s], by their number, under constant torques or the drive (None).
Advance = Callable[[Array, float, float, int, Array | None], Record]

Controller = Callable[[float, Array], float]  # from time [s] and state at a step's start to its torque [N m]


def exact_advance(scene: Scene) -> Advance:
    """Simulation by the exact contact model; an error in a step ends it before, as the record's failure."""
    ensure_compiled(not scene.elastic)
    return partial(_exact_record, scene)


def _exact_record(scene: Scene, state: Array, time: float, dt: float, steps: int, torques: Array | None) -> Record:
    times: Array = np.add.accumulate(np.concatenate([[time], np.full(steps, dt)]))
    held, pieces, error = torques is not None, NO_PIECES, None
    kind = np.array([drive_kind(scene.drive, held)])
    if kind[0] in WITH_PIECES:
        tables, error = _tables(scene, times[:-1].tolist(), dt, held)
        pieces, steps = joined(tables, np.zeros(1, np.int64)), len(tables)
    blocks = np.zeros((2, 1, HEIGHT, 1))
    blocks[0, 0, :12, 0], blocks[0, 0, TIME] = state, time
    states, values = np.empty((1, steps + 1, 12)), np.array([scene.numbers])
    states[0, 0] = state
    results = Results(
        terminations=np.zeros(1, np.bool_), truncations=np.zeros(1, np.bool_), trajectories=states,
        hits=np.zeros((steps, 1), np.int64), impulses=np.zeros((steps, 1)),
    )  # fmt: skip
    calls = [Call(ThreadMemory(np.zeros((SCRATCH, 1)), new_workspaces(), np.zeros((_ROOM, JUMPS))))]
    calls[0].set_arguments(
        Scenes(values, np.zeros((1, SCENE_PARAMS, 1)), kind, *pieces),
        Rules(dt, steps=steps, continue_after_done=True, patience=PATIENCE),
        blocks[0], blocks[1], np.zeros((0, 0)) if torques is None else np.array(torques[:steps])[:, None], results,
    )  # fmt: skip
    ended, _, step, _, logs = run_blocks(compiled(run), calls, 0, 0, 1, Halt())
    done = step if ended else steps
    error = failure(ended, scene, float(times[step]), dt) if ended else error
    rows, in_step = np.concatenate([np.zeros((0, JUMPS)), *logs]), np.repeat(np.arange(steps), results.hits[:, 0])
    workspaces = new_workspaces()
    compiled(leave_frames)(values[0], dt, kind[0], states[0, in_step], rows, workspaces)
    impacts = np.empty(len(rows), JUMP)
    impacts["time"] = np.minimum(times[in_step] + rows[:, 0], times[in_step + 1])
    impacts["wall"], impacts["foot"], impacts["impulse"] = rows[:, 1], rows[:, 2], rows[:, 3]
    impacts["before"], impacts["after"] = rows[:, BEFORE : BEFORE + 12], rows[:, AFTER : AFTER + 12]
    counts = rows[:, HELD_SO_FAR].astype(np.int64)
    impacts["resting"] = counts < 0
    impacts["before"][counts < 0] = impacts["after"][counts < 0] = states[0, in_step[counts < 0] + 1]
    return Record(
        scene, dt, 0.0, times[: done + 1], states[0, : done + 1], torques, impacts, in_step, counts, error
    )  # fmt: skip


def _tables(scene: Scene, times: list[float], dt: float, held: bool) -> tuple[list[Array], Exception | None]:
    """Pieces of the drive for the steps from these times on, up to the first in which its functions raise an error."""
    tables = list[Array]()
    for time in times:
        try:
            tables.append(pieces_for(scene.drive, time, dt, 0.0 if held else None))
        except Exception as error:
            return tables, error
    return tables, None


def stepping_advance(simulator: Simulator) -> Advance:
    """Simulation by the steps of any simulator from its present state on."""

    def advance(state: Array, time: float, dt: float, steps: int, torques: Array | None) -> Record:
        results, failure = list[StepResult](), None
        try:
            for step in range(steps):
                results.append(simulator.step(dt, None if torques is None else float(torques[step])))
        except JackLostError as error:
            failure = error
        return stepped_record(simulator.scene, dt, state, time, results, torques is None, failure)

    return advance


def stepped_record(
    scene: Scene, dt: float, state: Array, time: float, steps: Sequence[StepResult | ControlStep], driven: bool,
    failure: Exception | None = None,
) -> Record:  # fmt: skip
    """The record of control steps of any simulator from a state, shape (12,), and a time [s].

    Args:
        scene: the scene.
        dt: duration of a step [s].
        state: at the start, SI units.
        time: at the start [s].
        steps: that followed.
        driven: whether their torques are the drive's.
        failure: the error that ended them early.
    """
    impacts = np.array([tuple(impact) for step in steps for impact in step.impacts], IMPACT)
    in_step = np.repeat(np.arange(len(steps)), np.array([len(step.impacts) for step in steps], np.int64))
    times, states = [time, *(step.time for step in steps)], [state, *(step.state for step in steps)]
    torques = None if driven else np.array([step.torque for step in steps])
    held = np.zeros(len(in_step), np.int64)
    return Record(scene, dt, 0.0, np.array(times), np.array(states), torques, impacts, in_step, held, failure)


def joined_records(parts: Sequence[Record], dt: float, rest: float) -> Record:
    """The record of successive parts."""
    offsets = np.cumsum([0, *(len(part.times) - 1 for part in parts)])
    torques = [part.torques for part in parts if part.torques is not None]
    return replace(
        parts[-1], dt=dt, rest=rest, torques=np.concatenate(torques) if torques else None,
        times=np.concatenate([parts[0].times[:1], *(part.times[1:] for part in parts)]),
        states=np.concatenate([parts[0].states[:1], *(part.states[1:] for part in parts)]),
        impacts=np.concatenate([part.impacts for part in parts]),
        steps=np.concatenate([part.steps + offset for part, offset in zip(parts, offsets[:-1], strict=True)]),
        held=np.concatenate([part.held for part in parts]),
    )  # fmt: skip


def steps_of(duration: float, dt: float) -> tuple[int, float]:
    """The number of steps of ``dt`` in a duration, and the duration of a shorter one after them, or 0.

    Raises:
        ValueError: there are too many steps.
    """
    if duration / dt > MOST_STEPS:
        raise ValueError(f"duration / dt must be at most {MOST_STEPS:,} steps, got {duration:g} / {dt:g}")
    slack = slack_of(duration, dt)
    whole = math.floor((duration + slack) / dt)
    rest = duration - whole * dt
    return whole, rest if rest > slack or not whole else 0.0


def run_record(
    advance: Advance, state: Array, time: float, dt: float, steps: tuple[int, float],
    torques: Array | Controller | None, event: Event | None = None, progress: bool = False,
) -> tuple[Record, float]:  # fmt: skip
    """Advance step by step until the end, an event or a failure; return the record and the time of the event [s].

    Steps after an event may have been made; a failure in one of them is none.
    """
    whole, rest = steps
    parts, done, end = list[Record](), 0, None
    size = 1 if callable(torques) else whole if event is None and not progress else _CHUNK
    largest = 1 if callable(torques) else max(_CHUNK, whole // 100) if progress else whole
    with bar(whole, progress) as moving:
        while end is None and (done < whole or (rest > 0.0 and done == whole)):
            length, count = (dt, min(size, whole - done)) if done < whole else (rest, 1)
            if callable(torques):
                held: Array | None = np.array([torques(time, state)])
            else:
                held = None if torques is None else torques[done : done + count]
            part = advance(state, time, length, count, held)
            parts.append(part)
            state, time, done, size = part.states[-1], float(part.times[-1]), done + count, min(2 * size, largest)
            moving.update(count)
            if event is not None:
                end = event(part)
            if part.failure is not None:
                break
    record = joined_records(parts, dt, rest if done > whole else 0.0)
    return (record, math.inf) if end is None else (replace(record, failure=None), end)


def restarted(record: Record, row: int) -> Record:
    """The record again from the step of the impact of a row, to its last step.

    Raises:
        JackLostError: the jack would leave the box, or cannot be followed.
    """
    step = int(record.steps[row])
    steps = (len(record.times) - 1 - step - (record.rest > 0.0), record.rest)
    torques = None if record.torques is None else record.torques[step:]
    advance, start = exact_advance(record.scene), float(record.times[step])
    again, _ = run_record(advance, record.states[step], start, record.dt, steps, torques)
    if again.failure is not None:
        raise again.failure
    return again
