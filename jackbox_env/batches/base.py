"""What a batch of environments offers to the vector environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from jackbox_env.scene import Scene
from jackbox_env.states import Array

Change = Mapping[str, Any]  # fields of a scene that change
Flags = NDArray[np.bool_]
Floats = NDArray[np.float32]


class Held(Protocol):
    """N environments at one moment: their states, times, episodes and generators, and a book of their owner's."""

    book: Any

    @property
    def states(self) -> Array:
        """A copy of all states, shape (N, 12)."""

    @property
    def times(self) -> Array:
        """A copy of all times [s], shape (N,)."""

    @property
    def over(self) -> Flags:
        """Which episodes are over, shape (N,)."""


@dataclass(slots=True)
class Outcome:
    """What a step brought: fresh arrays, which the batch never writes again."""

    observations: Floats  # (N, 10)
    rewards: Array  # (N,)
    truncations: Flags  # (N,)
    infos: dict[str, NDArray[Any]]  # numbers of each environment's step, (N,) or (N, 12); empty unless asked for
    finished: int  # episodes that this step ended
    draft: Any  # the environments after the step, to be kept


def bad_action(action: float, number: int) -> ValueError:
    """The refusal of an action that is NaN or infinite."""
    return ValueError(f"action must be a finite number (clipped to [-1, 1]), got {action} for environment {number}")


class Batch(Protocol):
    """N environments, of one scene or each of its own. An episode that is over waits for its restart; steps pass it by.

    What is held never changes. A step, or :meth:`draft`, makes a draft, restarts and placements change it, and
    :meth:`keep` puts it in place of what is held, by one assignment. So an interruption at any moment leaves all
    environments as they were or all as they are afterwards. A draft that is not kept is forgotten; it must be dropped
    before another is made.
    """

    held: Any  # a Held: the environments as they are

    @property
    def info_names(self) -> list[str]:
        """Names of the infos, those of the single environment."""

    def scene(self, number: int, held: Any = None) -> Scene:
        """The scene that an environment has in a draft that is a copy, or now."""

    def draft(self) -> Any:
        """A copy of what is held, to be changed."""

    def seed(self, draft: Any, number: int, seed: int) -> None:
        """Seed one environment's random starts, in a draft that is a copy."""

    def redraw(self, draft: Any, chosen: Flags, changes: Sequence[Change] | None = None) -> None:
        """Draw a scene for each of the ``chosen`` environments; before the start, if that is drawn too.

        Args:
            draft: to be changed.
            chosen: bool, shape (N,).
            changes: what an option changes beside, for each of the chosen ones: fields of the scene that it was made
                with. None: nothing; then the scene stays, unless scenes are drawn at each reset.

        Raises:
            TypeError, ValueError: a scene that is refused.
        """

    def restart(self, draft: Any, chosen: Flags) -> None:
        """Start an episode in the ``chosen`` environments, each at a drawn start and time 0; once in a step's draft."""

    def place(self, draft: Any, chosen: Flags, states: Array, times: Array, anew: bool) -> None:
        """Put the ``chosen`` environments into states, shape (N, 12), and times [s], checked beforehand.

        ``anew``: each starts an episode there; otherwise its episode goes on, unless it is over: then it starts one.
        """

    def observe(self, held: Any, chosen: Flags, observations: Floats) -> None:
        """Write what the ``chosen`` environments' agents see, shape (N, 10), in what is held or in a draft."""

    def step(self, actions: Array | None) -> Outcome:
        """Make a draft in which all are stepped under ``actions``, shape (N,), or under the scene's drive.

        Raises:
            ValueError, JackLostError: as the single environment does.
        """

    def keep(self, draft: Any) -> None:
        """Hold a draft from now on."""

    def render(self) -> tuple[Any, ...]:
        """A frame of each environment."""

    def close(self) -> None:
        """Release what the renderers hold."""
