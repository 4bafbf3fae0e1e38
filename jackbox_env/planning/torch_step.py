"""One control step of the exact model as a differentiable function of PyTorch: extra ``train``."""

from __future__ import annotations

from typing import Any

import numpy as np

from jackbox_env.tools import checks as check

with check.extra("jackbox_env.torch", "torch", "train"):
    import torch
    from torch import Tensor

from jackbox_env.model.scene import SceneNumbers, scenes_of
from jackbox_env.model.tasks import SLOPES
from jackbox_env.planning.linearization import linearize
from jackbox_env.planning.rollouts import OneOrMore, rollout


def step(
    scene: OneOrMore, states: Tensor, actions: Tensor, dt: float = 0.02, *, task: str = "juggle",
    nonsmooth: str = "raise",
) -> tuple[Tensor, Tensor, Tensor]:  # fmt: skip
    """One control step of an environment with ``fidelity="exact"``, differentiable by PyTorch.

    Not supported: ``torch.func``, ``torch.vmap``, ``torch.compile``, second derivatives.

    >>> states = torch.zeros(1, 12, dtype=torch.float64)
    >>> actions = torch.zeros(1, requires_grad=True)
    >>> next_states, rewards, smooth = step({"box_inertia": 9000.0}, states, actions)
    >>> next_states[0, 8].backward()  # the box's rate, after 0.02 s at up to 10 rad/s^2
    >>> round(actions.grad.item(), 6)
    0.2

    Args:
        scene: a Scene, a dict of some of its fields, or None; or a list of N. Its drive's side forces act, at time 0.
        states: shape (N, 12).
        actions: shape (N,) or (N, 1), shares of the torque limit; finite. They are clipped to [-1, 1], and the gradient
            of a clipped one is 0.
        dt: control step [s].
        task: whose reward is returned, "juggle" or "spin"; its gradient is 0 at kinks of the reward.
        nonsmooth: for rows without a derivative (see :class:`jackbox_env.Linearization`), if one is needed: "raise" an
            error, or use "zero".

    Returns:
        Next states, (N, 12), rewards, (N,), both float64, and which rows have a derivative, (N,), bool.

    Raises:
        TypeError, ValueError: unusable values; with "raise", a row without a derivative that is needed.
        JackLostError: a jack moves too fast to be followed.
    """
    check.choice("task", task, SLOPES)
    check.choice("nonsmooth", nonsmooth, ("raise", "zero"))
    for name, tensor in (("states", states), ("actions", actions)):
        if not (isinstance(tensor, Tensor) and tensor.is_floating_point()):
            raise TypeError(f"{name} must be a torch.Tensor of floats, got {check.shown(tensor)}")
    if states.ndim != 2 or states.shape[1] != 12 or actions.shape not in ((len(states),), (len(states), 1)):
        shapes = tuple(states.shape), tuple(actions.shape)
        raise ValueError(
            f"states and actions must have shapes (N, 12) and (N,) or (N, 1), got {shapes[0]}, {shapes[1]}"
        )
    shares = actions.reshape(-1).to("cpu", torch.float64)
    if not (finite := shares.isfinite()).all():
        raise ValueError(f"actions must be finite numbers (clipped to [-1, 1]), got {shares[~finite][0].item()}")
    shares = shares.clamp(-1.0, 1.0)
    strict = nonsmooth == "raise" and torch.is_grad_enabled()
    outputs = _Step.apply(scene, states.to("cpu", torch.float64), shares, dt, task, strict)  # type: ignore[no-untyped-call]
    next_states, rewards, smooth = (one.to(states.device) for one in outputs)
    return next_states, rewards, smooth


class _Step(torch.autograd.Function):
    """The step, and its gradient by ``Linearization.vjp``."""

    @staticmethod
    def forward(
        ctx: Any, scene: OneOrMore, states: Tensor, shares: Tensor, dt: float, task: str, strict: bool
    ) -> tuple[Tensor, Tensor, Tensor]:
        """The step."""
        numbers = SceneNumbers(*np.array([one.numbers for one in scenes_of(scene)[0]]).T)  # each (1,) or (N,)
        torques = (shares.numpy() * numbers.torque_limit)[:, None]
        lin = linearize(scene, states.numpy(), torques, dt)
        smooth = lin.smooth[:, 0]
        if strict and any(ctx.needs_input_grad) and not smooth.all():
            without = np.flatnonzero(~smooth)
            raise ValueError(
                f"states must have a derivative, {len(without)} of {len(smooth)} have none, the first is "
                f'states[{without[0]}]; nonsmooth="zero" uses 0'
            )
        rewards = rollout(scene, states.numpy(), torques, dt, rewards=task).rewards[:, 0]
        ctx.linearized = lin, numbers, task
        has_derivative = torch.from_numpy(smooth.copy())
        ctx.mark_non_differentiable(has_derivative)
        return torch.from_numpy(lin.trajectories[:, 1].copy()), torch.from_numpy(rewards), has_derivative

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, by_states: Tensor, by_rewards: Tensor, _: Any) -> tuple[Tensor | None, ...]:
        """The gradient; 0 in rows that have none."""
        lin, numbers, task = ctx.linearized
        weights = np.zeros_like(lin.trajectories)
        weights[:, 1] = by_states.numpy() + by_rewards.numpy()[:, None] * SLOPES[task](numbers, lin.trajectories[:, 1])
        by_start, by_torque, _ = lin.vjp(weights)
        for gradient in (by_start, by_torque):
            gradient[~lin.smooth[:, 0]] = 0.0
        by_share = by_torque[:, 0] * numbers.torque_limit
        return None, torch.from_numpy(by_start), torch.from_numpy(by_share), None, None, None
