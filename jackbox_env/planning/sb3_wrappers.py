"""Wrappers for environments of Stable-Baselines3: repeated actions, landing control, and look-ahead features."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from jackbox_env import checks as check
from jackbox_env.landing import Landings
from jackbox_env.planning.features import LookaheadOptions
from jackbox_env.planning.landing_control import Aiming, Period
from jackbox_env.planning.wrappers import Control, LookingAhead, repeated
from jackbox_env.sb3 import JackInBoxVecEnv

try:
    from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
    from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(check.extra_needed("jackbox_env.sb3_wrappers", "Stable-Baselines3", "train")) from error


class ControlledVecEnv(VecEnvWrapper):
    """Environments of Stable-Baselines3 under a control."""

    def __init__(self, venv: VecEnv, control: Control) -> None:
        super().__init__(venv, control.observation_space, control.action_space)
        self._control = control
        self._act: Any = np.zeros((self.num_envs, 1), dtype=np.float32)

    @property
    def stored(self) -> dict[str, Any]:
        """How a saved model acts, for JSON."""
        return self._control.stored

    def reset(self) -> Any:
        """Start an episode in each environment."""
        return self._control.observe(self.venv.reset(), True)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Store the actions, shape (N, k), for ``step_wait``."""
        self._act = self._control.act(actions)

    def step_wait(self) -> VecEnvStepReturn:
        """Repeat the actions and sum the rewards; a ``terminal_observation`` is one of the agents.

        Raises:
            RuntimeError: an episode ended before the last of these steps, in environments that are not of
                ``make_sb3_vec_env``.
            JackLostError: a jack, or one in a rollout, cannot be followed. After either, reset before the next step.
        """
        if isinstance(self.venv, JackInBoxVecEnv):
            self.venv.step_async(self._act, 1 if isinstance(self._act, Landings) else self._control.repeat)
            observations, rewards, dones, infos = self.venv.step_wait()
        else:
            observations, rewards, dones, infos = repeated(self.venv.step, self._act, self._control.repeat)
        ended = np.flatnonzero(dones)
        if isinstance(self._control, LookingAhead) and len(ended):
            last = np.stack([infos[number]["terminal_observation"] for number in ended.tolist()])
            for number, row in zip(ended.tolist(), self._control.appended(last, ended)[0], strict=True):
                infos[number] = infos[number].copy()
                infos[number]["terminal_observation"] = row
        return self._control.observe(observations, dones), rewards.astype(np.float32), dones, infos


class HoldingVecEnv(ControlledVecEnv):
    """Repeats each action for ``hold`` steps of the environments, and sums the rewards.

    Observation, done and info are those of the last of these steps. The length of an ``episode`` in an info is in steps
    of the environments.

    >>> from jackbox_env.sb3 import make_sb3_vec_env
    >>> envs = HoldingVecEnv(make_sb3_vec_env(4, contact="exact"), hold=20)
    >>> envs.reset().shape, envs.step(np.zeros((4, 1)))[1].shape
    ((4, 10), (4,))

    Args:
        venv: the environments. Those of :func:`jackbox_env.sb3.make_sb3_vec_env` may end at any step, which ends the
            repetition. Episodes of others must last a multiple of ``hold`` steps.
        hold: steps that each action is repeated for.
    """

    def __init__(self, venv: VecEnv, hold: int) -> None:
        super().__init__(venv, Control(check.whole("hold", hold, at_least=1)))


class LandingControlVecEnv(ControlledVecEnv):
    """:class:`jackbox_env.LandingControl` of environments of Stable-Baselines3.

    Args:
        venv: of :func:`jackbox_env.sb3.make_sb3_vec_env`.
        period: of an action [s], rounded to control steps; or "bounce".

    Raises:
        TypeError, ValueError: an argument out of its range, or other environments.
    """

    def __init__(self, venv: JackInBoxVecEnv, *, period: Period = 0.4) -> None:
        if not isinstance(venv, JackInBoxVecEnv):
            what = "the environments of make_sb3_vec_env, with other wrappers outside"
            raise TypeError(f"landing control needs {what}, got {check.shown(venv)}")
        super().__init__(venv, Aiming(venv.vector_env, period))


class LookaheadVecEnv(ControlledVecEnv):
    """:class:`jackbox_env.Lookahead` of environments of Stable-Baselines3.

    Args:
        venv: of :func:`jackbox_env.sb3.make_sb3_vec_env`, or of single environments. Episodes of the latter must last
            a multiple of ``hold`` steps. The others are those of :class:`jackbox_env.Lookahead`.

    Raises:
        TypeError, ValueError: an argument out of its range, or ``venv`` is not of ``JackInBox-v0``.
    """

    def __init__(
        self, venv: VecEnv, *, hold: int = 5, turns: int = 9, samples: int = 32, pieces: int = 32,
        follow: bool = False, seed: int = 0, num_threads: int | None = None,
    ) -> None:  # fmt: skip
        options = LookaheadOptions(hold, turns, samples, pieces, follow, seed, num_threads)
        super().__init__(venv, LookingAhead(venv, options))
