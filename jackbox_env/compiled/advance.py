"""One piece of a step of the exact contact model, cut where feet strike walls, come to rest on them and are let go.

It reads detect -> evolve -> resolve in ``search.py``, ``motion.py`` and ``impacts.py``. ``rest.py`` holds feet at
rest.
"""

from __future__ import annotations

import math

from jackbox_env.compiled.bounds import curvature_of
from jackbox_env.compiled.motion import Piece, evolve, flight_of
from jackbox_env.compiled.rest import hold, settle
from jackbox_env.compiled.search import (
    AT_REST,
    ENDLESS,
    GLANCE,
    NONE,
    Limits,
    Touch,
    first_impact,
    resolution,
    rests,
    slowest,
    strike,
    why_endless,
)
from jackbox_env.compiled.status import Status
from jackbox_env.compiled.workspace import Array, Workspace
from jackbox_env.scene import SceneNumbers


def advance(scene: SceneNumbers, memory: Workspace, log: Array, piece: Piece, touch: Touch, since: float) -> Status:
    """Advance the state ``memory.state`` from ``since`` [s] to the end of a piece; return how it ended.

    The state is in a frame near the box; ``memory`` holds the polynomial accelerations.
    """
    memory.loose = 0
    restless = False  # whether the state has been found to be without a foot at rest
    while since < piece.length:
        remaining = piece.length - since
        near = resolution(scene, memory, touch)
        left = min(remaining, GLANCE * piece.length) if rests(scene, memory) else remaining
        flight = flight_of(scene, memory.state, piece, since)
        rest = -math.inf if restless else near
        time, pair = first_impact(scene, memory, flight, piece, left, touch.tolerance, rest)
        if pair == AT_REST:
            limits = Limits(curvature_of(scene, flight, left, piece), left, touch.tolerance)
            slow = slowest(scene, flight, limits, near)
            held = settle(scene, memory, piece, since, touch, near, slow)
            if held == 0:
                restless = True
                continue
            ended, time = hold(scene, memory, log, piece, touch, near, since, held)
            if ended != Status.DONE:
                return ended
            since += time
            continue
        restless = False
        memory.loose = 0
        if pair == ENDLESS:
            return why_endless(memory)
        if pair == NONE:
            evolve(memory, flight, left)
            memory.elapsed += left
            if left == remaining:
                return Status.DONE
            since += left
            continue
        strike(scene, memory, log, flight, time, pair, near)
        since += time
    return Status.DONE
