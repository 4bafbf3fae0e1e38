"""Networks of torch that :mod:`.distil` and :mod:`.value` fit to values of states."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from agents.policies.network import Layer
from agents.policies.value import UNIT, Value
from jackbox_env.model.states import OMEGA_BOX, OMEGA_JACK, THETA_BOX, THETA_JACK, VX_BOX, VX_JACK, X_BOX, X_JACK, Array

BATCH = 512
# Components that change sign if left and right are exchanged.
_MIRRORED = np.array([X_BOX, THETA_BOX, X_JACK, THETA_JACK, VX_BOX, OMEGA_BOX, VX_JACK, OMEGA_JACK])


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
