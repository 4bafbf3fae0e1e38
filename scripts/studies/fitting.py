"""Networks of torch that the studies fit to the worth of states."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from agents.policies.network import Layer
from agents.policies.observing import mirrored
from agents.policies.value import UNIT, Value
from jackbox_env.states import Array

BATCH = 512


def network(layers: list[Layer]) -> Any:
    """A network of torch that starts as these layers."""
    parts: list[Any] = []
    for weight, bias in layers:
        linear = torch.nn.Linear(weight.shape[1], weight.shape[0])
        linear.weight.data[:], linear.bias.data[:] = torch.from_numpy(weight), torch.from_numpy(bias)
        parts += [torch.nn.Tanh(), linear] if parts else [linear]
    return torch.nn.Sequential(*parts)


def layers_of(net: Any) -> list[Layer]:
    """The layers of such a network: copies."""
    return [(part.weight.detach().numpy().copy(), part.bias.detach().numpy().copy()) for part in net[::2]]


def seen_and_worth(value: Value, states: Array, worth: Array) -> tuple[torch.Tensor, torch.Tensor]:
    """What a network sees of states, shape (n, 12), and of their mirror images, and what it should say of them."""
    seen = np.concatenate([value.inputs(states), value.inputs(mirrored(states))])
    return torch.from_numpy(seen), torch.from_numpy(np.tile(worth / UNIT, 2).astype(np.float32))[:, None]


def epoch(
    net: Any, optimiser: Any, seen: torch.Tensor, goal: torch.Tensor, after: Callable[[], object] = lambda: None
) -> list[float]:
    """Go once through all that is seen, in an order that is drawn; return the squared errors of the batches."""
    missed = list[float]()
    for batch in torch.randperm(len(seen))[: len(seen) // BATCH * BATCH].reshape(-1, BATCH):
        optimiser.zero_grad()
        loss = torch.nn.functional.mse_loss(net(seen[batch]), goal[batch])
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        after()
        missed.append(loss.item())
    return missed
