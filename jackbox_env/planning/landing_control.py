"""Landing control: an action is the box's angle and rate at the next landing, for single and vector environments.

:class:`jackbox_env.sb3_wrappers.LandingControlVecEnv` is the wrapper for Stable-Baselines3; :mod:`jackbox_env.landing`
has the formulas and the end of a decision.
"""

from __future__ import annotations

from typing import Any, Literal

import gymnasium as gym
import numpy as np

from jackbox_env import checks as check
from jackbox_env.landing import ANGLE, DECISION, RATE, Landings, steps_until_impact
from jackbox_env.planning.wrappers import Control, ControlledEnv, ControlledVectorEnv, refuse_other_torques
from jackbox_env.vector_env import JackInBoxVectorEnv

SPACE = gym.spaces.Box(-1.0, 1.0, (2,))
Period = float | Literal["bounce"]
_MOST_STEPS = 1e6  # control steps of a decision


class Aiming(Control):
    """Turns the actions of N agents into targets of landings.

    Args:
        env: a single environment or a native vector environment.
        period: of an action [s], rounded to control steps, or "bounce".

    Raises:
        TypeError, ValueError: a period out of its range, or actions that are not the torques.
    """

    action_space = SPACE

    def __init__(self, env: Any, period: Period) -> None:
        refuse_other_torques("landing control", env)
        inner = env.unwrapped
        self._count = inner.num_envs if isinstance(inner, JackInBoxVectorEnv) else 1
        control_dt, self._resting = inner.control_dt, 0
        if isinstance(period, str):
            if period != "bounce":
                limit = f"a number [s] above 0, at most {_MOST_STEPS * control_dt:g}"
                raise TypeError(f'period must be "bounce" or {limit}, got {check.shown(period)}')
            check.real('control_dt with period="bounce"', control_dt, at_least=DECISION / _MOST_STEPS)
            steps, self._resting = steps_until_impact(control_dt)
        else:
            period = check.real("period", period, above=0.0, at_most=_MOST_STEPS * control_dt)
            steps = max(1, round(period / control_dt))
        super().__init__(steps)
        self.stored = {"landing": period}

    def act(self, actions: Any) -> Landings:
        """Targets for actions, shape (N, 2), or (2,) of one alone.

        Raises:
            TypeError, ValueError: unusable actions.
        """
        values = check.array("actions", actions, "be numbers (clipped to [-1, 1])")
        shapes = [(self._count, 2)] if self._count > 1 else [(1, 2), (2,)]
        if values.shape not in shapes:
            raise ValueError(f"actions must have shape {shapes[-1]}, got {values.shape}")
        if not np.isfinite(values).all():
            raise ValueError(
                f"actions must be finite numbers (clipped to [-1, 1]), got {values[~np.isfinite(values)][0]}"
            )
        clipped = np.clip(values.astype(np.float64).reshape(self._count, 2), -1.0, 1.0)
        return Landings(clipped * np.array([ANGLE, RATE]), self.repeat, self._resting)


class LandingControl(ControlledEnv):
    """Choose for ``JackInBox-v0`` the box's angle and rate at the next landing, in place of torques.

    An action is two numbers: the box's angle over 0.5 rad, from the nearest quarter turn, and its rate over 2.5 rad/s.
    In each control step the torque is computed anew. It steers the box along a cubic in time that reaches that angle
    and rate when the jack's centre has fallen to where a foot pointing down touches a level box's floor. Walls on the
    way are ignored. The rewards of a decision are summed, and ``info["duration"]`` is how long it lasted [s].

    >>> env = LandingControl(gym.make("JackInBox-v0"), period=0.4)
    >>> observation, info = env.reset(seed=0)
    >>> observation, reward, terminated, truncated, info = env.step([0.1, 0.0])  # tilt the box by 0.05 rad, at rest
    >>> info["duration"]
    0.4

    With ``period="bounce"`` an action lasts until the jack's next impact:

    - Several impacts within a control step end one decision.
    - An impact ends a decision only after a control step without one, or once 0.4 s have passed. So a second foot that
      strikes in the next step does not end it, and while a foot rests, an impact in each step, a decision lasts 0.4 s.
    - Without an impact it ends after 2 s (without gravity, for instance), or after one control step if that is longer.
    - The end of an episode ends it, too.

    Args:
        env: the environment, of either contact model, with torques as actions: no action wrapper inside, and
            ``torque="agent"``.
        period: of an action [s], rounded to control steps; or "bounce".

    Raises:
        TypeError, ValueError: an argument out of its range, or ``env`` is no ``JackInBox-v0``.
    """

    def __init__(self, env: gym.Env[Any, Any], *, period: Period = 0.4) -> None:
        if not isinstance(env, gym.Env) or not hasattr(env.unwrapped, "torque_source"):
            raise TypeError(f"landing control needs JackInBox-v0, got {check.shown(env)}")
        super().__init__(env, Aiming(env, period), period=period)


class LandingControlVector(ControlledVectorEnv):
    """:class:`LandingControl` of a native vector environment: the same in each of its environments.

    With ``period="bounce"`` each environment steps to its next impact, so their times differ afterwards. An environment
    that restarts in a step (``autoreset_mode="NEXT_STEP"``) has the duration 0 there.

    >>> envs = LandingControlVector(JackInBoxVectorEnv(2, contact="exact"), period="bounce")
    >>> observations, infos = envs.reset(seed=0)
    >>> observations, rewards, terminated, truncated, infos = envs.step([[0.1, 0.0], [-0.1, 0.0]])
    >>> np.allclose(infos["duration"], envs.unwrapped.times)
    True

    Args:
        env: of ``gymnasium.make_vec("JackInBox-v0", ...)``.
        period: of an action [s], rounded to control steps; or "bounce".

    Raises:
        TypeError, ValueError: an argument out of its range, or another environment.
    """

    def __init__(self, env: JackInBoxVectorEnv, *, period: Period = 0.4) -> None:
        if not isinstance(env, JackInBoxVectorEnv):
            raise TypeError(f"landing control needs the vector environment of JackInBox-v0, got {check.shown(env)}")
        super().__init__(env, Aiming(env, period))
