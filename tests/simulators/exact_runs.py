"""Runs of the exact model, compiled and uncompiled."""

from __future__ import annotations

from typing import Any

import numpy as np

from jackbox_env.exact import step
from jackbox_env.exact.workspace import new_log, new_workspaces
from jackbox_env.model.scene import Scene
from jackbox_env.simulators.exact import ExactSimulator, drive_kind, pieces_for
from tests.states import started


def simulator(scene: Scene, state: Any, time: float = 0.0) -> ExactSimulator:
    return started(ExactSimulator(scene), state, time)


def plain_step(scene: Scene, state: Any, dt: float, torque: float | None = None, time: float = 0.0) -> tuple[Any, ...]:
    """One step of the same code uncompiled: how it ended, the state after, and the impacts (time, wall, foot)."""
    n, w, log = scene.numbers, new_workspaces()[0], new_log(64)
    before, after = np.array(state, dtype=float), np.empty(12)
    pieces = pieces_for(scene.drive, time, dt, torque)
    held = 0.0 if torque is None else torque
    params = step.make_parameters(n, dt, drive_kind(scene.drive, torque is not None))
    with np.errstate(divide="ignore", invalid="ignore"):
        ended, _ = step.step(n, params, before, after, time, held, step.Pieces(pieces, 0, len(pieces)), w, log)
    rows = log[: w.hits, :3]
    return ended, after, [(row[0], int(row[1]), int(row[2])) for row in rows]


def gaps_evaluated(simulator: ExactSimulator) -> float:
    """In each of the last two steps, at most."""
    return float(max(call.memory.workspaces[0].evaluations for call in simulator._calls))
