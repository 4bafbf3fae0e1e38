"""Norms of policy gradients through impacts: of the return on juggle over some horizons, by ``torch.step``.

Each row has a policy of its own: a network of 16 tanh units from the jack's position and velocity relative to the box,
both angles and both rates, in units of L, v0, v0 / L and v0 / l, to the torque. Its weights are random.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from tqdm import tqdm

import jackbox_env.torch
from jackbox_env import Scene
from jackbox_env.model.tasks import sample_start
from scripts.studies.derivatives.bounce import REDUCE
from scripts.studies.derivatives.lyapunov import UNITS

DT, ROWS, HIDDEN, FLOWN = 0.02, 256, 16, 50  # control step [s]; policies; units; steps before the first gradient
HORIZONS = (0.25, 0.5, 1.0, 2.0, 4.0)  # [s]


def norms(horizon: float) -> dict[str, Any]:
    """Median and 5 % and 95 % quantiles of the gradient's norm over a horizon [s], and how many rows have none."""
    rng = np.random.default_rng(0)
    states = torch.tensor(np.array([sample_start(Scene(), rng) for _ in range(ROWS)]))
    scale, reduce = torch.tensor(UNITS @ abs(REDUCE.T) / abs(REDUCE).sum(axis=1)), torch.tensor(REDUCE.T)
    first, last = (torch.tensor(rng.standard_normal(shape)) for shape in ((ROWS, 8, HIDDEN), (ROWS, HIDDEN, 1)))
    weights = [(first / 8**0.5).requires_grad_(), (last / HIDDEN**0.5).requires_grad_()]
    earned, differentiable = torch.zeros(ROWS, dtype=torch.float64), torch.ones(ROWS, dtype=torch.bool)
    for step in range(FLOWN + round(horizon / DT)):
        inner = torch.tanh((states @ reduce / scale)[:, None] @ weights[0])
        states, rewards, smooth = jackbox_env.torch.step(None, states, (inner @ weights[1])[:, 0], DT, nonsmooth="zero")
        if step < FLOWN:
            states = states.detach()  # leaves out the fall to the first impact
        else:
            earned, differentiable = earned + rewards, differentiable & smooth
    gradients = torch.autograd.grad(earned.sum(), weights)
    norm = torch.stack([part.flatten(1).norm(dim=1) for part in gradients]).norm(dim=0)[differentiable].numpy()
    low, middle, high = np.quantile(norm, (0.05, 0.5, 0.95)).tolist()
    return {"horizon": horizon, "low": low, "median": middle, "high": high, "without": int((~differentiable).sum())}


def measure() -> list[dict[str, Any]]:
    """The norms over each horizon."""
    return [norms(horizon) for horizon in tqdm(HORIZONS, desc="policy gradients", leave=False, disable=None)]
