"""The scripts that make the policies `distilled`, made small."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
import torch

from agents.policies.network import SHIPPED
from agents.policies.value import read_value
from agents.training import distil, vine
from agents.training.fitting import REPEAT, SCENE, network, starts
from jackbox_env import rollout
from jackbox_env.model.tasks import TASKS


def test_fitting_comes_closer() -> None:
    value, states = read_value(SHIPPED / "juggle-value"), starts(600, np.random.default_rng(0))
    net, batches = network(value.layers), deque([(states, value.of(states) + 20.0)])
    errors = [distil.fit(net, value, batches, 1e-3) for _ in range(16)]
    assert errors[-1] < 0.5 * errors[0]


# -- spin and rattle ---------------------------------------------------------------------------------------------------

SMALL = (16,)


def nets() -> tuple[Any, Any]:
    torch.manual_seed(0)
    return vine.network(SMALL), vine.network(SMALL)


def test_the_worth_of_a_torque_is_the_return_of_the_torque_and_then_the_network() -> None:
    (net, critic), rng = nets(), np.random.default_rng(0)
    recipe = vine.RECIPES["rattle"]._replace(symmetric=False, ahead=1, discount=0.0, task=TASKS["spin"])
    states = starts(40, rng)
    states[:, 11] = 5.0  # so that a torque matters at once
    judged = vine.judged(net, critic, recipe, states, rng)
    np.testing.assert_allclose(judged.advantages.mean(dim=1), 0.0, atol=1e-5)
    torques = np.clip(judged.tried.numpy().astype(float), -1.0, 1.0).reshape(-1, 1) * SCENE.torque_limit
    played = rollout(SCENE, np.repeat(states, vine.TRIES, axis=0), torques, 0.02, rewards="spin", repeat=REPEAT)
    earned = played.rewards.sum(axis=1).reshape(40, vine.TRIES)
    assert np.abs(vine.UNIT * judged.worth.numpy()[:, 0] - earned.mean(axis=1)).max() < 1e-5
