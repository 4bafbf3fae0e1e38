"""How impacts are usually found: look at the step's end, then Newton's method. What happens in between is lost.

It replaces the certified search of ``jackbox_env.compiled.search`` for comparisons: ``scripts/studies/speed/speed.py``
measures the price of the guarantee, the tests show what this search misses.
"""

from __future__ import annotations

from jackbox_env.compiled.motion import Flight, View, box_frame, foot_gap, gap_at, pose_at, towards
from jackbox_env.compiled.search import NONE, Limits
from jackbox_env.compiled.trigonometry import cos_sin
from jackbox_env.compiled.workspace import Workspace
from jackbox_env.scene import SceneNumbers

_MOST_ITERATIONS = 50


def first_of_all(
    scene: SceneNumbers, work: Workspace, flight: Flight, view: View, walls: int, likely: int, limits: Limits,
    rest: float,
) -> tuple[float, int]:  # fmt: skip
    """The earliest root of the gaps that are closed at the end; returns values like the certified search."""
    left = limits.end
    best, found = left, NONE
    end = pose_at(flight, work, left)
    at_end = box_frame(end.x, end.y, end.vx, end.vy, end.angle, end.omega)
    cosine, sine = cos_sin(end.jack_angle - end.angle)
    for wall in range(4):
        if not walls & (1 << wall):
            continue
        ahead, speed = towards(at_end, wall)
        for foot in range(4):
            gap, rate = foot_gap(scene, ahead, speed, cosine, sine, flight.jack_omega - end.omega, foot - wall)
            if gap > 0.0 or rate >= 0.0:
                continue
            s = left
            for _ in range(_MOST_ITERATIONS):
                s = min(max(s - gap / rate, 0.0), left)
                gap, rate = gap_at(scene, flight, work, wall, foot, s)
                if abs(gap) <= limits.tolerance or rate == 0.0:
                    break
            if s <= best and rate < 0.0:
                best, found = s, 4 * wall + foot
    return best, found
