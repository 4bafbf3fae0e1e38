"""What a batch of environments offers to the vector environment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from jackbox_env.states import Array

Flags = NDArray[np.bool_]
Floats = NDArray[np.float32]


@dataclass(slots=True)
class Outcome:
    """What a step brought: fresh arrays, which the batch never writes again."""

    observations: Floats  # (N, 10)
    rewards: Array  # (N,)
    truncations: Flags  # (N,)
    infos: dict[str, NDArray[Any]]  # numbers of each environment's step, (N,) or (N, 12); empty unless asked for
    finished: int  # episodes that this step ended


def bad_action(action: float, number: int) -> ValueError:
    """The refusal of an action that is NaN or infinite."""
    return ValueError(f"action must be a finite number (clipped to [-1, 1]), got {action} for environment {number}")


class Batch(Protocol):
    """N environments of one scene. An episode that is over waits for its restart; steps pass it by."""

    @property
    def states(self) -> Array:
        """A copy of all states, shape (N, 12)."""

    @property
    def times(self) -> Array:
        """A copy of all times [s], shape (N,)."""

    @property
    def over(self) -> Flags:
        """Which episodes are over, shape (N,)."""

    @property
    def info_names(self) -> list[str]:
        """Names of the infos, those of the single environment."""

    def seed(self, number: int, seed: int) -> None:
        """Seed one environment's random starts."""

    def restart(self, chosen: Flags) -> None:
        """Start an episode in the ``chosen`` environments, each at a drawn start and time 0."""

    def place(self, chosen: Flags, states: Array, times: Array, anew: bool) -> None:
        """Put the ``chosen`` environments into states, shape (N, 12), and times [s], checked beforehand.

        ``anew``: each starts an episode there; otherwise its episode goes on, unless it is over: then it starts one.
        """

    def observe(self, chosen: Flags, observations: Floats) -> None:
        """Write what the ``chosen`` environments' agents see, shape (N, 10)."""

    def step(self, actions: Array | None) -> Outcome:
        """Step all under ``actions``, shape (N,), or under the scene's drive.

        Raises:
            ValueError, JackLostError: as the single environment does; then no environment has moved.
        """

    def render(self) -> tuple[Any, ...]:
        """A frame of each environment."""

    def close(self) -> None:
        """Release what the renderers hold."""
