"""What a simulation stores: states at the ends of control steps, and impacts with the states before and after them.

:mod:`jackbox_env.recording.motion` reads it. The exact contact model records impacts as it steps, in compiled code.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
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
from jackbox_env.simulators.exact import NO_PIECES, NO_TABLE, WITH_PIECES, ExactSimulator, drive_kind, failure, joined, pieces_for

#: Of an impact: time [s], wall, foot, impulse [N s].
IMPACT = [("time", "f8"), ("wall", "i8"), ("foot", "i8"), ("impulse", "f8")]
#: With the states just before and just after it.
JUMP = [*IMPACT, ("before", "f8", 12), ("after", "f8", 12)]
_ROOM = 1024  # impacts in a log at first

Impacts = NDArray[Any]  # structured


@dataclass(frozen=True)
class Record:
    """A simulation in n control steps with m impacts.

    Attributes:
        scene: the scene.
        dt: duration of a step [s]; the last one may be shorter.
        times: at the ends of steps, the start first [s], shape (n + 1,).
        states: SI units, shape (n + 1, 12).
        torques: constant in each step [N m], shape (n,); None: the scene's drive acts.
        impacts: structured, shape (m,), in time order; without the states of ``JUMP`` if the contact model has none.
        steps: in which each impact is, shape (m,).
        held: number of feet at rest before each impact in its step, -1 for the impulse of a foot at rest; shape (m,).
        failure: the error that ended it early.
    """

    scene: Scene
    dt: float
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
        ends = np.zeros(len(self.times), np.bool_)
        ends[self.steps[self.held < 0] + 1] = True  # at the end of these steps a foot is at rest
        ended = np.concatenate([ends, self.held[jumps] > 0])[order]
        return Knots(times, states, number[order], np.append(ended[1:], False))

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
    steps: Counts  # (n,)
    held: Flags  # whether a foot may be at rest before the next one, (n,)


def exact_record(scene: Scene, state: Array, time: float, dt: float, steps: int, torques: Array | None) -> Record:
    """Simulate by the exact contact model; the jack's loss ends it early, with the error as the record's failure.

    The arguments have been checked, and ``time`` [s] moves in each step.
    """
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
        blocks[0], blocks[1], np.zeros((0, 0)) if torques is None else torques[:steps, None], results,
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
        scene, dt, times[: done + 1], states[0, : done + 1], None if torques is None else torques[:done], impacts,
        in_step, counts, error,
    )  # fmt: skip
