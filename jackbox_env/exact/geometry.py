"""Where things are: cosines and sines, frames, and the gaps between feet and walls with their levers and gradients.

``flight.py`` and ``contact.py`` build on these. Two frames: :class:`Frame` has the world's axes, for gradients, and
:class:`BoxFrame` those of the box, for gaps.

Cosine and sine are computed together, in half the time of two calls, and with the same bits on every machine. Method:
Cody and Waite reduction by multiples of pi/2 in three parts, then the polynomials of fdlibm's k_sin.c and k_cos.c (Sun
Microsystems 1993). Beyond 1e6 rad whole turns are first taken off, 29 at a time, because 29 turns are a float64 to
2.5e-18 rad. Error: below 1 unit in the last place, beyond 1e6 rad below 1.2. Fails: beyond 2^53 rad, where float64 does
not resolve radians, it calls the C library, whose last place differs between machines.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from jackbox_env.exact.workspace import scene_at
from jackbox_env.model.scene import SceneNumbers, remainder
from jackbox_env.model.states import (
    OMEGA_BOX,
    OMEGA_JACK,
    THETA_BOX,
    THETA_JACK,
    VX_BOX,
    VX_JACK,
    VY_BOX,
    VY_JACK,
    X_BOX,
    X_JACK,
    Y_BOX,
    Y_JACK,
    Array,
    clearance,
)

ONE_REDUCTION = 1e6  # [rad] that one reduction covers
FARTHEST = 2.0**53  # [rad] that two cover
_QUARTERS_PER_RADIAN = 6.36619772367581382433e-01  # 2 / pi
# pi / 2 in parts; multiples of the first two up to 2^20 are exact
_QUARTER_HIGH = 1.57079632673412561417e00
_QUARTER_MIDDLE = 6.07710050630396597660e-11
_QUARTER_LOW = 2.02226624879595063154e-21
_TURNS = 182.212373908208  # [rad] 29 turns, rounded
_TURNS_OVER = 2.475922546353431e-18  # [rad] by which that exceeds 29 turns


def cos_sin(angle: float) -> tuple[float, float]:
    """Return the cosine and the sine of ``angle`` [rad]; NaN for an angle that is not finite."""
    if -ONE_REDUCTION < angle < ONE_REDUCTION:
        return cos_sin_within(angle)
    if -FARTHEST < angle < FARTHEST:
        rest = remainder(abs(angle), _TURNS)
        over = (abs(angle) - rest) / _TURNS * _TURNS_OVER
        near = rest + over
        residue = (rest - near) + over
        c, s = cos_sin_within(near)
        return c - residue * s, (s + residue * c) * math.copysign(1.0, angle)
    return c_library_cos_sin(angle)


def c_library_cos_sin(angle: float) -> tuple[float, float]:
    """The C library's cosine and sine of an angle [rad] that float64 does not resolve; NaN if it is not finite."""
    if -math.inf < angle < math.inf:
        return math.cos(angle), math.sin(angle)
    return math.nan, math.nan


def without_turns(angle: float) -> float:
    """The angle [rad] less whole turns, to within half a turn; unchanged beyond 2^53 rad, unresolved by float64."""
    if -math.pi <= angle <= math.pi or not -FARTHEST < angle < FARTHEST:
        return angle
    near, over = angle, 0.0
    if not -ONE_REDUCTION < angle < ONE_REDUCTION:
        near = math.copysign(remainder(abs(angle), _TURNS), angle)
        over = (angle - near) / _TURNS * _TURNS_OVER
    quarters = 4.0 * np.floor(near * (0.25 * _QUARTERS_PER_RADIAN) + 0.5)
    return float(((near - quarters * _QUARTER_HIGH) - quarters * _QUARTER_MIDDLE) - (quarters * _QUARTER_LOW - over))


def cos_sin_within(angle: float) -> tuple[float, float]:
    """Cosine and sine within +-``ONE_REDUCTION``, without a branch, so that a compiled loop is vectorized."""
    quarters = np.floor(angle * _QUARTERS_PER_RADIAN + 0.5)
    reduced = angle - quarters * _QUARTER_HIGH
    middle = quarters * _QUARTER_MIDDLE
    x = reduced - middle
    rest = (reduced - x) - middle - quarters * _QUARTER_LOW  # x + rest is the angle from the nearest quarter
    z = x * x
    v = z * x
    tail = z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10))
    tail = 8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + tail)
    sine = x - ((z * (0.5 * rest - v * tail) - rest) - v * -1.66666666666666324348e-01)
    tail = z * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11))
    tail = z * (-1.38888888888741095749e-03 + z * (2.48015872894767294178e-05 + tail))
    near_one = 1.0 - 0.5 * z
    cosine = near_one + (((1.0 - near_one) - 0.5 * z) + (z * z * (4.16666666666666019037e-02 + tail) - x * rest))
    halves = quarters * 0.5
    odd = halves != np.floor(halves)
    turned = halves - 2.0 * np.floor(halves * 0.5)  # 0, 0.5, 1, 1.5
    first = sine if odd else cosine
    second = cosine if odd else sine
    return -first if (turned == 0.5) | (turned == 1.0) else first, -second if turned >= 1.0 else second


def quarter(cosine: float, sine: float, quarters: int) -> tuple[float, float]:
    """Cosine and sine of an angle plus a number of quarter turns."""
    quarters &= 3
    if quarters == 0:
        return cosine, sine
    if quarters == 1:
        return -sine, cosine
    if quarters == 2:
        return -cosine, -sine
    return sine, -cosine


def gap_and_lever(scene: SceneNumbers, ahead: float, cosine: float, sine: float, turn: int) -> tuple[float, float]:
    """Gap between a wall and a foot, and the foot's lever about the jack's centre along the wall [m].

    Args:
        scene: the scene.
        ahead: coordinate of the jack's centre along the wall's normal [m].
        cosine: of the jack's angle relative to the box.
        sine: likewise.
        turn: number of the foot minus that of the wall.
    """
    along, across = quarter(cosine, sine, turn)
    return scene.box_half_width - ahead - scene.jack_arm * along, scene.jack_arm * across


class Frame(NamedTuple):
    """Relative position of the jack, and both angles."""

    x: float  # from the box's centre [m]
    y: float
    cosine: float  # of the box's angle
    sine: float
    relative_cosine: float  # of the jack's angle relative to the box
    relative_sine: float


def gradient(scene: SceneNumbers, frame: Frame, wall: int, foot: int, row: Array) -> float:
    """Write the gradient J of a gap to ``row``; return the gap [m]."""
    nx, ny = quarter(frame.cosine, frame.sine, wall)
    depth, side = nx * frame.x + ny * frame.y, nx * frame.y - ny * frame.x  # n . r and n^perp . r
    gap, arm = gap_and_lever(scene, depth, frame.relative_cosine, frame.relative_sine, foot - wall)
    row[X_BOX], row[Y_BOX], row[THETA_BOX] = nx, ny, -side - arm
    row[X_JACK], row[Y_JACK], row[THETA_JACK] = -nx, -ny, arm
    return gap


def frame_of(state: Array) -> Frame:
    """Relative position and angles of a state."""
    c, s = cos_sin(state[THETA_BOX])
    cp, sp = cos_sin(state[THETA_JACK] - state[THETA_BOX])
    return Frame(state[X_JACK] - state[X_BOX], state[Y_JACK] - state[Y_BOX], c, s, cp, sp)


def rate_of(state: Array, row: Array) -> float:
    """J qdot [m/s], with the gap's gradient J in ``row``."""
    return float(
        row[X_BOX] * (state[VX_BOX] - state[VX_JACK])
        + row[Y_BOX] * (state[VY_BOX] - state[VY_JACK])
        + row[THETA_BOX] * state[OMEGA_BOX]
        + row[THETA_JACK] * state[OMEGA_JACK]
    )


class BoxFrame(NamedTuple):
    """Position and velocity of the jack's centre in the rotating frame of the box."""

    x: float  # [m]
    y: float
    vx: float  # [m/s]
    vy: float


def box_frame(x: float, y: float, vx: float, vy: float, angle: float, omega: float) -> BoxFrame:
    """Transform relative position and velocity to the frame of a box at ``angle`` [rad], rate ``omega`` [rad/s]."""
    c, s = cos_sin(angle)
    ahead, aside = on_axes(c, s, x, y)
    forward, sideways = on_axes(c, s, vx, vy)
    return BoxFrame(ahead, aside, forward + omega * aside, sideways - omega * ahead)


def on_axes(cosine: float, sine: float, x: float, y: float) -> tuple[float, float]:
    """Components of a vector on the axes of a box whose angle has this cosine and sine."""
    return cosine * x + sine * y, cosine * y - sine * x


class View(NamedTuple):
    """The jack relative to the box at one moment."""

    frame: BoxFrame
    cosine: float  # of the jack's angle relative to the box
    sine: float
    spin: float  # rate of that angle [rad/s]
    time: float  # the moment, since the flight's start [s]


def view_of(frame: BoxFrame, angle: float, spin: float, time: float) -> View:
    """The jack at an ``angle`` and ``spin`` relative to the box, at a ``time`` [s]."""
    cosine, sine = cos_sin(angle)
    return View(frame, cosine, sine, spin, time)


def towards(frame: BoxFrame, wall: int) -> tuple[float, float]:
    """Coordinate of the jack's centre along a wall's normal [m], and its rate [m/s]."""
    return quarter(frame.x, -frame.y, wall)[0], quarter(frame.vx, -frame.vy, wall)[0]


def foot_gap(
    scene: SceneNumbers, ahead: float, speed: float, cosine: float, sine: float, spin: float, turn: int
) -> tuple[float, float]:
    """Gap between a wall and a foot [m], and its rate [m/s]: see :func:`gap_and_lever`.

    ``ahead`` grows at the rate ``speed`` [m/s], the angle at the rate ``spin`` [rad/s].
    """
    gap, lever = gap_and_lever(scene, ahead, cosine, sine, turn)
    return gap, lever * spin - speed


_ORDINARY = 1e9  # over L: smaller numbers of a state need no check in Python


def outside(values: Array, states: Array, deepest: Array) -> int:
    """The first of the states, shape (N, 12), that a check in Python may refuse, or -1.

    ``values`` has one scene for all states or one for each, ``deepest`` the allowed depth of a foot in each [m].
    """
    for i in range(states.shape[0]):
        scene = scene_at(values, i)
        for column in range(12):
            if not abs(states[i, column]) < _ORDINARY * scene.box_half_width:
                return i
        if not -clearance(scene, states[i]) <= deepest[i if values.shape[0] > 1 else 0]:
            return i
    return -1
