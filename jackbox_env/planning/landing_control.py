"""Actions that say how the box meets the jack, in place of torques: for single and vector environments.

:class:`jackbox_env.sb3_wrappers.LandingControlVecEnv` is that for Stable-Baselines3. :mod:`jackbox_env.landing` has the
formulas.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike

from jackbox_env import checks as check
from jackbox_env.landing import landing_times, torques, upright
from jackbox_env.planning.features import Flags, Floats
from jackbox_env.planning.wrappers import changed_actions, refuse_other_torques
from jackbox_env.states import Array
from jackbox_env.vector_env import JackInBoxVectorEnv

SPACE = gym.spaces.Box(-1.0, 1.0, (2,))
SCALE = np.array([0.5, 2.5])  # [rad], [rad/s]


class Numbers(NamedTuple):
    """What of a scene it takes to aim, a number each or an array, shape (N,)."""

    box_half_width: Any
    box_inertia: Any
    jack_arm: Any
    gravity: Any
    torque_limit: Any
    speed_scale: Any


def steps_of(period: float, control_dt: float) -> int:
    """Control steps in a period [s], at least one.

    Raises:
        TypeError, ValueError: it is no number above 0, or of more than a million steps.
    """
    period = check.real("period", period, above=0.0, at_most=1e6 * control_dt)
    return max(1, round(period / control_dt))


def aim(scene: Any, control_dt: float, actions: ArrayLike, count: int) -> Callable[[Array], Array]:
    """The torques, shape (n,), in units of the limit, for states, shape (n, 12), that aim as ``actions`` say, (n, 2).

    Raises:
        TypeError, ValueError: unusable actions.
    """
    given = check.array("actions", actions, "hold numbers (clipped to [-1, 1])")
    if given.shape not in ((count, 2), (2,) * (count == 1)):
        raise ValueError(f"actions must have shape ({count}, 2), got {given.shape}")
    if not np.isfinite(given).all():
        raise ValueError(f"actions must be finite numbers (clipped to [-1, 1]), got {given[~np.isfinite(given)][0]}")
    targets = np.clip(given.astype(np.float64).reshape(count, 2), -1.0, 1.0) * SCALE

    def act(states: Array) -> Array:
        states = upright(states)
        return torques(scene, states, landing_times(scene, states), targets, control_dt)

    return act


class LandingControl(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Say in ``JackInBox-v0`` how the box shall meet the jack: its angle and rate at the landing that is foreseen.

    An action is two numbers: the box's angle over 0.5 rad, counted from the nearest quarter turn, and its rate over 2.5
    rad/s. It holds for ``period``, and the rewards of that time are summed. In each control step the torque is worked
    out anew: it turns the box along the cubic in time that ends so when the jack's centre falls to the height at which
    a foot pointing down touches a level box's floor. Walls on the way are not foreseen.

    Args:
        env: the environment, of either contact model. It takes actions as torques: no action wrapper inside, and
            ``torque="agent"``.
        period: of an action [s], rounded to control steps.

    Raises:
        TypeError, ValueError: an argument out of its range, or ``env`` is no ``JackInBox-v0``.
    """

    def __init__(self, env: gym.Env[Any, Any], *, period: float = 0.4) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, period=period)
        gym.Wrapper.__init__(self, env)
        inner: Any = env.unwrapped
        if not hasattr(inner, "torque_source"):
            raise TypeError(f"landing control needs JackInBox-v0, got {check.shown(env)}")
        refuse_other_torques([inner.torque_source], changed_actions(env))
        self._inner, self.hold = inner, steps_of(period, inner.control_dt)
        self.action_space = SPACE

    def step(self, action: Any) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """Aim for ``period``, less where the episode ends; the info is that of the last control step.

        Raises:
            TypeError, ValueError: an unusable action.
        """
        act, total = aim(self._inner.scene, self._inner.control_dt, action, 1), 0.0  # of this episode's scene
        for _ in range(self.hold):
            observation, reward, terminated, truncated, info = self.env.step(act(self._inner.state[None]))
            total += float(reward)
            if terminated or truncated:
                break
        return observation, total, terminated, truncated, info


class LandingControlVector(VectorWrapper):
    """:class:`LandingControl` of a native vector environment: the same in each of its environments.

    Args:
        env: of ``gymnasium.make_vec("JackInBox-v0", ...)``.
        period: of an action [s], rounded to control steps.

    Raises:
        TypeError, ValueError: an argument out of its range, or another environment.
    """

    env: JackInBoxVectorEnv

    def __init__(self, env: JackInBoxVectorEnv, *, period: float = 0.4) -> None:
        super().__init__(env)
        self._aiming = Aiming(env, period)
        self.single_action_space = SPACE
        self.action_space = batch_space(SPACE, env.num_envs)

    def step(self, actions: Any) -> tuple[Floats, Array, Flags, Flags, dict[str, Any]]:
        """Aim for ``period``, less where an episode ends, and sum up the rewards; see ``JackInBoxVectorEnv.step``.

        Raises:
            TypeError, ValueError: unusable actions.
        """
        return self.env.step(self._aiming.act(actions), self._aiming.hold)


class Aiming:
    """How the environments of a vector environment aim."""

    def __init__(self, env: Any, period: float) -> None:
        if not isinstance(env, JackInBoxVectorEnv):
            raise TypeError(f"landing control needs the vector environment of JackInBox-v0, got {check.shown(env)}")
        refuse_other_torques([env.torque_source], "")
        self.env, self.hold = env, steps_of(period, env.control_dt)

    def act(self, actions: Any) -> Callable[[Array], Array]:
        """What the environments do in each control step, for actions, shape (N, 2)."""
        scene = Numbers(*(self.env.field(name) for name in Numbers._fields))
        return aim(scene, self.env.control_dt, actions, self.env.num_envs)
