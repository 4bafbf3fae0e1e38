"""Actions that are held for several control steps: in training, and when a trained model plays.

A policy that decides every control step can hardly tell what one of its actions did. One that holds each action for a
few steps explores further and looks further ahead. It still plays in the ordinary environment, which asks it at every
control step.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

State = tuple[NDArray[Any], ...]


class HoldingVecEnv(VecEnvWrapper):
    """Environments that take one action for ``hold`` of their steps and give the sum of the rewards.

    Observation, done and info are those of the last of these steps. An ``episode`` in an info is the environments' own:
    its length is in their steps.

    Args:
        venv: the environments. Their episodes must last a multiple of ``hold`` steps.
        hold: steps that each action is held for.
    """

    def __init__(self, venv: VecEnv, hold: int) -> None:
        super().__init__(venv)
        self.hold = hold
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
            RuntimeError: an episode ended before the last of these steps.
        """
        total = np.zeros(self.num_envs)
        for taken in range(1, self.hold + 1):
            observations, rewards, dones, infos = self.venv.step(self._actions)
            total += rewards
            if taken < self.hold and dones.any():
                raise RuntimeError(
                    f"episodes must last a multiple of hold = {self.hold} steps, got one that ended {taken} steps "
                    "after an action was chosen"
                )
        return observations, total.astype(np.float32), dones, infos


class HoldingPPO(PPO):
    """PPO whose ``predict`` holds each action for ``hold`` calls; with 1 it is PPO.

    The state that ``predict`` returns holds the actions, float32, shape (n, 1), and for how many more calls each of
    them holds, shape (n,). Pass it back in, as ``evaluate_policy`` does. Without it every call chooses anew.
    """

    hold: int = 1

    def predict(
        self,
        observation: Any,
        state: State | None = None,
        episode_start: NDArray[Any] | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[Any], State | None]:
        """Return actions, shape (n, 1) for observations (n, 10) or (1,) for (10,), and the state for the next call.

        Args:
            observation: of one environment or of several; it counts where an action is chosen.
            state: what the last call returned; None: every environment chooses.
            episode_start: shape (n,), where an episode starts; an action is chosen there; None: nowhere.
            deterministic: choose the mean of the distribution instead of a sample.

        Raises:
            ValueError: a state of another number of environments.
        """
        if self.hold == 1:
            return super().predict(observation, state, episode_start, deterministic)
        rows = np.atleast_2d(observation)
        if state is None:
            actions, left = np.zeros((len(rows), 1), np.float32), np.zeros(len(rows), np.int64)
        else:
            actions, left = (np.array(part) for part in state)
        if len(left) != len(rows):
            raise ValueError(f"state must be that of {len(rows)} environments, as observation is, got {len(left)}")
        if episode_start is not None:
            left[np.broadcast_to(episode_start, left.shape).astype(bool)] = 0
        due = left == 0
        if due.any():
            actions[due] = super().predict(rows[due], deterministic=deterministic)[0]
            left[due] = self.hold
        return (actions.copy() if np.ndim(observation) == 2 else actions[0].copy()), (actions, left - 1)
