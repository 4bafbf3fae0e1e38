"""Tasks: starts, and rewards and ends of episodes as small pure functions of the state.

A task's functions have the arguments scene, state after the step, mean torque over the step [N m] and impulse of the
step's impacts [N s]. One returns the values of the task's named terms, whose sum is the reward. The other returns
whether the episode is over. Every reward of the tasks here lies in [-1, 1], and none of them ends an episode. The
functions are plain arithmetic: with ``fidelity="exact"`` they are compiled.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from numbers import Real
from types import FunctionType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from jackbox_env.model.scene import Scene, SceneNumbers
from jackbox_env.model.states import (
    OMEGA_BOX,
    OMEGA_JACK,
    THETA_JACK,
    X_BOX,
    X_JACK,
    Y_BOX,
    Y_JACK,
    Array,
    State,
    as_start,
    total,
)
from jackbox_env.tools import checks as check

AnyScene = Scene | SceneNumbers


class TaskError(RuntimeError):
    """A user's function returned what cannot be used: a NaN, or a reward that is infinite."""


@dataclass(frozen=True, eq=False)
class Task:
    """A reward as named terms, and optionally when episodes end and how they start.

    A task of your own is accepted wherever the name of one is, ``gym.make("JackInBox-v0", task=lift)``.

    >>> def height(scene, state, torque, impulse):
    ...     return (state.y_jack - state.y_box) / scene.box_half_width
    >>> lift = Task(("lift",), height)

    Under ``fidelity="exact"`` each Task, Observation and Action reads its functions once, when it is first used: the
    plain functions that they call, globals, closures, defaults and the contents of arrays as they are then. All
    environments, batches and rollouts use what was read. After a change make a new Task, which reads them anew. With
    pymunk the functions are called as they are now.

    What was read is compiled. So ``values`` and ``over`` must be plain arithmetic on numbers, with ``math``; they may
    read numpy arrays by index, and make or change none. What is compiled is freed with the Task, but for about 0.2 MB
    that LLVM keeps. ``/``, ``//`` and ``%`` by zero raise ZeroDivisionError with every contact model, an index past the
    end IndexError. Powers and ``math`` out of their range return NaN or an infinity under ``"exact"``, and raise
    otherwise. A reward that is NaN or infinite raises :class:`TaskError`. After an error the environment is unchanged.

    An environment evaluates the task at its construction, in a start of :func:`sample_start`, and at each start of an
    episode, without torque and impulse. A wrong type raises TypeError there. Arithmetic errors are ignored.

    Attributes:
        terms: names of the terms; ``info`` has each as ``reward_<name>``.
        values: function of (scene, state, torque, impulse) that returns a tuple of as many floats, or one float if
            there is one term. ``scene`` has the fields of :class:`.scene.SceneNumbers`. ``state`` is the
            :class:`jackbox_env.State` after the step, a tuple of 12 numbers. ``torque`` is the mean over the step
            [N m], ``impulse`` the sum over its impacts [N s].
        over: function of the same that returns True if the step terminates the episode. None: no step does.
        start: function of the :class:`jackbox_env.Scene` and the environment's ``numpy.random.Generator`` that draws
            the state in which an episode starts, shape (12,), every foot inside the box. It is plain Python, called at
            each reset. None: as :func:`sample_start`.
    """

    terms: tuple[str, ...]
    values: Callable[[SceneNumbers, State, float, float], tuple[float, ...] | float] = None  # type: ignore[assignment]
    over: Callable[[SceneNumbers, State, float, float], bool] | None = None
    start: Callable[[Scene, np.random.Generator], ArrayLike] | None = None

    def __post_init__(self) -> None:
        if self.values is None:
            raise TypeError(f"a Task must have names of its terms and a function, got {_without_names(self.terms)}")

    def __deepcopy__(self, memo: dict[int, Any]) -> Task:
        return self  # so that copies of an environment share what is compiled

    def __reduce__(self) -> tuple[Any, ...]:
        name = next((name for name, task in TASKS.items() if task is self), None)
        return (task_of, (name,)) if name else (Task, (self.terms, self.values, self.over, self.start))


def _without_names(value: object) -> str:
    """A value in place of a Task; if it is a function, with the Task that it belongs in."""
    if not isinstance(value, FunctionType):
        return check.shown(value)
    name = value.__name__ if value.__name__.isidentifier() else "f"
    return f'{check.shown(value)}: write Task(("reward",), {name}) for {name}(scene, state, torque, impulse)'


EFFORT_COST = 0.01  # of a step at the torque limit, in knocks


def sample_start(scene: Scene, rng: np.random.Generator) -> Array:
    """Draw a start, shape (12,): box at rest at the origin, jack at rest near the middle.

    The jack's centre is uniform in +-min(1 m, (L - l)/5) on both axes, its angle uniform in +-0.5 rad. A jack that
    fits only near 45 degrees (L <= l < sqrt(2) L) starts in the middle at 45 degrees.
    """
    state = np.zeros(12)
    x, y, angle = rng.uniform(-1.0, 1.0, size=3)
    state[X_JACK], state[Y_JACK], state[THETA_JACK] = start_pose(scene, x, y, angle)
    return state


def draw_start(task: Task, scene: Scene, rng: np.random.Generator) -> Array:
    """Draw a start of the task, shape (12,).

    Raises:
        TypeError, ValueError: the task's own start is no state with every foot inside the box.
    """
    if task.start is None:
        return sample_start(scene, rng)
    drawn = task.start(scene, rng)
    try:
        return as_start(scene, drawn)
    except (TypeError, ValueError) as error:
        raise type(error)(f"the task's start has drawn what is none: {error}") from error


def start_pose(scene: AnyScene, x: float, y: float, angle: float) -> tuple[float, float, float]:
    """The jack's position [m] and angle [rad] at the start, from three draws that are uniform in [-1, 1]."""
    room = scene.box_half_width - scene.jack_arm
    if room <= 0.0:
        return 0.0, 0.0, math.pi / 4.0
    spread = min(1.0, room / 5.0)
    return spread * x, spread * y, 0.5 * angle


def juggle(scene: AnyScene, state: State, torque: float, impulse: float) -> tuple[float]:
    """Keep the jack near the middle of the box."""
    half_width = scene.box_half_width
    x, y = state.x_jack - state.x_box, state.y_jack - state.y_box
    return (max(0.0, 1.0 - math.sqrt(x * x + y * y) / max(half_width - scene.jack_arm, half_width / 6.0)),)


def spin(scene: AnyScene, state: State, torque: float, impulse: float) -> tuple[float]:
    """Spin the jack counter-clockwise while the box is calm.

    Spinning the other way costs as much as it earns, so luck averages out; spinning the box up ends all pay.
    """
    rate = state.omega_jack * scene.jack_arm / scene.speed_scale
    return (max(-1.0, min(1.0, rate)) * _calm(scene, state, 1.0),)


def rattle(scene: AnyScene, state: State, torque: float, impulse: float) -> tuple[float, float]:
    """Knock hard at little torque.

    A jack turned back at v0 makes a knock of 1/2.
    """
    knock = min(1.0, impulse / (4.0 * scene.jack_mass * scene.speed_scale))
    effort = min(1.0, abs(torque) / scene.torque_limit)
    return knock * _calm(scene, state, 2.0), -EFFORT_COST * effort * effort


def juggle_slope(scene: SceneNumbers, states: Array) -> Array:
    """Derivative of :func:`juggle` by each state, (n, 12), in a scene whose numbers are (n,) or (1,); 0 at kinks."""
    x, y = states[:, X_JACK] - states[:, X_BOX], states[:, Y_JACK] - states[:, Y_BOX]
    reach = np.maximum(scene.box_half_width - scene.jack_arm, scene.box_half_width / 6.0)
    distance, slope = np.hypot(x, y), np.zeros_like(states)
    inner = (distance > 0.0) & (distance < reach)
    steep = np.where(inner, 1.0 / (reach * np.where(inner, distance, 1.0)), 0.0)
    slope[:, X_BOX], slope[:, Y_BOX] = steep * x, steep * y
    slope[:, X_JACK], slope[:, Y_JACK] = -slope[:, X_BOX], -slope[:, Y_BOX]
    return slope


def spin_slope(scene: SceneNumbers, states: Array) -> Array:
    """Derivative of :func:`spin` by each state, as :func:`juggle_slope`."""
    per_rate = np.asarray(scene.jack_arm) / scene.speed_scale
    rate = states[:, OMEGA_JACK] * per_rate
    calm = 1.0 - abs(states[:, OMEGA_BOX]) * scene.box_half_width / scene.speed_scale
    slope = np.zeros_like(states)
    slope[:, OMEGA_JACK] = np.where(abs(rate) < 1.0, per_rate * np.maximum(calm, 0.0), 0.0)
    slowing = np.sign(states[:, OMEGA_BOX]) * scene.box_half_width / scene.speed_scale
    slope[:, OMEGA_BOX] = np.where(calm > 0.0, -np.clip(rate, -1.0, 1.0) * slowing, 0.0)
    return slope


def _calm(scene: AnyScene, state: State, limit: float) -> float:
    """1 at a box at rest, falling linearly to 0 where its rate reaches ``limit`` v0 / L."""
    return float(max(0.0, 1.0 - abs(state.omega_box) * scene.box_half_width / (limit * scene.speed_scale)))


TASKS = {
    "juggle": Task(("centre",), juggle),
    "spin": Task(("spin",), spin),
    "rattle": Task(("knock", "effort"), rattle),
}
SLOPES = {"juggle": juggle_slope, "spin": spin_slope}  # of the tasks whose reward is a function of the state


def task_of(task: str | Task, argument: str = "task") -> Task:
    """The task of that name, or a checked Task; ``argument`` is its name in errors.

    Raises:
        TypeError, ValueError: an unknown name; terms that are not different words; something else than a function.
    """
    if isinstance(task, str):
        return TASKS[check.choice(argument, task, TASKS)]
    if not isinstance(task, Task):
        listed = ", ".join(repr(name) for name in TASKS)
        raise TypeError(f"{argument} must be one of {listed}, or a jackbox_env.Task, got {_without_names(task)}")
    terms, values, over, start = task.terms, task.values, task.over, task.start
    listed = list(terms) if isinstance(terms, Sequence) and not isinstance(terms, str) else []
    if not listed or not all(isinstance(name, str) and name for name in listed) or len({*listed}) < len(listed):
        raise ValueError(f"a task's terms must be a tuple of different names, got {check.shown(terms)}")
    if not isinstance(values, FunctionType):
        raise TypeError(f"a task's values must be a plain Python function, got {check.shown(values)}")
    if not isinstance(over, FunctionType | None):
        raise TypeError(f"a task's over must be a plain Python function or None, got {check.shown(over)}")
    if not (start is None or callable(start)):
        raise TypeError(f"a task's start must be a function of scene and rng, or None, got {check.shown(start)}")
    object.__setattr__(task, "terms", tuple(listed))  # of the same Task, whose functions are read once
    return task


def checked_terms(task: Task, values: object) -> tuple[float, ...]:
    """Return the values that a task's function has returned: a tuple of a number for each term; one number is one term.

    Raises:
        TypeError: it is not.
    """
    if isinstance(values, tuple) and len(values) == len(task.terms) and all(isinstance(one, Real) for one in values):
        return values
    count = len(task.terms)
    if isinstance(values, Real) and count == 1:
        return (values,)  # type: ignore[return-value]
    raise TypeError(
        f"a task's values must return a tuple of {count} numbers, one for each term, got {check.shown(values)}"
    )


def checked_reward(task: Task, terms: Sequence[float]) -> float:
    """The reward, if it is finite.

    Raises:
        TaskError: it is not.
    """
    reward = total(terms)
    if math.isfinite(reward):
        return reward
    listed = [f"{name!r} is {value}" for name, value in zip(task.terms, terms, strict=True)]
    not_finite = [one for one, value in zip(listed, terms, strict=True) if not math.isfinite(value)]
    raise TaskError(f"the reward must be finite, got {reward}: the term {', '.join(not_finite or listed)}")
