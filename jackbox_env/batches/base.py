"""The interface of a batch of environments, which the vector environment steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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
    """Results of a step: fresh arrays, which the batch never writes again."""

    observations: Floats  # (N, 10)
    rewards: Array  # (N,)
    terminations: Flags  # (N,)
    truncations: Flags  # (N,)
    infos: dict[str, NDArray[Any]]  # numbers of each environment's step, (N,) or (N, 12); empty unless requested
    finished: int  # episodes that this step ends
    after: Any  # the environments after the step, for :meth:`Batch.take`
    steps: NDArray[np.int64] | None = None  # (N,) control steps of each one's decision, under landing control

    @property
    def ended(self) -> Flags:
        """Which episodes this step ends, shape (N,)."""
        return self.terminations | self.truncations

    def followed_by(self, later: Outcome) -> Outcome:
        """This step and a later one combined. Episodes that ended in this step did not move in the later one."""
        ended = self.ended
        later.observations[ended] = self.observations[ended]
        for name, values in later.infos.items():
            values[ended] = self.infos[name][ended]
        later.rewards += self.rewards
        later.terminations |= self.terminations
        later.truncations |= self.truncations
        later.finished += self.finished
        return later


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

    @property
    def info_names(self) -> list[str]:
        """Names of the infos, those of the single environment."""

    def scene(self, number: int, starts: Starts | None = None) -> Scene:
        """The scene that an environment has now, or once ``starts`` have begun."""

    def field(self, name: str) -> Array:
        """A number of each environment's scene as it is now, by the name of its field, a fresh array, shape (N,)."""

    def impacts(self, number: int) -> list[Impact]:
        """The impacts of an environment's last step, in time order; none if its state was set since."""

    def step(self, actions: Array | Landings | None) -> Outcome:
        """Step all under ``actions``, shape (N,), or under the scene's drive; nothing changes before :meth:`take`.

        Under :class:`Landings` each environment makes the steps of its own decision.

        Raises:
            ValueError, JackLostError, TaskError: as the single environment does.
        """

    def take(self, after: Any) -> None:
        """Replace the present environments by those of an outcome."""

    def saved(self) -> Any:
        """The present environments, for :meth:`restore`."""

    def restore(self, saved: Any) -> None:
        """Return to saved environments; only steps may have changed them since."""

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


def repeated(batch: Batch, actions: Callable[[], Any], repeat: int, waiting: Flags | None) -> tuple[Outcome, Any]:
    """``repeat`` steps of a batch as one outcome, and their number in each environment, shape (N,), or 1 for all.

    All but the last step are committed. Finished episodes wait. Under landing control it is one decision.

    Args:
        batch: to be stepped.
        actions: returns the actions in the present states, see :meth:`Batch.step`.
        repeat: steps.
        waiting: episodes that have finished before the first step; None: none.
    """
    outcome = batch.step(actions())
    if outcome.steps is not None:
        return outcome, outcome.steps
    steps: Any = 1 if waiting is None else np.where(waiting, 0, 1)
    for _ in range(1, repeat):
        batch.take(outcome.after)
        steps = steps + np.where(batch.over, 0, 1)
        outcome = outcome.followed_by(batch.step(actions()))
    return outcome, steps
