"""What a simulation stores: states at the ends of control steps, and impacts with the states before and after them.

:mod:`jackbox_env.recording.motion` reads it. The exact contact model records impacts as it steps, in compiled code.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jackbox_env.envs.batches.threads import Halt, run_blocks
from jackbox_env.exact.compiler import compiled
from jackbox_env.exact.motion import Moments, coast, fly, leave_frames
from jackbox_env.exact.run import PATIENCE, run
from jackbox_env.exact.workspace import (
    AFTER,
    BEFORE,
    HELD_SO_FAR,
    JUMPS,
    NOTHING,
    SCENE_PARAMS,
    SCRATCH,
    TIME,
    TORQUES,
    WIDTH,
    Call,
    Memory,
    Rules,
    Scenes,
    new_workspaces,
)
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import Array, Counts, Flags
from jackbox_env.simulators import Impact, JackLostError, Simulator
from jackbox_env.simulators.exact import (
    NO_PIECES,
    NO_TABLE,
    WITH_PIECES,
    ExactSimulator,
    drive_kind,
    ensure_compiled,
    failure,
    joined,
    pieces_for,
)

#: Of an impact: time [s], wall, foot, impulse [N s].
IMPACT = [("time", "f8"), ("wall", "i8"), ("foot", "i8"), ("impulse", "f8")]
#: With the states just before and just after it.
JUMP = [*IMPACT, ("before", "f8", 12), ("after", "f8", 12)]
_ROOM = 1024  # impacts in a log at first

ONLY_EXACT = "between them and at impacts there are states with fidelity='exact'"

Impacts = NDArray[Any]  # structured


class _WithoutStates(np.ndarray[Any, Any]):
    """Impacts of a contact model that has no states before and after them."""

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, str) and key in ("before", "after"):
            raise ValueError(f"these impacts have no states {key} them: that needs fidelity='exact'")
        return super().__getitem__(key)


@dataclass(frozen=True)
class Record:
    """A simulation in n control steps with m impacts.

    Attributes:
        scene: the scene.
        dt: duration of a step [s].
        rest: duration of the last step if it is shorter [s], else 0.
        times: at the ends of steps, the start first [s], shape (n + 1,).
        states: SI units, shape (n + 1, 12).
        torques: constant in each step [N m], n of them or more; None: the scene's drive acts.
        impacts: structured, shape (m,), in time order; without the states of ``JUMP`` if the contact model has none.
        steps: in which each impact is, shape (m,).
        held: number of feet at rest before each impact in its step, -1 for the impulse of a foot at rest; shape (m,).
        failure: the error that ended it early.
    """

    scene: Scene
    dt: float
    rest: float
    times: Array
    states: Array
    torques: Array | None
    impacts: Impacts
    steps: Counts
    held: Counts
    failure: Exception | None = None

    @cached_property
    def knots(self) -> Knots:
        """The moments at which flights begin."""
        jumps = np.flatnonzero(self.held >= 0)
        number = np.concatenate([np.arange(len(self.times)), self.steps[jumps]])
        order = np.argsort(number, kind="stable")  # the start of a step, then its jumps
        times = np.concatenate([self.times, self.impacts["time"][jumps]])[order]
        states = np.concatenate([self.states, self.impacts["after"][jumps]])[order]
        arrived = np.concatenate([self.states, self.impacts["before"][jumps]])[order]
        ends = np.zeros(len(self.times), np.bool_)
        ends[self.steps[self.held < 0] + 1] = True  # at the end of these steps a foot is at rest
        ended = np.concatenate([ends, self.held[jumps] > 0])[order]
        return Knots(times, states, arrived[1:], number[order], np.append(ended[1:], False))

    def refuse_no_states(self) -> None:
        """Raise ValueError unless there are states between control steps."""
        if "before" not in (self.impacts.dtype.names or ()):
            raise ValueError(f"this motion has states at the ends of control steps only: {ONLY_EXACT}")

    def flown(self, indices: Counts, durations: Array) -> Array:
        """The states some time after knots [s], shape (n, 12), before the next knot."""
        knots = self.knots
        states: Array = knots.states[indices].copy()
        moved = np.flatnonzero(durations > 0.0)
        held = knots.held[indices[moved]]
        for index in moved[held]:
            knot = indices[index]
            simulator = ExactSimulator(self.scene)
            simulator.reset(knots.states[knot], float(knots.times[knot]))
            torque = None if self.torques is None else float(self.torques[knots.steps[knot]])
            states[index] = simulator.step(float(durations[index]), torque).state
        if (flying := moved[~held]).size:
            states[flying] = self._coasted(indices[flying], durations[flying])
        return states

    def _coasted(self, indices: Counts, durations: Array) -> Array:
        """:func:`flown` without feet at rest."""
        knots, scene = self.knots, self.scene
        kind, count = drive_kind(scene.drive, self.torques is not None), len(indices)
        unique, number = np.unique(indices, return_inverse=True)
        table, ends = NO_TABLE, np.zeros(len(unique) + 1, np.int64)
        if kind in WITH_PIECES:
            spans = zip(knots.times[unique].tolist(), (knots.times[unique + 1] - knots.times[unique]).tolist(), strict=True)
            held = None if self.torques is None else 0.0
            table, _, ends = joined([pieces_for(scene.drive, *span, held) for span in spans], ends[:1])
        torques = np.zeros(count) if self.torques is None else self.torques[knots.steps[indices]]
        moments = Moments(
            knots.states[indices], knots.times[indices], torques, durations, table, ends[number], ends[number + 1]
        )
        states: Array = np.empty((count, 12))
        loop = compiled(fly, advance=coast)
        failed = loop(np.array(scene.numbers), kind, moments, states, new_workspaces(), np.zeros((1, 1)))
        if failed >= 0:
            raise RuntimeError(f"the flight after t = {knots.times[indices[failed]]:g} s cannot be evaluated")
        return states


class Knots(NamedTuple):
    """The moments at which flights begin: starts of steps, then the impacts within them, and the end."""

    times: Array  # [s], (n,)
    states: Array  # after an impact, (n, 12)
    ends: Array  # states at the next one, before its impact, (n - 1, 12)
    steps: Counts  # (n,)
    held: Flags  # whether a foot may be at rest before the next one, (n,)


# Simulates from a state and a time [s] in steps of dt [s], by their number, under constant torques or the drive (None).
Advance = Callable[[Array, float, float, int, Array | None], Record]


def exact_advance(scene: Scene) -> Advance:
    """Simulation by the exact contact model; the jack's loss ends it early, with the error as the record's failure."""
    ensure_compiled()
    return partial(_exact_record, scene)


def _exact_record(scene: Scene, state: Array, time: float, dt: float, steps: int, torques: Array | None) -> Record:
    times: Array = np.add.accumulate(np.concatenate([[time], np.full(steps, dt)]))
    held, pieces = torques is not None, NO_PIECES
    kind = np.array([drive_kind(scene.drive, held)])
    if kind[0] in WITH_PIECES:
        tables = [pieces_for(scene.drive, one, dt, 0.0 if held else None) for one in times[:-1].tolist()]
        pieces = joined(tables, np.zeros(1, np.int64))
    blocks = np.zeros((2, 1, WIDTH, 1))
    blocks[0, 0, :12, 0], blocks[0, 0, TIME] = state, time
    states, values = np.empty((1, steps + 1, 12)), np.array([scene.numbers])
    states[0, 0] = state
    results = NOTHING._replace(
        terminations=np.zeros(1, np.bool_), truncations=np.zeros(1, np.bool_), trajectories=states,
        hits=np.zeros((steps, 1), np.int64), impulses=np.zeros((steps, 1)),
    )  # fmt: skip
    calls = [Call(Memory(np.zeros((SCRATCH, 1)), new_workspaces(), np.zeros((_ROOM, JUMPS))))]
    calls[0].prepare(
        Scenes(values, np.zeros((1, SCENE_PARAMS, 1)), kind, *pieces),
        Rules(dt, steps, math.inf, TORQUES, True, 0, math.inf, 0, 0, 0, PATIENCE),
        blocks[0], blocks[1], np.zeros((0, 0)) if torques is None else np.array(torques)[:, None], results,
    )  # fmt: skip
    ended, _, step, _, logs = run_blocks(compiled(run), calls, 0, 0, 1, Halt())
    done = step if ended else steps
    error = failure(ended, scene, float(times[step]), dt) if ended else None
    rows, in_step = np.concatenate([np.zeros((0, JUMPS)), *logs]), np.repeat(np.arange(steps), results.hits[:, 0])
    workspaces = new_workspaces()
    compiled(leave_frames)(values[0], dt, kind[0], states[0, in_step], rows, workspaces)
    impacts = np.empty(len(rows), JUMP)
    impacts["time"] = np.minimum(times[in_step] + rows[:, 0], times[in_step + 1])
    impacts["wall"], impacts["foot"], impacts["impulse"] = rows[:, 1], rows[:, 2], rows[:, 3]
    impacts["before"], impacts["after"] = rows[:, BEFORE : BEFORE + 12], rows[:, AFTER : AFTER + 12]
    counts = rows[:, HELD_SO_FAR].astype(np.int64)
    impacts["before"][counts < 0] = impacts["after"][counts < 0] = states[0, in_step[counts < 0] + 1]
    return Record(
        scene, dt, 0.0, times[: done + 1], states[0, : done + 1], torques, impacts, in_step, counts, error
    )  # fmt: skip


def stepping_advance(simulator: Simulator) -> Advance:
    """Simulation by the steps of any simulator from its present state on."""

    def advance(state: Array, time: float, dt: float, steps: int, torques: Array | None) -> Record:
        recorder = Recorder(simulator.scene, dt, state, time, driven=torques is None)
        for step in range(steps):
            try:
                recorder.add(*simulator.step(dt, None if torques is None else float(torques[step])))
            except JackLostError as error:
                return recorder.record(error)
        return recorder.record()

    return advance


class Recorder:
    """Collects control steps.

    Args:
        scene: the scene.
        dt: duration of a step [s].
        state: at the start, shape (12,), SI units.
        time: at the start [s].
        driven: whether the torques are the scene's drive's.
    """

    def __init__(self, scene: Scene, dt: float, state: Array, time: float, driven: bool = True) -> None:
        self._scene, self._dt, self._times, self._states, self._driven = scene, dt, [time], [state], driven
        self._torques, self._impacts, self._steps = list[float](), list[Impact](), list[int]()

    def add(self, state: Array, time: float, torque: float, impacts: Sequence[Impact]) -> None:
        """Record a step: state and time [s] at its end, its mean torque [N m], its impacts."""
        self._steps += [len(self._torques)] * len(impacts)
        self._times.append(time)
        self._states.append(state)
        self._torques.append(torque)
        self._impacts += impacts

    def record(self, failure: Exception | None = None) -> Record:
        """The steps so far."""
        impacts = np.array(list(map(tuple, self._impacts)), IMPACT).view(_WithoutStates)
        steps = np.array(self._steps, np.int64)
        return Record(
            self._scene, self._dt, 0.0, np.array(self._times), np.array(self._states),
            None if self._driven else np.array(self._torques), impacts, steps, np.zeros(len(steps), np.int64), failure,
        )  # fmt: skip


def joined_records(parts: Sequence[Record], dt: float, rest: float, torques: Array | None) -> Record:
    """One record of several, each of which goes on from the one before; ``torques`` are of all steps, or more."""
    offsets = np.cumsum([0, *(len(part.times) - 1 for part in parts)])
    return replace(
        parts[-1], dt=dt, rest=rest, torques=torques,
        times=np.concatenate([parts[0].times[:1], *(part.times[1:] for part in parts)]),
        states=np.concatenate([parts[0].states[:1], *(part.states[1:] for part in parts)]),
        impacts=np.concatenate([part.impacts for part in parts]).view(type(parts[0].impacts)),
        steps=np.concatenate([part.steps + offset for part, offset in zip(parts, offsets[:-1], strict=True)]),
        held=np.concatenate([part.held for part in parts]),
    )  # fmt: skip
