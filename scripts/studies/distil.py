"""Make the policy `distilled` of juggle: from the planner's value, improved on what the policy itself goes through.

In each round jacks meet the box once in a way that is drawn at random, good ones more often, and from then on the
policy plays. What it earns in the next decisions, discounted, and the value of where it ends say what the states after
that first bounce are worth to it. The network is fitted to those of the last rounds and to their mirror images.

30 rounds take some 8 minutes of one core. The folder holds the last round's policy from the first one on, so Ctrl-C
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
from agents.policies.one_bounce import LANDING, LandingPolicy, LandingSettings
from agents.policies.value import UNIT, Value, read_value
from jackbox_env import Rollout, Scene, rollout
from jackbox_env.command_line import command_line
from jackbox_env.files import make_folder
from jackbox_env.landing import landing_times, torques, upright
from jackbox_env.states import Array
from jackbox_env.tasks import sample_start
from scripts.studies.fitting import epoch, layers_of, network, seen_and_worth

ANGLES = 0.4 * np.sign(np.linspace(-1.0, 1.0, 31)) * np.abs(np.linspace(-1.0, 1.0, 31)) ** 1.4  # finer near level
SETTINGS = LandingSettings(angles=tuple(ANGLES.round(4).tolist()), rates=(-1.0, -0.5, 0.0, 0.5, 1.0))
FEWER = replace(SETTINGS, angles=SETTINGS.angles[1::2], rates=(-0.8, 0.0, 0.8))  # by which the rounds are played
SCENE, HELD = Scene(drive=None), SETTINGS.repeat * SETTINGS.control_dt  # [s] of a decision
JACKS = 600  # in each round
FIRST, COUNTED, HORIZON = 24, 22, 40  # decisions: to the first landing at most, from which states are fitted, ahead
DISCOUNT = 0.975  # of a decision
FRESH = 0.25  # share of the jacks that start an episode; the others start where earlier ones were
TEMPERATURE, ANY = 6.0, 0.15  # of the drawn pairs: in rewards; share of any pair at all
BLUR = np.array([0.01, 0.1])  # added to them [rad, rad/s]
KEPT, EPOCHS, RATE = 8, 2, 2e-3


@dataclass(frozen=True)
class Arguments:
    """Make the policy."""

    out: Path
    """Folder of the policy; made if there is none."""
    rounds: int = 30
    """Of playing and fitting."""
    seed: int = 0
    """Seed of the starts, ways and the order of fitting."""


def advanced(states: Array, acting: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """States a decision later, what was earned, and where something was struck."""
    found = rollout(
        SCENE, states, acting[:, None] * SCENE.torque_limit, SETTINGS.control_dt, impacts=True, rewards=SETTINGS.task,
        repeat=SETTINGS.repeat, trajectories=False, num_threads=1,
    )  # fmt: skip
    assert isinstance(found, Rollout)
    assert found.impacts is not None
    return found.trajectories[:, 1], found.rewards.sum(axis=1), found.impacts.sum(axis=1) > 0


def starts(count: int, rng: np.random.Generator) -> Array:
    """States that episodes start in, shape (count, 12)."""
    return np.array([sample_start(SCENE, rng) for _ in range(count)])


def drawn(policy: LandingPolicy, states: Array, rng: np.random.Generator) -> Array:
    """How each jack is to be met first, shape (n, 2): good pairs more often."""
    states = upright(states)
    worth = policy.worth(states, landing_times(SCENE, states))
    choice = (worth / TEMPERATURE + rng.gumbel(size=worth.shape)).argmax(axis=1)
    wild = rng.random(len(states)) < ANY
    choice[wild] = rng.integers(0, worth.shape[1], int(wild.sum()))
    pairs: Array = policy.settings.pairs[choice] + BLUR * rng.normal(size=(len(states), 2))
    return pairs


def played(policy: LandingPolicy, states: Array, rng: np.random.Generator) -> tuple[Array, Array, NDArray[np.int64]]:
    """Jacks that are met in a drawn way once, then by the policy.

    Returns:
        states, shape (T + 1, n, 12), what was earned in each decision, (T, n), and the first state after the first
        impact, (n,); where there was none, -1.
    """
    pairs, landed = drawn(policy, states, rng), np.full(len(states), -1)
    seen, earned = [states], []
    for decision in range(FIRST + COUNTED + HORIZON):
        now, free = upright(seen[-1]), (landed < 0) & (decision < FIRST)
        acting = np.zeros(len(now))
        acting[~free] = policy.towards_best(now[~free])
        acting[free] = torques(SCENE, now[free], landing_times(SCENE, now[free]), pairs[free], HELD)
        after, rewards, struck = advanced(seen[-1], acting)
        landed[free & struck] = decision + 1
        seen.append(after)
        earned.append(rewards)
    return np.array(seen), np.array(earned), landed


def counted(policy: LandingPolicy, seen: Array, earned: Array, landed: NDArray[np.int64]) -> tuple[Array, Array]:
    """States after first landings, shape (m, 12), and what they are worth to the policy, (m,)."""
    worth = [policy.value.of(seen[-1])]
    for rewards in earned[::-1]:
        worth.append(rewards + DISCOUNT * worth[-1])
    jacks = np.flatnonzero(landed >= 0)
    rows, columns = (landed[jacks] + np.arange(COUNTED)[:, None]).ravel(), np.tile(jacks, COUNTED)
    return seen[rows, columns], np.array(worth[::-1])[rows, columns]


def fit(net: Any, value: Value, kept: deque[tuple[Array, Array]], rate: float) -> float:
    """Fit the network to states and their worth; returns the error's mean square root [rewards]."""
    states, worth = (np.concatenate(part) for part in zip(*kept, strict=True))
    given, optimiser = seen_and_worth(value, states, worth), torch.optim.Adam(net.parameters(), rate)
    missed = [error for _ in range(EPOCHS) for error in epoch(net, optimiser, *given)]
    return UNIT * float(np.sqrt(np.mean(missed))) if missed else np.nan


def mean_return(policy: LandingPolicy, count: int, rng: np.random.Generator) -> float:
    """Mean return of an episode."""
    states, total = starts(count, rng), 0.0
    for _ in range(100):
        states, rewards, _ = advanced(states, policy.towards_best(states))
        total += float(rewards.mean())
    return total


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
    kept: deque[tuple[Array, Array]] = deque(maxlen=KEPT)
    make_folder(arguments.out)
    with trange(arguments.rounds, desc="distil") as bar:
        for turn in bar:
            policy = LandingPolicy(FEWER, layers_of(net))
            first = pool[rng.integers(0, len(pool), JACKS)]
            fresh = rng.random(JACKS) < FRESH
            first[fresh] = starts(int(fresh.sum()), rng)
            seen, earned, landed = played(policy, first, rng)
            kept.append(counted(policy, seen, earned, landed))
            pool = seen[: FIRST + COUNTED + HORIZON : 10].reshape(-1, 12)
            missed = fit(net, value, kept, RATE * (1.0 - turn / arguments.rounds) + 1e-4)
            write_with_layers(arguments.out, LANDING, SETTINGS, layers_of(net))
            if turn % 5 == 4 or turn + 1 == arguments.rounds:
                earns = mean_return(LandingPolicy(SETTINGS, layers_of(net)), 100, trials)
                bar.write(f"round {turn + 1}: off by {missed:.1f}, return {earns:.1f}")


if __name__ == "__main__":
    main()
