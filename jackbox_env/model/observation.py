"""Observations: the numbers that an agent sees, from the scene, the state and the time.

``"state"`` is the ten numbers of ``STATE_TABLE``, of order one, from the state alone; the environment's page has the
table, too. The cross repeats every quarter turn, hence the cosine and sine of four times its angle. ``"landing"``
appends the eleven numbers of :data:`jackbox_env.model.landing.FEATURES`. Values are clipped to their bounds. The exact
model compiles the functions here and those of a user, see ``exact/score.py``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from types import FunctionType
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jackbox_env.model.landing import FEATURE_BOUNDS, FEATURES, at_landing, clipped, landing_features
from jackbox_env.model.pixels import Pixels, pixels_named
from jackbox_env.model.scene import Scene, SceneNumbers
from jackbox_env.model.states import Floats, Numbers, State
from jackbox_env.model.tasks import TaskError
from jackbox_env.tools import checks as check

STATE_TABLE = (  # name, description, bound and unit; (*) see the environment's page
    ("x", "x of the jack's centre, in the box frame", 1, "L"),
    ("y", "y of the jack's centre, in the box frame", 1, "L"),
    ("vx", "x velocity relative to the box's centre (*)", 10, "v0"),
    ("vy", "y velocity relative to the box's centre (*)", 10, "v0"),
    ("cosine_box", "cosine of the box's angle", 1, ""),
    ("sine_box", "sine of the box's angle", 1, ""),
    ("omega_box", "angular velocity of the box", 10, "v0 / L"),
    ("cosine_4", "cosine of 4 (jack's angle - box's angle)", 1, ""),
    ("sine_4", "sine of 4 (jack's angle - box's angle)", 1, ""),
    ("omega_jack", "angular velocity of the jack", 10, "v0 / l"),
)
NAMES = tuple(name for name, *_ in STATE_TABLE)
BOUNDS = np.array([bound for _, _, bound, _ in STATE_TABLE], dtype=np.float32)


@dataclass(frozen=True, eq=False)
class Observation:
    """An agent's observation: named numbers, each between bounds.

    One of your own is accepted wherever the name of one is, ``gym.make("JackInBox-v0", observation=height)``.

    >>> def heights(scene, state, time):
    ...     return ((state.y_jack - state.y_box) / scene.box_half_width,)
    >>> height = Observation(("height",), -1.0, 1.0, heights)

    Like those of a :class:`jackbox_env.Task`, the function is plain arithmetic with ``math``, compiled under
    ``fidelity="exact"``, where it is read once. A NaN raises :class:`jackbox_env.TaskError` and changes nothing.

    Attributes:
        names: of the numbers, different words.
        low: least values, finite: one for all or one for each.
        high: largest values, in the same way, above ``low``.
        values: function of (scene, state, time) that returns a tuple of as many numbers as there are names; they are
            clipped to the bounds. ``scene`` has the fields of :class:`.scene.SceneNumbers`, ``state`` is the
            :class:`jackbox_env.State`, ``time`` is in s.
    """

    names: tuple[str, ...]
    low: ArrayLike
    high: ArrayLike
    values: Callable[[SceneNumbers, State, float], tuple[float, ...]]

    def __deepcopy__(self, memo: dict[int, Any]) -> Observation:
        return self  # so that copies of an environment share what is compiled

    def __reduce__(self) -> tuple[Any, ...]:
        name = next((name for name, one in OBSERVATIONS.items() if one is self), None)
        return (observation_of, (name,)) if name else (Observation, (self.names, self.low, self.high, self.values))

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Least and largest values, float32, shape (n,) each."""
        low, high = (np.full(len(self.names), bound, dtype=np.float32) for bound in (self.low, self.high))
        return low, high


def observe(scene: SceneNumbers, state: State, time: float, observation: Observation) -> NDArray[np.float32]:
    """Return the observation of a state in plain Python: a fresh float32 array.

    The C library's cosines differ between machines in the last place of float64, which float32 hides all but once in
    1e12 numbers.

    Raises:
        TypeError: a user's function returns something else than a number for each name.
        TaskError: a number is NaN.
    """
    values = observation.values(scene, state, time)
    if observation in OBSERVATIONS.values():
        return np.array(values, dtype=np.float32)
    count = len(observation.names)
    if not (isinstance(values, tuple) and len(values) == count and all(isinstance(one, Real) for one in values)):
        raise TypeError(f"an observation's values must return a tuple of {count} numbers, got {check.shown(values)}")
    seen: NDArray[np.float32] = np.clip(np.array(values, dtype=np.float64), *observation.bounds).astype(np.float32)
    if np.isnan(seen).any():
        raise bad_observation(observation, values)
    return seen


def bad_observation(observation: Observation, values: Sequence[float]) -> TaskError:
    """The error for an observation with NaN."""
    names = [name for name, value in zip(observation.names, values, strict=True) if value != value]
    return TaskError(f"the observation must be numbers, got NaN for {', '.join(map(repr, names))}")


def cosine_and_sine(angle: float) -> tuple[float, float]:
    """The C library's cosine and sine. Compiled code has its own, see ``exact/score.py``."""
    return math.cos(angle), math.sin(angle)


def less_turns(angle: float) -> float:
    """An angle [rad] less whole turns, by the C library; as above."""
    return math.remainder(angle, math.tau)


def state_values(scene: SceneNumbers, state: State, time: float) -> tuple[float, ...]:
    """The ten numbers."""
    cosine, sine = cosine_and_sine(state.theta_box)
    cosine_4, sine_4 = cosine_and_sine(4.0 * (state.theta_jack - state.theta_box))
    return components(scene, state, cosine, sine, cosine_4, sine_4)


def landing_values(scene: SceneNumbers, state: State, time: float) -> tuple[float, ...]:
    """The ten numbers and the landing features."""
    duration, relative, world = at_landing(scene, state)
    angles = *cosine_and_sine(relative), *cosine_and_sine(2.0 * relative), *cosine_and_sine(world)
    features = landing_features(scene, state, duration, less_turns(state.theta_box), angles)
    return state_values(scene, state, time) + features


def components(
    scene: Scene | SceneNumbers, state: Numbers, cosine: float, sine: float, cosine_4: float, sine_4: float
) -> tuple[float, float, float, float, float, float, float, float, float, float]:
    """The ten numbers, from cosine and sine of theta_box and of 4 (theta_jack - theta_box)."""
    # By index: a batch reads its rows in place, and naming all twelve numbers first takes about 2 % longer.
    x, y = state[3] - state[0], state[4] - state[1]
    vx, vy = state[9] - state[6], state[10] - state[7]
    per_length = 1.0 / scene.box_half_width
    per_speed = 1.0 / scene.speed_scale
    return (
        clipped((cosine * x + sine * y) * per_length, 1.0),
        clipped((cosine * y - sine * x) * per_length, 1.0),
        clipped((cosine * vx + sine * vy) * per_speed, 10.0),
        clipped((cosine * vy - sine * vx) * per_speed, 10.0),
        cosine,
        sine,
        clipped(state[8] * scene.box_half_width * per_speed, 10.0),
        cosine_4,
        sine_4,
        clipped(state[11] * scene.jack_arm * per_speed, 10.0),
    )


STATE = Observation(NAMES, -BOUNDS, BOUNDS, state_values)
OBSERVATIONS = {
    "state": STATE,
    "landing": Observation(
        (*NAMES, *(f"landing_{name}" for name in FEATURES)),
        np.array([*-BOUNDS, *(low for low, _ in FEATURE_BOUNDS)], dtype=np.float32),
        np.array([*BOUNDS, *(high for _, high in FEATURE_BOUNDS)], dtype=np.float32),
        landing_values,
    ),
}


def observation_parts(
    observation: str | Observation | Pixels | Mapping[str, Any],
) -> tuple[Observation, Pixels | None]:
    """The numbers that an agent observes, and the pictures that it observes instead of the ten numbers, or None.

    Raises:
        TypeError, ValueError: as :func:`observation_of`; or a picture's size or stack is out of its range.
    """
    if isinstance(observation, Mapping) and observation:  # Pixels in the JSON form of a spec
        check.known_keys("observation", observation, ("size", "stack"))
        observation = Pixels(**observation)
    pixels = pixels_named(observation) if isinstance(observation, str) else observation
    if isinstance(pixels, Pixels):
        return STATE, pixels
    return observation_of(cast("str | Observation", observation)), None


def observation_of(observation: str | Observation) -> Observation:
    """The observation of that name, or a checked Observation.

    Raises:
        TypeError, ValueError: an unknown name; names that are not different words; bounds that are not finite, or of
            another shape; something else than a function.
    """
    if isinstance(observation, str):
        return OBSERVATIONS[check.choice("observation", observation, (*OBSERVATIONS, "pixels"))]
    if not isinstance(observation, Observation):
        listed = ", ".join(repr(name) for name in (*OBSERVATIONS, "pixels"))
        raise TypeError(
            f"observation must be one of {listed}, or a jackbox_env.Observation or Pixels, got "
            f"{check.shown(observation)}"
        )
    if observation in OBSERVATIONS.values():
        return observation
    names = observation.names
    listed_names = list(names) if isinstance(names, Sequence) and not isinstance(names, str) else []
    words = all(isinstance(name, str) and name for name in listed_names)
    if not listed_names or not words or len({*listed_names}) < len(listed_names):
        raise ValueError(f"an observation's names must be a tuple of different names, got {check.shown(names)}")
    bounds = []
    for side in ("low", "high"):
        bound = check.array(f"an observation's {side}", getattr(observation, side), "be finite numbers")
        shown, count = check.shown(bound.tolist()), len(listed_names)
        if bound.shape not in ((), (count,)) or not (abs(bound) <= np.finfo(np.float32).max).all():
            raise ValueError(
                f"an observation's {side} must be one number, finite as a float32, or {count} of them, got {shown}"
            )
        bounds.append(bound.astype(np.float32))
    if not np.all(bounds[0] < bounds[1]):
        shown = " and ".join(check.shown(one.tolist()) for one in bounds)
        raise ValueError(f"an observation's low must be below its high everywhere, got {shown}")
    if not isinstance(observation.values, FunctionType):
        raise TypeError(
            f"an observation's values must be a plain Python function, got {check.shown(observation.values)}"
        )
    return observation
