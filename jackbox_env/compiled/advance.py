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


def advance(scene: SceneNumbers, work: Workspace, log: Array, piece: Piece, touch: Touch, since: float) -> Status:
    """Advance the state ``work.state`` from ``since`` [s] to the end of a piece; return how it ended.

    The state is in a frame near the box; ``work`` holds the polynomial accelerations.
    """
    work.loose = 0
    restless = False  # whether the state has been found to be without a foot at rest
    while since < piece.length:
        remaining = piece.length - since
        near = resolution(scene, work, touch)
        left = min(remaining, GLANCE * piece.length) if rests(scene, work) else remaining
        flight = flight_of(scene, work.state, piece, since)
        rest = -math.inf if restless else near
        time, pair = first_impact(scene, work, flight, piece, left, touch.tolerance, rest)
        if pair == AT_REST:
            limits = Limits(curvature_of(scene, flight, left, piece), left, touch.tolerance)
            slow = slowest(scene, flight, limits, near)
            held = settle(scene, work, piece, since, touch, near, slow)
            if held == 0:
                restless = True
                continue
            ended, time = hold(scene, work, log, piece, touch, near, since, held)
            if ended != Status.DONE:
                return ended
            since += time
            continue
        restless = False
        work.loose = 0
        if pair == ENDLESS:
            return why_endless(work)
        if pair == NONE:
            evolve(work, flight, left)
            work.elapsed += left
            if left == remaining:
                return Status.DONE
            since += left
            continue
        strike(scene, work, log, flight, time, pair, near)
        since += time
    return Status.DONE
