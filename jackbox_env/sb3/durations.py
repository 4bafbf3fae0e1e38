"""Discounting by elapsed time, for decisions of different durations: a rollout buffer, and the callback it needs.

With ``action_repeat="bounce"`` a decision lasts until an impact. With one discount per decision an agent would prefer
long ones.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from jackbox_env.tools import checks as check

with check.extra("jackbox_env.sb3", "Stable-Baselines3", "train"):
    import torch
    from stable_baselines3.common.buffers import RolloutBuffer
    from stable_baselines3.common.callbacks import BaseCallback


class DurationBuffer(RolloutBuffer):
    """A rollout buffer whose discount of a decision is ``gamma`` to the power of its duration [s].

    ``PPO("MlpPolicy", envs, rollout_buffer_class=DurationBuffer, gamma=0.72)`` discounts by 0.72 a second. Train with
    the callback too: ``model.learn(100_000, callback=Durations())``. Environments are those of
    :func:`jackbox_env.sb3.make_sb3_vec_env`, or others whose infos have ``duration``.

    The advantage estimate is that of Schulman et al. 2016, "High-dimensional continuous control using generalized
    advantage estimation", eq. 16, with the discounts of a semi-Markov decision process: Bradtke & Duff 1995,
    "Reinforcement learning methods for continuous-time Markov decision problems". :class:`Durations` fills in the
    durations.
    """

    durations: Any  # [s], (steps, environments)

    def reset(self) -> None:
        """Empty the buffer."""
        self.durations = np.full((self.buffer_size, self.n_envs), np.nan, dtype=np.float32)
        super().reset()

    def compute_returns_and_advantage(self, last_values: Any, dones: Any) -> None:
        """Compute returns and advantages.

        Args:
            last_values: of the observations after the last decisions, shape (environments, 1).
            dones: whether those observations begin an episode, shape (environments,).

        Raises:
            RuntimeError: a duration is missing.
        """
        if np.isnan(self.durations).any():
            raise RuntimeError("the durations of decisions are missing: train with the callback Durations")
        discounts = self.gamma**self.durations
        values = np.concatenate([self.values, last_values.clone().cpu().numpy().reshape(1, -1)])
        going = 1.0 - np.concatenate([self.episode_starts[1:], dones.reshape(1, -1).astype(np.float32)])
        advantage = np.zeros(self.n_envs, dtype=np.float32)
        for step in reversed(range(self.buffer_size)):
            ahead = discounts[step] * going[step]
            error = self.rewards[step] + ahead * values[step + 1] - values[step]
            advantage = error + ahead * self.gae_lambda * advantage
            self.advantages[step] = advantage
        self.returns = self.advantages + self.values


class Durations(BaseCallback):
    """Writes the durations of decisions into the model's :class:`DurationBuffer`.

    It also bootstraps episodes that the time limit truncated, discounted by duration and in one evaluation, where PPO
    evaluates them one by one with one discount.
    """

    def _on_step(self) -> bool:
        model: Any = self.model
        buffer, infos = model.rollout_buffer, self.locals["infos"]
        durations = np.array([info["duration"] for info in infos])
        buffer.durations[buffer.pos] = durations
        cut = [number for number, info in enumerate(infos) if info.get("TimeLimit.truncated", False)]
        if cut:
            last = model.policy.obs_to_tensor(np.stack([infos[number]["terminal_observation"] for number in cut]))[0]
            with torch.no_grad():
                values = model.policy.predict_values(last).cpu().numpy().ravel()
            self.locals["rewards"][cut] += model.gamma ** durations[cut] * values
            for number in cut:
                infos[number]["TimeLimit.truncated"] = False  # it is accounted for
        return True
