"""The interface of a batch of environments, which the vector environment steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from jackbox_env.landing import Landings
from jackbox_env.scene import Scene
from jackbox_env.simulators import Impact
from jackbox_env.states import Array

Change = Mapping[str, Any]  # fields of a scene that change
Flags = NDArray[np.bool_]
Floats = NDArray[np.float32]
Numbers = NDArray[np.int64]  # of environments


@dataclass(slots=True)
class Outcome:
    """Results of a step, or of several: fresh arrays, which the batch never writes again. Rewards are summed."""

    observations: Floats  # (N, 10)
    rewards: Array  # (N,)
    terminations: Flags  # (N,)
    truncations: Flags  # (N,)
    infos: dict[str, NDArray[Any]]  # numbers of each environment's step, (N,) or (N, 12); empty unless requested
    finished: int  # episodes that this step ends
    after: Any  # the environments after the step, for :meth:`Batch.take`
    steps: NDArray[np.int64] | None = None  # (N,) control steps that each made; None: a plain step

    @property
    def ended(self) -> Flags:
        """Which episodes this step ends, shape (N,)."""
        return self.terminations | self.truncations


class Starts(NamedTuple):
    """Episodes that are drawn but not begun."""

    numbers: Numbers  # (k,) of their environments
    generators: Any  # of these environments from their start on
    scenes: Any  # of these environments from their start on, in the batch's own form; None: unchanged
    states: Array | None = None  # (k, 12) in which they start, checked; None: drawn when they begin


def bad_action(action: float, number: int) -> ValueError:
    """The error for an action that is NaN or infinite."""
    return ValueError(f"action must be a finite number (clipped to [-1, 1]), got {action} for environment {number}")


class Batch(Protocol):
    """N environments with one scene for all or one for each. Steps do not change a finished episode.

    :meth:`step` and :meth:`draw` may raise and change nothing. :meth:`take`, :meth:`start` and :meth:`set_states` then
    commit the results; they cannot fail.
    """

    @property
    def states(self) -> Array:
        """A copy of all states, shape (N, 12)."""

    @property
    def times(self) -> Array:
        """A copy of all times [s], shape (N,)."""

    @property
    def over(self) -> Flags:
        """Which episodes are over, shape (N,)."""

    def scene(self, number: int, starts: Starts | None = None) -> Scene:
        """The scene that an environment has now, or once ``starts`` have begun."""

    def field(self, name: str) -> Array:
        """A number of each environment's scene as it is now, by the name of its field, a fresh array, shape (N,)."""

    def impacts(self, number: int) -> list[Impact]:
        """The impacts of an environment's last step, in time order; none if its state was set since."""

    def step(self, actions: Array | Landings | None, repeat: int = 1) -> Outcome:
        """Step all under ``actions``, shape (N,), or under the scene's drive; nothing changes before :meth:`take`.

        It makes ``repeat`` steps, fewer in an episode that ends before. Under :class:`Landings` each environment makes
        the steps of its own decision.

        Raises:
            ValueError, JackLostError, TaskError: as the single environment does.
        """

    def take(self, after: Any) -> None:
        """Replace the present environments by those of an outcome."""

    def draw(
        self,
        numbers: Numbers,
        seeds: Sequence[int | None] | None = None,
        changes: Sequence[Change] | None = None,
        placed: bool = False,
    ) -> Starts:
        """Seed generators, and draw scenes and starts for episodes to come.

        Args:
            numbers: of the environments, shape (k,).
            seeds: of each one's generator; None: the generator continues.
            changes: for each of them, fields of its original scene that an option changes. None: no change, unless
                scenes are drawn at each reset.
            placed: whether the caller sets the first states, so that no start is drawn.

        Raises:
            TypeError, ValueError: an invalid scene, or an invalid start from the task.
        """

    def start(self, starts: Starts) -> None:
        """Begin episodes at time 0. If all begin, this also repairs what an interruption left half changed."""

    def set_states(self, chosen: Flags, states: Array, times: Array) -> None:
        """Set states, shape (N, 12), and times [s] of the ``chosen`` environments, checked beforehand.

        Their episodes continue. A finished episode starts anew.
        """

    def observe(self, numbers: Numbers, observations: Floats) -> None:
        """Write the observations of some environments into their rows, shape (N, 10)."""

    def render(self) -> tuple[Any, ...]:
        """A frame of each environment."""

    def close(self) -> None:
        """Release the renderers' resources."""
