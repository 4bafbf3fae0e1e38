"""Actions: how an agent turns the box, and for how long an action lasts.

``"torque"`` is a share of the torque limit. ``"landing"`` is the box's angle and rate at the jack's next landing, to
which ``landing.aim`` steers in each control step. ``"discrete"`` is one of -1, 0 and 1 of the limit. The exact model
compiles their functions and those of a user, see ``exact/score.py``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from numbers import Real
from types import FunctionType
from typing import Any, Literal, NamedTuple

import gymnasium as gym
import numpy as np

from jackbox_env.model.landing import ANGLE, DECISION, RATE, RESTING, aim
from jackbox_env.model.scene import SceneNumbers
from jackbox_env.model.states import Array, Flags, State
from jackbox_env.model.tasks import TaskError
from jackbox_env.tools import checks as check

EPISODE_STEPS = 500  # control steps of an episode, unless another number is chosen
MOST_STEPS = 10**15  # float64 counts them all
_MOST_REPEATS = 1_000_000
_FASTEST = 2e-6  # [s] of a control step, if an impact ends an action


@dataclass(frozen=True, eq=False)
class Action:
    """How an agent acts: a space of actions, and the torque on the box that follows from one in each control step.

    One of your own is accepted wherever the name of one is, ``gym.make("JackInBox-v0", action=servo)``.

    >>> def towards(scene, state, action, time, dt):  # PD; the action is an angle of the box [rad]
    ...     wanted = 30.0 * (action[0] - state.theta_box) - 10.0 * state.omega_box  # [rad/s^2]
    ...     return wanted * scene.box_inertia / scene.torque_limit
    >>> servo = Action(gym.spaces.Box(-0.5, 0.5, (1,)), towards)

    Like those of a :class:`jackbox_env.Task`, the function is plain arithmetic with ``math``, compiled under
    ``fidelity="exact"``, where it is read once.

    Attributes:
        space: a Box of shape (n,), or a Discrete that starts at 0.
        torque: function of (scene, state, action, time, dt) that returns a share of the torque limit, evaluated at the
            start of each control step and constant in it. It is clipped to [-1, 1]; NaN raises
            :class:`jackbox_env.TaskError` and changes nothing. ``scene`` has the fields of
            :class:`.scene.SceneNumbers`, ``state`` is the :class:`jackbox_env.State`, ``action`` a tuple of
            floats, clipped to the Box, or an int of the Discrete, ``time`` is in s, ``dt`` the control step [s].
    """

    space: gym.spaces.Box | gym.spaces.Discrete
    torque: Callable[[SceneNumbers, State, Any, float, float], float]

    def __deepcopy__(self, memo: dict[int, Any]) -> Action:
        return self  # so that copies of an environment share what is compiled

    def __reduce__(self) -> tuple[Any, ...]:
        name = next((name for name, action in ACTIONS.items() if action is self), None)
        return (action_of, (name,)) if name else (Action, (self.space, self.torque))

    @property
    def size(self) -> int:
        """Numbers of an action: those of the Box, or 0 for the one int of a Discrete."""
        return self.space.shape[0] if isinstance(self.space, gym.spaces.Box) else 0

    def checked(self, action: Any, count: int | None = None, waiting: Flags | None = None) -> Array:
        """Actions as float64, shape (n, N), clipped to the space; of one environment (n, 1).

        Args:
            action: shape (n,), or (N, n) for ``count`` environments; without the last number if it is 1.
            count: N; None: one environment alone.
            waiting: environments whose actions are ignored, bool (N,); None: no environment.

        Raises:
            TypeError, ValueError: another shape, or a number that is no action.
        """
        (name, rows), width = ("action", ()) if count is None else ("actions", (count,)), max(self.size, 1)
        if discrete := isinstance(self.space, gym.spaces.Discrete):
            low, high, shapes = np.zeros(1), np.array([self.space.n - 1.0]), f"{rows}"
            every, one = (f"{kind} from 0 to {self.space.n - 1}" for kind in ("whole numbers", "a whole number"))
        else:
            low, high = self.space.low.astype(np.float64), self.space.high.astype(np.float64)
            limits = "[-1, 1]" if (low == -1.0).all() and (high == 1.0).all() else "the space"
            kind = "a finite number" if width == 1 else "finite numbers"
            every, one = f"numbers (clipped to {limits})", f"{kind} (clipped to {limits})"
            shapes = f"{(*rows, width)} or {rows}" if width == 1 and rows else f"{(*rows, width)}"
        wanted = one if count is None else every
        values = check.array(name, action, f"be {wanted}")
        if discrete and values.dtype.kind not in "iu":
            raise TypeError(f"{name} must be {wanted}, got {check.shown(action)}")
        if values.shape != (*rows, width) and not (width == 1 and values.shape == rows):
            raise ValueError(f"{name} must have shape {shapes}, got shape {values.shape}")
        values = values.reshape(-1, width)
        unusable = (values < low) | (values > high) if discrete else ~np.isfinite(values)
        unusable = unusable if waiting is None else unusable & ~waiting[:, None]
        if unusable.any():
            row, column = np.argwhere(unusable)[0].tolist()
            where = "" if count is None else f" for environment {row}"
            raise ValueError(f"action must be {one}, got {values[row, column]}{where}")
        clipped: Array = np.clip(values.astype(np.float64), low, high)
        return np.ascontiguousarray(clipped.T)

    def share(self, scene: SceneNumbers, state: State, action: Array, time: float, dt: float) -> float:
        """The torque over its limit, unclipped, in plain Python; ``action`` as of :meth:`checked`, shape (n,).

        Raises:
            TypeError: the function returns no number.
        """
        chosen: Any = tuple(action.tolist()) if self.size else int(action[0])
        share = self.torque(scene, state, chosen, time, dt)
        if not isinstance(share, Real):
            raise TypeError(f"an action's torque must return a number, got {check.shown(share)}")
        return float(share)


def clipped_share(share: float) -> float:
    """A share of the torque limit within [-1, 1].

    Raises:
        TaskError: it is NaN.
    """
    if share != share:
        raise TaskError("the action's torque must be a number, got nan")
    return max(-1.0, min(1.0, share))


def torque_share(scene: SceneNumbers, state: State, action: tuple[float], time: float, dt: float) -> float:
    """The action itself."""
    return action[0]


def landing_share(scene: SceneNumbers, state: State, action: tuple[float, float], time: float, dt: float) -> float:
    """Towards the box's angle over ``ANGLE`` and its rate over ``RATE`` at the landing, see ``landing.aim``."""
    return aim(scene, state, action[0] * ANGLE, action[1] * RATE, dt)


def discrete_share(scene: SceneNumbers, state: State, action: int, time: float, dt: float) -> float:
    """-1, 0 or 1 for the actions 0, 1 and 2."""
    return action - 1.0


ACTIONS = {
    "torque": Action(gym.spaces.Box(-1.0, 1.0, (1,)), torque_share),
    "landing": Action(gym.spaces.Box(-1.0, 1.0, (2,)), landing_share),
    "discrete": Action(gym.spaces.Discrete(3), discrete_share),
}


def action_of(action: str | Action) -> Action:
    """The action of that name, or a checked Action.

    Raises:
        TypeError, ValueError: an unknown name; another space than a one-dimensional Box or a Discrete from 0; something
            else than a function.
    """
    if isinstance(action, str):
        return ACTIONS[check.choice("action", action, ACTIONS)]
    if not isinstance(action, Action):
        listed = ", ".join(repr(name) for name in ACTIONS)
        raise TypeError(f"action must be one of {listed}, or a jackbox_env.Action, got {check.shown(action)}")
    space = action.space
    box = isinstance(space, gym.spaces.Box) and len(space.shape) == 1 and space.shape[0] > 0
    if not (box or (isinstance(space, gym.spaces.Discrete) and space.start == 0)):
        wanted = "a Box of shape (n,) or a Discrete that starts at 0"
        error = ValueError if isinstance(space, gym.Space) else TypeError
        raise error(f"an action's space must be {wanted}, got {check.shown(space)}")
    if not isinstance(action.torque, FunctionType):
        raise TypeError(f"an action's torque must be a plain Python function, got {check.shown(action.torque)}")
    return action


Repeats = int | Literal["bounce"]


class Repeat(NamedTuple):
    """The duration of an action."""

    steps: int  # control steps, at most
    max_contact_steps: int  # after which an impact ends it in any case, see landing.ends_decision; 0: no impact ends it


def repeat_of(action_repeat: Repeats, control_dt: float) -> Repeat:
    """The duration of an action: a number of control steps, or ``"bounce"``.

    Raises:
        TypeError, ValueError: something else, or out of its range.
    """
    if isinstance(action_repeat, str):
        if action_repeat != "bounce":
            limit = f"a whole number from 1 to {_MOST_REPEATS}"
            raise ValueError(f'action_repeat must be "bounce" or {limit}, got {check.shown(action_repeat)}')
        check.real('control_dt with action_repeat="bounce"', control_dt, at_least=_FASTEST)
        return Repeat(max(1, round(DECISION / control_dt)), max(1, round(RESTING / control_dt)))
    return Repeat(check.whole("action_repeat", action_repeat, at_least=1, at_most=_MOST_REPEATS), 0)


def most_decisions(episode_steps: int | None, action_repeat: Repeats) -> float:
    """The most decisions that an episode of so many control steps may have; infinite without a limit."""
    shortest = 1 if isinstance(action_repeat, str) else action_repeat
    return math.inf if episode_steps is None else -(-episode_steps // shortest)


def decisions_of(episode_steps: int | None, action_repeat: Repeats, max_episode_steps: int | None = None) -> int | None:
    """Decisions after which an episode is truncated; None: there is no such number.

    Args:
        episode_steps: control steps of an episode; None: no limit.
        action_repeat: control steps of a decision, or ``"bounce"``.
        max_episode_steps: at most that many decisions; -1 if there is no limit; None: as ``episode_steps`` implies.

    Raises:
        TypeError, ValueError: ``max_episode_steps`` is something else, or more than ``episode_steps`` implies.
    """
    most = most_decisions(episode_steps, action_repeat)
    if max_episode_steps is None:
        return None if most == math.inf or isinstance(action_repeat, str) else int(most)
    if most == math.inf and isinstance(max_episode_steps, int | np.integer) and max_episode_steps == -1:
        return None
    name = f"max_episode_steps (shortens an episode of episode_steps={episode_steps})"
    return check.whole(name, max_episode_steps, at_least=1, at_most=int(min(most, MOST_STEPS)))
