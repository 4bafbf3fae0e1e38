"""Landing control: actions are the box's angle and rate at the next landing, in place of torques.

For single and vector environments; ``sb3_wrappers.py`` has it for Stable-Baselines3. :mod:`jackbox_env.landing` has the
formulas.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike

from jackbox_env import checks as check
from jackbox_env.landing import landing_times, torques, upright
from jackbox_env.planning.wrappers import Control, ControlledEnv, ControlledVectorEnv, refuse_other_torques
from jackbox_env.states import Array
from jackbox_env.vector_env import JackInBoxVectorEnv

SPACE = gym.spaces.Box(-1.0, 1.0, (2,))
SCALE = np.array([0.5, 2.5])  # [rad], [rad/s]
# Fields of the scene that aiming needs.
_FIELDS = ("box_half_width", "box_inertia", "jack_arm", "gravity", "torque_limit", "speed_scale")


def aim(scene: Any, control_dt: float, actions: ArrayLike, count: int) -> Callable[[Array], Array]:
    """A function from states, shape (n, 12), to torques, (n,), in units of the limit, that aim at ``actions``, (n, 2).

    Raises:
        TypeError, ValueError: unusable actions.
    """
    numbers = check.array("actions", actions, "hold numbers (clipped to [-1, 1])")
    shapes = [(count, 2)] if count > 1 else [(1, 2), (2,)]
    if numbers.shape not in shapes:
        raise ValueError(f"actions must have shape {shapes[-1]}, got {numbers.shape}")
    if not np.isfinite(numbers).all():
        raise ValueError(
            f"actions must be finite numbers (clipped to [-1, 1]), got {numbers[~np.isfinite(numbers)][0]}"
        )
    targets = np.clip(numbers.astype(np.float64).reshape(count, 2), -1.0, 1.0) * SCALE

    def act(states: Array) -> Array:
        states = upright(states)
        return torques(scene, states, landing_times(scene, states), targets, control_dt)

    return act


class Aiming(Control):
    """Turns the landing targets of N agents into torques, anew in each control step.

    Args:
        env: a single environment or a native vector environment.
        period: of an action [s], rounded to control steps.

    Raises:
        TypeError, ValueError: a period out of its range, or actions that are not the torques.
    """

    action_space = SPACE

    def __init__(self, env: Any, period: float) -> None:
        refuse_other_torques("landing control", env)
        self._inner = env.unwrapped
        control_dt = self._inner.control_dt
        period = check.real("period", period, above=0.0, at_most=1e6 * control_dt)
        super().__init__(max(1, round(period / control_dt)))

    def act(self, actions: Any) -> Callable[[Array], Array]:
        """A function from states to the torques of a control step, for actions, shape (N, 2), or (2,) of one alone."""
        env = self._inner
        if not isinstance(env, JackInBoxVectorEnv):
            return aim(env.scene, env.control_dt, actions, 1)  # of this episode's scene
        scenes = SimpleNamespace(**{name: env.field(name) for name in _FIELDS})
        return aim(scenes, env.control_dt, actions, env.num_envs)


class LandingControl(ControlledEnv):
    """Control ``JackInBox-v0`` by the box's angle and rate at the predicted landing of the jack.

    An action is two numbers: the box's angle over 0.5 rad, counted from the nearest quarter turn, and its rate over 2.5
    rad/s. It is repeated for ``period``, and the rewards of that time are summed. In each control step the torque is
    computed anew: it turns the box along the cubic in time that reaches this angle and rate when the jack's centre
    falls to the height at which a foot pointing down touches a level box's floor. Walls on the way are ignored.

    Args:
        env: the environment, of either contact model. It takes actions as torques: no action wrapper inside, and
            ``torque="agent"``.
        period: of an action [s], rounded to control steps.

    Raises:
        TypeError, ValueError: an argument out of its range, or ``env`` is no ``JackInBox-v0``.
    """

    def __init__(self, env: gym.Env[Any, Any], *, period: float = 0.4) -> None:
        if not isinstance(env, gym.Env) or not hasattr(env.unwrapped, "torque_source"):
            raise TypeError(f"landing control needs JackInBox-v0, got {check.shown(env)}")
        super().__init__(env, Aiming(env, period), period=period)


class LandingControlVector(ControlledVectorEnv):
    """:class:`LandingControl` of a native vector environment: the same in each of its environments.

    Args:
        env: of ``gymnasium.make_vec("JackInBox-v0", ...)``.
        period: of an action [s], rounded to control steps.

    Raises:
        TypeError, ValueError: an argument out of its range, or another environment.
    """

    def __init__(self, env: JackInBoxVectorEnv, *, period: float = 0.4) -> None:
        if not isinstance(env, JackInBoxVectorEnv):
            raise TypeError(f"landing control needs the vector environment of JackInBox-v0, got {check.shown(env)}")
        super().__init__(env, Aiming(env, period))
