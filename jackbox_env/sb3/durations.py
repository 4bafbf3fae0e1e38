"""Discounting by elapsed time, for decisions of different durations, with any algorithm of Stable-Baselines3.

With ``action_repeat="bounce"`` a decision lasts until an impact. With one discount per decision an agent would prefer
long ones.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.vector.utils import concatenate, create_empty_array

from jackbox_env.tools import checks as check

with check.extra("jackbox_env.sb3", "Stable-Baselines3", "train"):
    import torch
    from stable_baselines3.common.buffers import ReplayBuffer, RolloutBuffer
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.type_aliases import ReplayBufferSamples


class Durations(BaseCallback):
    """Discounts by elapsed time: a model's ``gamma`` is then per second, not per decision.

    ``PPO("MlpPolicy", envs, gamma=0.72).learn(100_000, callback=Durations())`` discounts by 0.72 a second. It is for
    each algorithm of Stable-Baselines3 and sb3_contrib with a discount, and for the environments of
    :func:`jackbox_env.sb3.make_sb3_vec_env`, or others whose infos have ``duration`` [s]. Pass it to each call of
    ``learn`` from the first one on.

    The discounts are those of a semi-Markov decision process: Bradtke & Duff 1995, "Reinforcement learning methods for
    continuous-time Markov decision problems". Advantages are estimated with them as in Schulman et al. 2016,
    "High-dimensional continuous control using generalized advantage estimation", eq. 16.
    """

    def _init_callback(self) -> None:
        """Let the model's buffer discount by duration.

        Raises:
            TypeError: the model has no discount, or a buffer of another kind.
            ValueError: the model has transitions without durations.
        """
        model: Any = self.model
        if not hasattr(model, "gamma"):
            raise TypeError(f"{type(model).__name__} has no discount: train it without Durations")
        buffer = getattr(model, "rollout_buffer", None) or model.replay_buffer
        kind = type(buffer)
        if isinstance(buffer, RolloutBuffer) and not isinstance(buffer, _RolloutByDuration):
            buffer.__class__ = type(kind.__name__, (_RolloutByDuration, kind), {})
        elif kind is ReplayBuffer and not buffer.optimize_memory_usage:
            if buffer.size():
                raise ValueError(f"Durations must be used from the first step on, got a model of {buffer.size()} steps")
            buffer.__class__ = _ReplayByDuration
            buffer.durations = np.ones_like(buffer.rewards)
        elif not isinstance(buffer, _RolloutByDuration | _ReplayByDuration):
            needed = "a ReplayBuffer with n_steps=1 and without optimize_memory_usage"
            raise TypeError(f"Durations needs {needed}, got {kind.__name__}")
        buffer.gamma = model.gamma  # a loaded buffer has that of another model
        self.training_env.unwrapped.discounted = True  # type: ignore[attr-defined]

    def _on_step(self) -> bool:
        """Pass a decision's durations on, and add to rewards the values after the time limit, in one evaluation.

        PPO would evaluate these one by one, and discount them by ``gamma`` alone.
        """
        model: Any = self.model
        infos = self.locals["infos"]
        if not isinstance(buffer := getattr(model, "rollout_buffer", None), _RolloutByDuration):
            return True
        durations = _durations_of(infos)
        buffer.durations[buffer.pos] = durations
        cut = [number for number, info in enumerate(infos) if info.get("TimeLimit.truncated", False)]
        if cut:
            space, seen = model.observation_space, [infos[number]["terminal_observation"] for number in cut]
            rows: Any = create_empty_array(space, len(seen))
            last = model.policy.obs_to_tensor(concatenate(space, seen, rows))[0]
            memory = list[Any]()
            if "lstm_states" in self.locals:  # of RecurrentPPO
                memory += [
                    tuple(part[:, cut].contiguous() for part in self.locals["lstm_states"].vf),
                    torch.zeros(len(cut), device=model.device),
                ]
            with torch.no_grad():
                values = model.policy.predict_values(last, *memory).cpu().numpy().ravel()
            self.locals["rewards"][cut] += model.gamma ** durations[cut] * values
            for number in cut:
                infos[number]["TimeLimit.truncated"] = False  # it is accounted for
        return True


def _durations_of(infos: list[dict[str, Any]]) -> Any:
    """The durations of a decision of each environment [s], shape (environments,)."""
    try:
        return np.array([info["duration"] for info in infos])
    except KeyError as error:
        raise ValueError("Durations needs environments whose infos have 'duration', got infos without") from error


class _RolloutByDuration(RolloutBuffer):
    """A rollout buffer whose discount of a decision is ``gamma`` to the power of its duration."""

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


class _ReplayByDuration(ReplayBuffer):
    """A replay buffer whose samples have ``gamma`` to the power of the decision's duration as their discount."""

    gamma: float
    durations: Any  # [s], (size, environments)

    def add(self, obs: Any, next_obs: Any, action: Any, reward: Any, done: Any, infos: list[dict[str, Any]]) -> None:
        """Add a transition of each environment."""
        self.durations[self.pos] = _durations_of(infos)
        super().add(obs, next_obs, action, reward, done, infos)

    def _get_samples(self, batch_inds: Any, env: Any = None) -> ReplayBufferSamples:
        """Samples of ReplayBuffer, with discounts."""
        chosen = batch_inds, np.random.randint(0, self.n_envs, size=len(batch_inds))  # noqa: NPY002 - of its seed
        columns = (
            self._normalize_obs(self.observations[chosen], env),
            self.actions[chosen],
            self._normalize_obs(self.next_observations[chosen], env),
            (self.dones[chosen] * (1.0 - self.timeouts[chosen]))[:, None],
            self._normalize_reward(self.rewards[chosen][:, None], env),
            self.gamma ** self.durations[chosen][:, None],
        )
        return ReplayBufferSamples(*map(self.to_torch, columns))
