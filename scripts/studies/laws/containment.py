"""Deepest penetration of a foot over many control steps of random torque, contact="exact", in 500-step episodes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from jackbox_env import _validation as check
from jackbox_env.compiled.compiler import compiled
from jackbox_env.compiled.step import make_numbers
from jackbox_env.states import clearance
from jackbox_env.vector_env import JackInBoxVectorEnv
from scripts.common import command_line


@dataclass(frozen=True)
class Arguments:
    """Step a batch under uniformly random torques and look at every state."""

    steps: int = 100_000_000
    """Control steps in all."""
    num_envs: int = 4096
    """Environments side by side."""
    seed: int = 0
    """Of the starts and the torques."""


def least_clearance(values: NDArray[np.float64], states: NDArray[np.float64]) -> float:
    """Smallest gap [m] in any of the states, shape (N, 12); compiled."""
    from_numbers = make_numbers(values)
    least = math.inf
    for i in range(states.shape[0]):
        least = min(least, clearance(from_numbers, states[i]))
    return least


def deepest_over(steps: int, num_envs: int, seed: int, progress: bool = True) -> tuple[float, int]:
    """Return how deep a foot ever was in a wall [m], negative if none touched, and the steps taken.

    Raises:
        TypeError, ValueError: an argument out of its range.
    """
    steps = check.whole("steps", steps, at_least=1)
    env = JackInBoxVectorEnv(num_envs, contact="exact", autoreset_mode="SAME_STEP")
    numbers, rng, look = np.array(env.scene.numbers), np.random.default_rng(seed), compiled(least_clearance)
    env.reset(seed=seed)
    least = math.inf
    rounds = math.ceil(steps / num_envs)
    for _ in tqdm(range(rounds), unit="steps", unit_scale=num_envs, disable=not progress, leave=False):
        env.step(rng.uniform(-1.0, 1.0, (num_envs, 1)))
        least = min(least, look(numbers, env.states))
    return -least, rounds * num_envs


@command_line
def main() -> None:
    """Parse, step, print."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__)
    deepest, steps = deepest_over(arguments.steps, arguments.num_envs, arguments.seed)
    where = f"{deepest:.3g} m outside" if deepest > 0.0 else f"{-deepest:.3g} m inside: none was ever outside"
    print(f"over {steps:,} control steps the furthest foot was {where}")


if __name__ == "__main__":
    main()
