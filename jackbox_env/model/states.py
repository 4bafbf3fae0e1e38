"""The 12 numbers of a state: their order, their names, and the values that are accepted.

    [x_box, y_box, theta_box, x_jack, y_jack, theta_jack, vx_box, vy_box, omega_box, vx_jack, vy_jack, omega_jack]

float64, SI units, positions first, then their rates.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jackbox_env.model.scene import Scene, SceneNumbers
from jackbox_env.tools import checks as check


class State(NamedTuple):
    """The 12 numbers by name, for a task's functions: ``state.y_jack - state.y_box``.

    >>> State(*range(12)).omega_box
    8
    """

    x_box: float  # of the box's centre [m]
    y_box: float
    theta_box: float  # counter-clockwise [rad]
    x_jack: float  # [m]
    y_jack: float
    theta_jack: float  # [rad]
    vx_box: float  # [m/s]
    vy_box: float
    omega_box: float  # [rad/s]
    vx_jack: float  # [m/s]
    vy_jack: float
    omega_jack: float  # [rad/s]


# The same order as indices into arrays of states: state[X_BOX], states[:, OMEGA_JACK]. Gradients of gaps, and rates or
# accelerations on their own, have six numbers in the order of the first six.
(
    X_BOX, Y_BOX, THETA_BOX, X_JACK, Y_JACK, THETA_JACK,
    VX_BOX, VY_BOX, OMEGA_BOX, VX_JACK, VY_JACK, OMEGA_JACK,
) = range(len(State._fields))  # fmt: skip
RATES = VX_BOX  # where the rates begin

#: The names of a state's 12 numbers, in order.
STATE_NAMES = State._fields
STATE_UNITS = ("m", "m", "rad") * 2 + ("m/s", "m/s", "rad/s") * 2

# A start is inside if no foot is further out than this [m], or than 4 units in the last place of a far-off position.
START_TOLERANCE = 1e-9

# A restored state may have a foot this far outside [m], or L if that is less, as contact models leave it.
DEEPEST = 1.0

# Beyond this, squares and products of states and masses would overflow.
LARGEST = 1e100

# Beyond this the spacing of float64 times (1.2e-7 s) is no longer small against a control step.
LATEST_TIME = 1e9  # [s]

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]
Counts = NDArray[np.int64]
Indices = NDArray[np.int64]
Numbers = Sequence[float] | Array  # 12 of them


def as_state(state: ArrayLike) -> Array:
    """Return ``state`` as a fresh float64 array of shape (12,).

    Raises:
        TypeError: it is not an array of numbers.
        ValueError: its shape is not (12,), or a number, which the message names, is NaN, infinite or beyond 1e100.
    """
    array = np.array(check.array("state", state, "be 12 numbers"), dtype=np.float64)
    if array.shape != (12,):
        raise ValueError(f"state must have shape (12,), got shape {array.shape}")
    if not np.isfinite(array).all():
        index = int(np.argmin(np.isfinite(array)))
        raise ValueError(f"state must be finite, got {STATE_NAMES[index]} = {array[index]}")
    if np.abs(array).max() > LARGEST:
        index = int(np.argmax(np.abs(array)))
        raise ValueError(f"state must be within +-{LARGEST:g}, got {STATE_NAMES[index]} = {array[index]}")
    return array


def refuse_no_scene(scene: Scene) -> None:
    """Raise TypeError unless ``scene`` is a Scene."""
    if not isinstance(scene, Scene):
        raise TypeError(f"scene must be a Scene, got {check.shown(scene)}")


def clearance(scene: Scene | SceneNumbers, state: Numbers) -> float:
    """Smallest of the 16 gaps [m] of 12 numbers, in closed form: opposite feet make each extent symmetric.

    In the box frame the jack reaches |x| + l max(|cos|, |sin|) of the relative angle along x, and likewise along y.
    NaN for a state that is not finite.
    """
    x, y = state[X_JACK] - state[X_BOX], state[Y_JACK] - state[Y_BOX]
    relative = state[THETA_JACK] - state[THETA_BOX]
    if not (abs(state[THETA_BOX]) < math.inf and abs(relative) < math.inf):
        return math.nan
    cosine, sine = math.cos(state[THETA_BOX]), math.sin(state[THETA_BOX])
    reach = scene.jack_arm * max(abs(math.cos(relative)), abs(math.sin(relative)))
    return scene.box_half_width - reach - max(abs(cosine * x + sine * y), abs(cosine * y - sine * x))


def start_tolerance(state: Sequence[float]) -> float:
    """The most that a foot of a start may be outside [m]: 1e-9, or 4 units in the last place of a far-off position."""
    furthest = max(abs(state[X_BOX]), abs(state[Y_BOX]), abs(state[X_JACK]), abs(state[Y_JACK]))
    return max(START_TOLERANCE, 4.0 * math.ulp(furthest))


def as_start(scene: Scene, state: ArrayLike) -> Array:
    """Return ``state`` as a fresh float64 array of shape (12,) if every foot is inside, to the start's tolerance.

    Raises:
        TypeError, ValueError: the state is not 12 finite numbers, a foot is outside, or the positions are so far from
            the origin that float64 does not resolve L / 1000.
    """
    array, outside = _located(scene, state)
    tolerance = start_tolerance(array.tolist())
    if not outside <= tolerance:
        raise ValueError(
            f"a start must have every foot inside the box (at most {tolerance:g} m outside), got a foot {outside:g} m "
            "outside; set_state restores states in contact"
        )
    return array


def deepest_restored(scene: Scene) -> float:
    """The most that a foot of a restored state may be outside [m]: min(1 m, L)."""
    return min(DEEPEST, scene.box_half_width)


def by_names(numbers: Mapping[str, float]) -> Array:
    """The state, shape (12,), of numbers by name, SI units; those without one are 0.

    Raises:
        TypeError, ValueError: an unknown name, or no finite number.
    """
    check.known_keys("state", numbers, STATE_NAMES)
    return np.array([check.real(f"{name} in state", numbers.get(name, 0.0)) for name in STATE_NAMES])


def as_restored(scene: Scene, state: ArrayLike) -> Array:
    """Return ``state`` as a fresh float64 array of shape (12,) if every foot is at most min(1 m, L) outside.

    Raises:
        TypeError, ValueError: the state is not 12 finite numbers, a foot is further outside, or the positions are so
            far from the origin that float64 does not resolve L / 1000.
    """
    (array, outside), deepest = _located(scene, state), deepest_restored(scene)
    if not outside <= deepest:
        raise ValueError(f"state must have every foot at most {deepest:g} m outside, got {outside:g} m")
    return array


def _located(scene: Scene, state: ArrayLike) -> tuple[Array, float]:
    """A state as an array, and how far its outermost foot is outside [m].

    Raises:
        TypeError, ValueError: no scene, no state, or positions too far from the origin.
    """
    refuse_no_scene(scene)
    array = as_state(state)
    values = array.tolist()
    furthest = max(abs(values[index]) for index in (X_BOX, Y_BOX, X_JACK, Y_JACK))
    if not math.ulp(furthest) <= 1e-3 * scene.box_half_width:
        raise ValueError(f"state must be near enough to the origin for float64 to resolve L / 1000, got {furthest:g} m")
    return array, -clearance(scene, values)


def copy_numbers(count: int, source: Numbers, into: Array | Floats) -> None:
    """Copy the first ``count`` numbers."""
    for index in range(count):
        into[index] = source[index]


def add_numbers(count: int, into: Array, share: float, others: Array) -> None:
    """Add ``share`` times the first ``count`` of other numbers."""
    for index in range(count):
        into[index] += share * others[index]


def total(values: Sequence[float]) -> float:
    """Sum in the order given, as in compiled code; Python's own ``sum`` rounds otherwise."""
    result = 0.0
    for value in values:
        result += value
    return result
