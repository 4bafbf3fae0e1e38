"""Rollouts of decisions, and the fitting of networks, for :mod:`.distil`, :mod:`.value` and :mod:`.vine`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from agents.policies.network import Layer
from agents.policies.value import UNIT, Value
from jackbox_env import Rollout, Scene, Task, rollout
from jackbox_env.model.states import OMEGA_BOX, OMEGA_JACK, THETA_BOX, THETA_JACK, VX_BOX, VX_JACK, X_BOX, X_JACK, Array
from jackbox_env.model.tasks import sample_start

SCENE, CONTROL_DT, REPEAT = Scene(drive=None), 0.02, 5  # of all rollouts; [s]; control steps of a decision
EPISODE = 100  # decisions
BATCH = 512
# Components that change sign if left and right are exchanged.
_MIRRORED = np.array([X_BOX, THETA_BOX, X_JACK, THETA_JACK, VX_BOX, OMEGA_BOX, VX_JACK, OMEGA_JACK])


def starts(count: int, rng: np.random.Generator) -> Array:
    """States that episodes start in, shape (count, 12)."""
    return np.array([sample_start(SCENE, rng) for _ in range(count)]).reshape(-1, 12)


def advanced(task: str | Task, states: Array, acting: NDArray[Any]) -> tuple[Array, Array, NDArray[np.bool_]]:
    """States a decision later, shape (n, 12), the rewards, (n,), and which jacks struck a wall, (n,).

    ``acting`` has a torque for each, (n,), in units of the limit, beyond which it is clipped.
    """
    torques = np.clip(acting, -1.0, 1.0)[:, None] * SCENE.torque_limit
    played = rollout(
        SCENE, states, torques, CONTROL_DT, impacts=True, rewards=task, repeat=REPEAT, trajectories=False, num_threads=1
    )
    assert isinstance(played, Rollout)
    assert played.impacts is not None
    return played.trajectories[:, 1].copy(), played.rewards.sum(axis=1), played.impacts.sum(axis=1) > 0


def mean_return(task: str, states: Array, act: Callable[[Array], NDArray[Any]]) -> float:
    """Mean return of an episode from each of these states, by a policy's torques in units of the limit."""
    total = 0.0
    for _ in range(EPISODE):
        states, rewards, _ = advanced(task, states, act(states))
        total += float(rewards.mean())
    return total


def mirrored(states: Array) -> Array:
    """The states with left and right exchanged, shape (n, 12): their motion is mirrored too, under opposite torques."""
    other = states.copy()
    other[:, _MIRRORED] *= -1.0
    return other


def network(layers: list[Layer]) -> Any:
    """A network of torch that starts as these layers."""
    parts: list[Any] = []
    for weight, bias in layers:
        linear = torch.nn.Linear(weight.shape[1], weight.shape[0])
        linear.weight.data[:], linear.bias.data[:] = torch.from_numpy(weight), torch.from_numpy(bias)
        parts += [torch.nn.Tanh(), linear] if parts else [linear]
    return torch.nn.Sequential(*parts)


def layers_of(net: Any) -> list[Layer]:
    """Copies of the layers of such a network."""
    return [(part.weight.detach().numpy().copy(), part.bias.detach().numpy().copy()) for part in net[::2]]


def inputs_and_goals(value: Value, states: Array, worth: Array) -> tuple[torch.Tensor, torch.Tensor]:
    """A network's inputs for states, shape (n, 12), and their mirror images, and the outputs that it should have."""
    inputs = np.concatenate([value.inputs(states), value.inputs(mirrored(states))])
    return torch.from_numpy(inputs), torch.from_numpy(np.tile(worth / UNIT, 2).astype(np.float32))[:, None]


def epoch(
    net: Any, optimiser: Any, inputs: torch.Tensor, goals: torch.Tensor, after: Callable[[], object] = lambda: None
) -> list[float]:
    """Go once through all inputs in a random order; return the mean squared errors of the batches."""
    errors = list[float]()
    for batch in torch.randperm(len(inputs))[: len(inputs) // BATCH * BATCH].reshape(-1, BATCH):
        optimiser.zero_grad()
        loss = torch.nn.functional.mse_loss(net(inputs[batch]), goals[batch])
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        after()
        errors.append(loss.item())
    return errors
