"""Make a network that plays spin or rattle without a planner: it learns from exact rollouts of its own torques.

In each round the network plays with some noise. From each visited state a few torques are tried for one decision. Then
the network plays on for some decisions, and a learnt value stands for the rest. So torques are compared from the same
state, by rollouts without noise ("vine" of Schulman et al. 2015, arXiv:1502.05477). PPO's clipped loss makes the better
ones more likely. The policy is the running mean of the network.

A round takes about 2 s of one core. The folder has a policy from the first round on, so Ctrl-C leaves one. Seeded: the
same numbers on the same machine.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from tqdm import trange

from agents.policies.network import write_with_layers
from agents.policies.value import INPUTS
from agents.runs import SETTINGS
from agents.settings import TrainSettings
from agents.training.fitting import EPISODE, REPEAT, SCENE, advanced, layers_of, mean_return, mirrored, starts
from jackbox_env import Task
from jackbox_env.model.states import Array
from jackbox_env.model.tasks import TASKS
from jackbox_env.simulators.agent_functions import observed
from jackbox_env.tools.command_line import command_line

WIDTHS, CRITIC, FIRST_SCALE = (256, 256), (128, 128), 3.0  # layers; factor of the first one's weights
JACKS, DECISIONS = 512, 16  # side by side; of each in a round
TRIES, SPREAD, NOISY = 4, 0.3, 0.2  # torques from a state; their deviation [limits]; share of noisy decisions
CLIP, EPOCHS, BATCH = 0.2, 4, 1024
RATE, LAST_SHARE, CRITIC_RATE = 5e-4, 0.1, 1e-3  # learning rates; the first falls to this share
UNIT, MEMORY = 10.0, 0.05  # rewards that the value counts in; share of a round in the running mean
LEVEL_COST = 0.1  # reward that a step of the shaped task loses if the box lies on its side


def spin_level(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float, float]:
    """The task ``spin`` with a box that does not turn over, so that the network need not learn all of its sides."""
    rate = state.omega_jack * scene.jack_arm / scene.speed_scale
    calm = max(0.0, 1.0 - abs(state.omega_box) * scene.box_half_width / scene.speed_scale)
    return max(-1.0, min(1.0, rate)) * calm, -LEVEL_COST * (1.0 - math.cos(state.theta_box))


class Recipe(NamedTuple):
    """Settings that differ between the tasks."""

    task: Task  # whose rewards are improved
    ahead: int  # decisions that are played for each torque
    discount: float  # of a decision
    symmetric: bool  # whether mirror images earn the same


RECIPES = {
    "spin": Recipe(Task(("spin", "level"), spin_level), ahead=8, discount=0.98, symmetric=False),
    "rattle": Recipe(TASKS["rattle"], ahead=10, discount=0.98, symmetric=True),
}


class Judged(NamedTuple):
    """Torques that were tried in n states, in units of the limit."""

    inputs: torch.Tensor  # (n, INPUTS) of the network
    means: torch.Tensor  # (n, 1) its own torques
    tried: torch.Tensor  # (n, TRIES)
    advantages: torch.Tensor  # (n, TRIES) of mean 0 in each state, of deviation 1 in all
    worth: torch.Tensor  # (n, 1) mean return of those tried [UNIT]


@dataclass(frozen=True)
class Arguments:
    """Make the policy."""

    out: Path
    """Folder of the policy; made if there is none."""
    task: Literal["spin", "rattle"] = "spin"
    """Task that it plays."""
    rounds: int = 600
    """Settings of playing and improving."""
    seed: int = 0
    """Seed of the network, starts, noise, torques and the order of fitting."""


def network(widths: tuple[int, ...]) -> Any:
    """A network of torch from ``INPUTS`` numbers to one."""
    sizes = pairwise((INPUTS, *widths, 1))
    return nn.Sequential(*[part for size in sizes for part in (nn.Linear(*size), nn.Tanh())][:-1])


def inputs(states: Array) -> torch.Tensor:
    """A network's inputs for states, shape (n, 12): (n, INPUTS)."""
    return torch.from_numpy(observed(SCENE, states, "landing"))


def outputs(net: Any, states: Array) -> NDArray[np.float32]:
    """A network's outputs for states, shape (n, 12): (n,). In parts, which fit into the cache."""
    rows = inputs(states)
    with torch.no_grad():
        return np.concatenate([net(rows[first : first + BATCH])[:, 0] for first in range(0, len(rows), BATCH)])


def played(net: Any, task: Task, states: Array, ages: NDArray[np.int64], rng: np.random.Generator) -> Array:
    """Play on under some noise: ``states``, shape (n, 12), and ``ages`` in decisions, (n,), change in place.

    Returns:
        the visited states, shape (DECISIONS * n, 12). A jack as old as an episode starts anew.
    """
    visited = []
    for _ in range(DECISIONS):
        old = ages >= EPISODE
        states[old], ages[old] = starts(int(old.sum()), rng), 0
        visited.append(states.copy())
        noise = SPREAD * rng.normal(size=len(states)) * (rng.random(len(states)) < NOISY)
        states[:], *_ = advanced(task, states, np.clip(outputs(net, states), -1.0, 1.0) + noise)
        ages += 1
    return np.concatenate(visited)


def judged(net: Any, critic: Any, recipe: Recipe, states: Array, rng: np.random.Generator) -> Judged:
    """Torques in pairs around the network's own, and their advantages."""
    half = SPREAD * rng.normal(size=(len(states), TRIES // 2))
    means = np.clip(outputs(net, states), -1.0, 1.0)[:, None]
    tried = means + np.concatenate([half, -half], axis=1)
    now, returns, _ = advanced(recipe.task, np.repeat(states, TRIES, axis=0), tried.ravel())
    for decision in range(1, recipe.ahead):
        now, rewards, _ = advanced(recipe.task, now, outputs(net, now))
        returns += recipe.discount**decision * rewards
    returns = (returns + recipe.discount**recipe.ahead * UNIT * outputs(critic, now)).reshape(tried.shape)
    worth = returns.mean(axis=1, keepdims=True)
    advantages = np.clip((returns - worth) / (returns - worth).std(), -3.0, 3.0)
    parts = [torch.from_numpy(part.astype(np.float32)) for part in (means, tried, advantages, worth / UNIT)]
    batch = Judged(inputs(states), *parts)
    if not recipe.symmetric:
        return batch
    mirror = Judged(inputs(mirrored(states)), -batch.means, -batch.tried, batch.advantages, batch.worth)
    return Judged(*map(torch.cat, zip(batch, mirror, strict=True)))


def improve(nets: tuple[Any, Any], optimisers: tuple[Any, Any], samples: Judged) -> None:
    """Make better torques more likely, by PPO's clipped loss of normal distributions, and fit the value to returns."""
    before = ((samples.tried - samples.means) / SPREAD) ** 2
    for _ in range(EPOCHS):
        for batch in torch.randperm(len(before))[: len(before) // BATCH * BATCH].reshape(-1, BATCH):
            (mean, value), advantages = (net(samples.inputs[batch]) for net in nets), samples.advantages[batch]
            ratio = torch.exp(0.5 * (before[batch] - ((samples.tried[batch] - mean) / SPREAD) ** 2))
            gain = torch.minimum(ratio * advantages, ratio.clamp(1.0 - CLIP, 1.0 + CLIP) * advantages).mean()
            beyond = (mean.abs() - 1.0).clamp(min=0.0).square().mean()  # torques above the limit all act alike
            losses = 0.01 * beyond - gain, nn.functional.mse_loss(value, samples.worth[batch])
            for net, optimiser, loss in zip(nets, optimisers, losses, strict=True):
                optimiser.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(net.parameters(), 0.5)
                optimiser.step()


@command_line
def main() -> None:
    """Parse, play, improve, write."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__)
    torch.set_num_threads(1)
    torch.manual_seed(arguments.seed)
    rng, recipe, task = np.random.default_rng(arguments.seed), RECIPES[arguments.task], arguments.task
    settings = TrainSettings(
        task=task,
        fidelity="exact",
        seed=arguments.seed,
        observation="landing",
        action="torque",
        action_repeat=REPEAT,
        hidden_units=WIDTHS,
    )
    trials, states = starts(256, np.random.default_rng([arguments.seed, 1])), starts(JACKS, rng)
    ages, nets = rng.integers(0, EPISODE, JACKS), (network(WIDTHS), network(CRITIC))
    nets[0][0].weight.data.mul_(FIRST_SCALE)
    policy = copy.deepcopy(nets[0])
    optimisers = torch.optim.Adam(nets[0].parameters()), torch.optim.Adam(nets[1].parameters(), CRITIC_RATE)
    arguments.out.mkdir(parents=True, exist_ok=True)
    with trange(arguments.rounds, desc=task, disable=None) as bar:
        for number in bar:
            optimisers[0].param_groups[0]["lr"] = RATE * (1.0 - (1.0 - LAST_SHARE) * number / arguments.rounds)
            visited = played(nets[0], recipe.task, states, ages, rng)
            improve(nets, optimisers, judged(*nets, recipe, visited, rng))
            for old, new in zip(policy.parameters(), nets[0].parameters(), strict=True):
                old.data.lerp_(new.data, max(MEMORY, 1.0 / (number + 1)))
            write_with_layers(arguments.out, SETTINGS, settings, layers_of(policy))
            if number % 20 == 19 or number + 1 == arguments.rounds:
                bar.write(f"round {number + 1}: return {mean_return(task, trials, partial(outputs, policy)):.1f}")


if __name__ == "__main__":
    main()
