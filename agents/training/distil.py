"""Make the policy `distilled` of juggle: the planner's value, improved on states that the policy itself visits.

In each round the first landing of each jack is at a random pair of angle and rate, good ones more often. Then the
policy plays. A state after that bounce is worth the discounted rewards of the next decisions and the value of the last
state. The network is fitted to the states of the last rounds and to their mirror images.

30 rounds take about 8 minutes of one core. The folder has the last round's policy from the first one on, so Ctrl-C
ends the run and leaves a policy. Seeded: the same numbers on the same machine.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import trange

from agents.policies.network import SHIPPED, write_with_layers
from agents.policies.one_bounce import (
    LANDING,
    LandingPolicy,
    LandingSettings,
    landing_times,
    landing_torques,
    uprighted,
)
from agents.policies.value import UNIT, Value, read_value
from agents.training.fitting import (
    CONTROL_DT,
    REPEAT,
    SCENE,
    advanced,
    epoch,
    inputs_and_goals,
    layers_of,
    mean_return,
    network,
    starts,
)
from jackbox_env.model.states import Array
from jackbox_env.tools.command_line import command_line

ANGLES = 0.4 * np.sign(np.linspace(-1.0, 1.0, 31)) * np.abs(np.linspace(-1.0, 1.0, 31)) ** 1.4  # finer near level
SETTINGS = LandingSettings(angles=tuple(ANGLES.round(4).tolist()), rates=(-1.0, -0.5, 0.0, 0.5, 1.0))
COARSE = replace(SETTINGS, angles=SETTINGS.angles[1::2], rates=(-0.8, 0.0, 0.8))  # that the rounds are played with
DECISION_TIME = REPEAT * CONTROL_DT  # [s]
JACKS = 600  # in each round
FIRST, COUNTED, HORIZON = 24, 22, 40  # decisions: to the first landing at most, from which states are fitted, ahead
DISCOUNT = 0.975  # of a decision
FRESH = 0.25  # share of the jacks that start an episode; the others start where earlier ones were
TEMPERATURE, UNIFORM = 6.0, 0.15  # of the drawn pairs: in rewards; share drawn uniformly
NOISE = np.array([0.01, 0.1])  # added to them [rad, rad/s]
ROUNDS_FITTED, EPOCHS, RATE = 8, 2, 2e-3  # the last rounds; passes over them in each; learning rate


@dataclass(frozen=True)
class Arguments:
    """Make the policy."""

    out: Path
    """Folder of the policy; made if there is none."""
    rounds: int = 30
    """Settings of playing and fitting."""
    seed: int = 0
    """Seed of the starts, pairs and the order of fitting."""


def drawn(policy: LandingPolicy, states: Array, rng: np.random.Generator) -> Array:
    """Angle and rate of the box at each jack's first landing, shape (n, 2), at random: good pairs more often."""
    states = uprighted(states)
    worth = policy.worth(states, landing_times(SCENE, states))
    choice = (worth / TEMPERATURE + rng.gumbel(size=worth.shape)).argmax(axis=1)
    uniform = rng.random(len(states)) < UNIFORM
    choice[uniform] = rng.integers(0, worth.shape[1], int(uniform.sum()))
    pairs: Array = policy.settings.pairs[choice] + NOISE * rng.normal(size=(len(states), 2))
    return pairs


def played(policy: LandingPolicy, states: Array, rng: np.random.Generator) -> tuple[Array, Array, NDArray[np.int64]]:
    """Play the first landing of each jack with a random pair, then by the policy.

    Returns:
        states, shape (T + 1, n, 12), rewards of each decision, (T, n), and the index of the first state after the first
        impact, (n,); -1 without one.
    """
    pairs, landed = drawn(policy, states, rng), np.full(len(states), -1)
    visited, earned = [states], []
    for decision in range(FIRST + COUNTED + HORIZON):
        now, free = uprighted(visited[-1]), (landed < 0) & (decision < FIRST)
        acting = np.zeros(len(now))
        acting[~free] = policy.towards_best(now[~free])
        acting[free] = landing_torques(SCENE, now[free], pairs[free], DECISION_TIME)
        after, rewards, struck = advanced(SETTINGS.task, visited[-1], acting)
        landed[free & struck] = decision + 1
        visited.append(after)
        earned.append(rewards)
    return np.array(visited), np.array(earned), landed


def valued(policy: LandingPolicy, visited: Array, earned: Array, landed: NDArray[np.int64]) -> tuple[Array, Array]:
    """States after first landings, shape (m, 12), and their values for the policy, (m,)."""
    worth = [policy.value.of(visited[-1])]
    for rewards in earned[::-1]:
        worth.append(rewards + DISCOUNT * worth[-1])
    jacks = np.flatnonzero(landed >= 0)
    rows, columns = (landed[jacks] + np.arange(COUNTED)[:, None]).ravel(), np.tile(jacks, COUNTED)
    return visited[rows, columns], np.array(worth[::-1])[rows, columns]


def fit(net: Any, value: Value, recent: deque[tuple[Array, Array]], rate: float) -> float:
    """Fit the network to states and their values; returns the root mean square error [rewards]."""
    states, worth = (np.concatenate(part) for part in zip(*recent, strict=True))
    samples, optimiser = inputs_and_goals(value, states, worth), torch.optim.Adam(net.parameters(), rate)
    errors = [error for _ in range(EPOCHS) for error in epoch(net, optimiser, *samples)]
    return UNIT * float(np.sqrt(np.mean(errors))) if errors else np.nan


@command_line
def main() -> None:
    """Parse, play, fit, write."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__)
    torch.set_num_threads(1)
    torch.manual_seed(arguments.seed)
    rng, trials = np.random.default_rng(arguments.seed), np.random.default_rng([arguments.seed, 1])
    value = read_value(SHIPPED / "juggle-value")
    net, pool = network(value.layers), starts(JACKS, rng)
    recent: deque[tuple[Array, Array]] = deque(maxlen=ROUNDS_FITTED)
    arguments.out.mkdir(parents=True, exist_ok=True)
    with trange(arguments.rounds, desc="distil", disable=None) as bar:
        for number in bar:
            policy = LandingPolicy(COARSE, layers_of(net))
            first = pool[rng.integers(0, len(pool), JACKS)]
            fresh = rng.random(JACKS) < FRESH
            first[fresh] = starts(int(fresh.sum()), rng)
            visited, earned, landed = played(policy, first, rng)
            recent.append(valued(policy, visited, earned, landed))
            pool = visited[: FIRST + COUNTED + HORIZON : 10].reshape(-1, 12)
            error = fit(net, value, recent, RATE * (1.0 - number / arguments.rounds) + 1e-4)
            write_with_layers(arguments.out, LANDING, SETTINGS, layers_of(net))
            if number % 5 == 4 or number + 1 == arguments.rounds:
                policy = LandingPolicy(SETTINGS, layers_of(net))
                earns = mean_return(SETTINGS.task, starts(100, trials), policy.towards_best)
                bar.write(f"round {number + 1}: off by {error:.1f}, return {earns:.1f}")


if __name__ == "__main__":
    main()
