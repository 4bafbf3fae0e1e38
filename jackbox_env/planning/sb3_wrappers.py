"""Wrappers for environments of Stable-Baselines3: actions that are held or aim at landings, and looking ahead."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from jackbox_env import checks as check
from jackbox_env.planning.features import Features, WarmStart
from jackbox_env.planning.landing_control import SPACE, Aiming
from jackbox_env.planning.wrappers import only_one, refuse_early_end, refuse_other_torques
from jackbox_env.sb3 import JackInBoxVecEnv

try:
    from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
    from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(check.extra_needed("jackbox_env.sb3_wrappers", "Stable-Baselines3", "train")) from error


class HoldingVecEnv(VecEnvWrapper):
    """Environments that take one action for ``hold`` of their steps and give the sum of the rewards.

    Observation, done and info are those of the last of these steps. An ``episode`` in an info is the environments' own:
    its length is in their steps.

    Args:
        venv: the environments. Those of :func:`jackbox_env.sb3.make_sb3_vec_env` may end at any step, which ends the
            hold. Episodes of others must last a multiple of ``hold`` steps.
        hold: steps that each action is held for.
    """

    def __init__(self, venv: VecEnv, hold: int) -> None:
        super().__init__(venv)
        self.hold = check.whole("hold", hold, at_least=1)
        self._actions: NDArray[Any] = np.zeros((self.num_envs, 1), dtype=np.float32)

    def reset(self) -> Any:
        """Start an episode in each environment."""
        return self.venv.reset()

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions, shape (N, 1), for ``step_wait``."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Step ``hold`` times.

        Raises:
            RuntimeError: an episode ended before the last of these steps, in environments that are not of
                ``make_sb3_vec_env``.
        """
        if isinstance(self.venv, JackInBoxVecEnv):
            self.venv.step_async(self._actions, self.hold)
            return self.venv.step_wait()
        total = np.zeros(self.num_envs)
        for taken in range(1, self.hold + 1):
            observations, rewards, dones, infos = self.venv.step(self._actions)
            total += rewards
            refuse_early_end(dones, taken, self.hold)
        return observations, total.astype(np.float32), dones, infos


class LandingControlVecEnv(VecEnvWrapper):
    """:class:`jackbox_env.LandingControl` of environments of Stable-Baselines3.

    Args:
        venv: of :func:`jackbox_env.sb3.make_sb3_vec_env`.
        period: of an action [s], rounded to control steps.

    Raises:
        TypeError, ValueError: an argument out of its range, or other environments.
    """

    venv: JackInBoxVecEnv

    def __init__(self, venv: JackInBoxVecEnv, *, period: float = 0.4) -> None:
        if not isinstance(venv, JackInBoxVecEnv):
            raise TypeError(f"landing control needs the environments of make_sb3_vec_env, got {check.shown(venv)}")
        super().__init__(venv, action_space=SPACE)
        self._aiming = Aiming(venv.vector_env, period)

    def reset(self) -> Any:
        """Start an episode in each environment."""
        return self.venv.reset()

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions, shape (N, 2), for ``step_wait``."""
        self.venv.step_async(self._aiming.act(actions), self._aiming.hold)

    def step_wait(self) -> VecEnvStepReturn:
        """Aim for ``period``, less where an episode ends, and sum up the rewards."""
        return self.venv.step_wait()


class LookaheadVecEnv(HoldingVecEnv):
    """:class:`jackbox_env.Lookahead` of environments of Stable-Baselines3.

    Args:
        venv: of :func:`jackbox_env.sb3.make_sb3_vec_env`, or of single environments. Episodes of the latter must last
            a multiple of ``hold`` steps.
        hold: control steps of a step here, 1 or more; more on all of these under
            :class:`jackbox_env.Lookahead`.
        turns: scripted rollouts, an odd number, or 0 for none.
        samples: variations of the plan that are tried in each step, 8 or more, or 0 for no plan.
        pieces: torques of a rollout, each held for ``hold`` control steps; 8 or more.
        follow: whether an action is added to the plan's next torque.
        seed: of the variations.
        num_threads: that play the rollouts; None: as many as the machine has. Nothing else depends on it.

    Raises:
        TypeError, ValueError: an argument out of its range, or ``venv`` is not of ``JackInBox-v0``.
    """

    def __init__(
        self, venv: VecEnv, *, hold: int = 5, turns: int = 9, samples: int = 32, pieces: int = 32,
        follow: bool = False, seed: int = 0, num_threads: int | None = None,
    ) -> None:  # fmt: skip
        try:
            task, control_dt = (only_one(name, venv.get_attr(name)) for name in ("task", "control_dt"))
        except AttributeError as error:
            raise TypeError(f"looking ahead needs JackInBox-v0, got {check.shown(venv)}") from error
        if follow is True:
            wrapper = "an action wrapper" * any(venv.env_is_wrapped(gym.ActionWrapper))
            refuse_other_torques(venv.get_attr("torque_source"), wrapper)
        super().__init__(venv, hold)
        features = Features(
            task, control_dt, hold=hold, turns=turns, samples=samples, pieces=pieces, follow=follow, seed=seed,
            num_threads=num_threads,
        )  # fmt: skip
        self.observation_space = features.space(venv.observation_space)
        self._warm = WarmStart(features, self.num_envs)

    def reset(self) -> Any:
        """Start an episode in each environment."""
        observations = self.venv.reset()
        self._warm.start(np.ones(self.num_envs, dtype=np.bool_))
        return self._warm.seen(self.venv.get_attr("scene"), observations)  # type: ignore[arg-type]

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the torques that the actions, shape (N, 1), stand for."""
        self._actions = self._warm.torques(actions)

    def step_wait(self) -> VecEnvStepReturn:
        """Step ``hold`` times and look ahead; the ``terminal_observation`` of an episode's end looks ahead too.

        Raises:
            RuntimeError: as that of :class:`HoldingVecEnv`.
            JackLostError: a jack, or one in a rollout, cannot be followed. After either, reset before the next step.
        """
        scenes = self.venv.get_attr("scene")  # those of the episodes that may end now
        observations, rewards, dones, infos = super().step_wait()
        ended = np.flatnonzero(dones)
        if len(ended):
            last = np.stack([infos[number]["terminal_observation"] for number in ended.tolist()])
            for number, row in zip(ended.tolist(), self._warm.last_seen(scenes, last, ended), strict=True):
                infos[number] = {**infos[number], "terminal_observation": row}
            self._warm.start(dones)
        return self._warm.seen(self.venv.get_attr("scene"), observations), rewards, dones, infos  # type: ignore[arg-type]
