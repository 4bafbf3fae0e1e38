"""Discounting by elapsed time: the buffer against Stable-Baselines3's, and the values after the time limit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback

from agents.training.durations import DurationBuffer, Durations
from agents.training.models import make_ppo, make_vec_env, wrapped
from tests.agents.small_run import TINY

# Without gravity nothing is struck, so that each decision lasts 2 s, and each episode has five.
FLOATING = replace(
    TINY, contact="exact", landing=True, repeat="bounce", scene='{"gravity": 0}', gamma=0.8, num_envs=4,
    rollout_steps=12, total_steps=48, batch_size=16,
)  # fmt: skip


def filled(kind: Any, gamma: float, durations: Any = None) -> Any:
    rng, space = np.random.default_rng(0), make_vec_env(TINY.env_settings, 1, 0)
    buffer = kind(7, space.observation_space, space.action_space, "cpu", gae_lambda=0.9, gamma=gamma, n_envs=3)
    buffer.reset()
    for _ in range(7):
        values, logs = torch.from_numpy(rng.normal(size=(2, 3)).astype(np.float32))
        buffer.add(
            rng.normal(size=(3, 10)), rng.normal(size=(3, 1)), rng.normal(size=3), rng.random(3) < 0.3, values, logs
        )
    if durations is not None:
        buffer.durations[:] = durations
    last = torch.from_numpy(rng.normal(size=(3, 1)).astype(np.float32))
    buffer.compute_returns_and_advantage(last, np.array([False, True, False]))
    return buffer


def test_equal_durations_are_one_discount_per_decision() -> None:
    ours, theirs = filled(DurationBuffer, 0.8, 1.5), filled(RolloutBuffer, 0.8**1.5)
    np.testing.assert_allclose(ours.advantages, theirs.advantages, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(ours.returns, theirs.returns, rtol=1e-5, atol=1e-6)
    other = filled(DurationBuffer, 0.8, np.linspace(0.2, 2.0, 21).reshape(7, 3))
    assert abs(other.advantages - theirs.advantages).max() > 0.01


def test_durations_that_are_missing_are_an_error() -> None:
    with pytest.raises(RuntimeError, match="train with the callback Durations"):
        filled(DurationBuffer, 0.8)


def test_values_after_the_time_limit_are_discounted_as_ppo_does() -> None:
    learnt = list[torch.Tensor]()
    ours: list[BaseCallback] = [Durations()]
    plain: dict[str, Any] = {"rollout_buffer_class": RolloutBuffer}
    for gamma, more, callbacks in ((0.8, {}, ours), (0.8**2, plain, []), (0.8, plain, [])):
        settings = replace(FLOATING, gamma=gamma)
        model = make_ppo(settings, wrapped(make_vec_env(settings.env_settings, 4, 0), settings), **more)
        model.learn(96, callback=callbacks)
        learnt.append(torch.cat([weight.flatten() for weight in model.policy.state_dict().values()]))
    torch.testing.assert_close(learnt[0], learnt[1], rtol=1e-5, atol=1e-6)
    assert (learnt[0] - learnt[2]).abs().max() > 1e-4
