"""The differentiable step against PyTorch's finite differences and against the environment."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
import torch

import jackbox_env.torch
from jackbox_env import Scene, rollout
from tests.states import inside, started

SCENES = [Scene(jack_mass=mass, torque_limit=limit) for mass, limit in ((4.0, 9e4), (7.0, 5e4))] * 4


def inputs(scenes: list[Scene], seed: int, dt: float) -> tuple[torch.Tensor, torch.Tensor, np.ndarray]:
    """States and shares, and the number of impacts of each row."""
    rng = np.random.default_rng(seed)
    states, shares = np.array([inside(one, rng, 20.0) for one in scenes]), rng.uniform(-0.9, 0.9, len(scenes))
    torques = (shares * [one.torque_limit for one in scenes])[:, None]
    hits = rollout(scenes, states, torques, dt, impacts=True, rewards="juggle").impacts
    assert hits is not None
    return torch.tensor(states, requires_grad=True), torch.tensor(shares, requires_grad=True), hits[:, 0]


@pytest.mark.parametrize("task", ["juggle", "spin"])
def test_gradients_equal_differences_an_impact_among_them(task: str) -> None:
    states, shares, hits = inputs(SCENES, 6, 0.1)
    assert (hits > 0).any()
    assert (hits == 0).any()

    def step(states: torch.Tensor, shares: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        next_states, rewards, smooth = jackbox_env.torch.step(SCENES, states, shares, 0.1, task=task)
        assert smooth.all()
        return next_states, rewards

    assert torch.autograd.gradcheck(step, (states, shares), atol=1e-9)


@pytest.mark.parametrize("task", ["juggle", "spin"])
def test_states_and_rewards_are_the_environments(task: str) -> None:
    env = started(gym.make("JackInBox-v0", contact="exact", task=task), seed=0)
    state = torch.tensor(env.unwrapped.state)[None]  # type: ignore[attr-defined]
    for action in np.linspace(-1.5, 1.5, 100):
        state, reward, _ = jackbox_env.torch.step(None, state, torch.tensor([action]), task=task)
        _, expected, *_ = env.step(np.array([action]))
        np.testing.assert_array_equal(state[0].numpy(), env.unwrapped.state)  # type: ignore[attr-defined]
        assert reward.item() == expected


def test_a_row_without_a_derivative_counts_as_0() -> None:
    floor = [0.0] * 4 + [-5.0] + [0.0] * 5 + [-1.0, 0.0]  # an impact at the start
    states = torch.tensor([[0.0] * 12, floor], dtype=torch.float64, requires_grad=True)
    shares = torch.tensor([0.1, 0.1], dtype=torch.float64, requires_grad=True)
    with torch.no_grad():
        assert jackbox_env.torch.step(None, states, shares)[2].tolist() == [True, False]
    next_states, rewards, smooth = jackbox_env.torch.step(None, states, shares, nonsmooth="zero")
    (next_states.sum() + rewards.sum()).backward()
    assert smooth.tolist() == [True, False]
    for gradient in (states.grad, shares.grad):
        assert gradient is not None
        assert (gradient[0] != 0.0).any()
        assert (gradient[1] == 0.0).all()
