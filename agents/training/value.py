"""Make a value for the planner: the return of a search over the next 3.2 s, for ends of plans and visited states.

There are two rounds. In each a small search plays. Some of the states that it visits are collected, and ends of its
candidates, half of them among the best. A longer search from each state evaluates it, and a network is fitted to these
values, on all states and their mirror images. The second round's search uses the value of the first round.

It takes about 4 minutes of one core. Seeded: the same numbers on the same machine.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn
from tqdm import trange

from agents.policies.icem import PlanSearch
from agents.policies.network import Layer, write_with_layers
from agents.policies.value import INPUTS, VALUE, Value, ValuedSearch
from agents.settings import EnvSettings
from agents.training.fitting import BATCH, CONTROL_DT, REPEAT, SCENE, epoch, inputs_and_goals, layers_of, starts
from jackbox_env import Scene
from jackbox_env.model.states import Array
from jackbox_env.tools.command_line import command_line

COMMON: dict[str, Any] = {"repeat": REPEAT, "num_threads": 1}
PLAYING: dict[str, Any] = {**COMMON, "knots": 20, "samples": 96, "elites": 10, "iterations": 1}
EVALUATING: dict[str, Any] = {**COMMON, "knots": 32, "samples": 64, "elites": 5, "iterations": 3}
EPISODES, DECISIONS = 80, 100  # of the playing search, in each round
VISITED = 0.15  # share of visited states
CHUNK = 250  # states that are evaluated together
ZERO_VALUE: list[Layer] = [(np.zeros((1, INPUTS), np.float32), np.zeros(1, np.float32))]  # worth 0 everywhere
WIDTH, EPOCHS, RATE, DECAY = 96, 100, 3e-3, 1e-3


@dataclass(frozen=True)
class Arguments:
    """Make the value."""

    out: Path
    """Folder of the value; made if there is none."""
    task: str = "juggle"
    """Whose rewards are counted."""
    states: int = 8000
    """Evaluated states of each round."""
    seed: int = 0
    """Seed of the starts, candidates, states and the network."""


class RecordingSearch(ValuedSearch):
    """A search that stores the returns and the last states of its last candidates."""

    def evaluate(self, scene: Scene, states: Array, tried: Array) -> tuple[Array, Array]:
        """Evaluate as :class:`ValuedSearch` does, and store the result."""
        self.returns, self.ends = super().evaluate(scene, states, tried)
        return self.returns, self.ends


def visited(search: RecordingSearch, rng: np.random.Generator) -> tuple[Array, Array]:
    """Ends of candidates, two for each decision, and visited states; shapes (n, 12)."""
    states, rows = starts(EPISODES, rng), np.arange(EPISODES)
    plans, ends, visits = search.begin(EPISODES), [], []
    for _ in trange(DECISIONS, desc="play", leave=False, disable=None):
        best, _, plans = search.decide(SCENE, states, plans)
        good = np.argsort(-search.returns, axis=1)[rows, rng.integers(0, search.samples // 8, EPISODES)]
        ends += [search.ends[rows, good], search.ends[rows, rng.integers(0, search.samples, EPISODES)]]
        visits.append(states)
        states = PlanSearch.evaluate(search, SCENE, states, best[:, None, :1])[1][:, 0]
    return np.concatenate(ends), np.concatenate(visits)


def chosen(search: RecordingSearch, count: int, rng: np.random.Generator) -> Array:
    """States to be evaluated, shape (count, 12)."""
    ends, visits = visited(search, rng)
    few = round(VISITED * count)
    return np.concatenate([ends[rng.permutation(len(ends))[: count - few]], visits[rng.permutation(len(visits))[:few]]])


def evaluated(task: str, states: Array, rng: np.random.Generator) -> Array:
    """Return of the best plan of a new search from each state, shape (n,)."""
    returns = []
    for first in trange(0, len(states), CHUNK, desc="evaluate", leave=False, disable=None):
        search = PlanSearch(task, CONTROL_DT, seed=int(rng.integers(2**31)), **EVALUATING)
        some = states[first : first + CHUNK]
        returns.append(search.decide(SCENE, some, search.begin(len(some)))[1])
    return np.concatenate(returns)


def fitted(settings: EnvSettings, states: Array, worth: Array) -> list[Layer]:
    """Fit a network to values of states; prints its error on a tenth of them, which it is not fitted to."""
    net: Any = nn.Sequential(
        nn.Linear(INPUTS, WIDTH), nn.Tanh(), nn.Linear(WIDTH, WIDTH), nn.Tanh(), nn.Linear(WIDTH, 1)
    )
    order, few = torch.randperm(len(states)).numpy(), len(states) // 10
    others, rest = order[:few], order[few:]
    inputs, goals = inputs_and_goals(Value(settings, ZERO_VALUE), states[rest], worth[rest])
    net[4].bias.data.fill_(float(goals.mean()))
    optimiser = torch.optim.AdamW(net.parameters(), RATE, weight_decay=DECAY)
    rates = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, total_steps=EPOCHS * (len(inputs) // BATCH))
    for _ in trange(EPOCHS, desc="fit", leave=False, disable=None):
        epoch(net, optimiser, inputs, goals, rates.step)
    layers = layers_of(net)
    unexplained = float(np.var(worth[others] - Value(settings, layers).of(states[others])) / np.var(worth[others]))
    print(f"{len(rest)} states, {100 * unexplained:.0f} % of the variance of {few} others is not explained")
    return layers


@command_line
def main() -> None:
    """Parse, play, evaluate, fit, write."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__)
    torch.set_num_threads(1)
    torch.manual_seed(arguments.seed)
    rng, settings = np.random.default_rng(arguments.seed), EnvSettings(task=arguments.task, contact="exact")
    states, worth, layers = np.zeros((0, 12)), np.zeros(0), ZERO_VALUE
    arguments.out.mkdir(parents=True, exist_ok=True)
    for number in range(2):
        value, seed = Value(settings, layers), arguments.seed + number
        search = RecordingSearch(value, arguments.task, CONTROL_DT, seed=seed, **PLAYING)
        new = chosen(search, arguments.states, rng)
        states, worth = np.concatenate([states, new]), np.concatenate([worth, evaluated(arguments.task, new, rng)])
        layers = fitted(settings, states, worth)
        write_with_layers(arguments.out, VALUE, settings, layers)


if __name__ == "__main__":
    main()
