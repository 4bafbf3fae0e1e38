"""Policies that decide every few control steps, or once a bounce, and repeat the action in between.

Such a policy plays in the ordinary environment, which needs an action in every control step and returns ten numbers.
The planner, the one-bounce policy and the networks derive from :class:`RepeatingPolicy`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jackbox_env.landing import is_over
from jackbox_env.observation import BOUNDS
from jackbox_env.planning.icem import Plans

Actions = NDArray[np.float32]


class Memory(NamedTuple):
    """The recurrent state of a policy in n environments."""

    actions: Actions  # (n, action size) of the last decisions
    repeats: NDArray[np.int64]  # (n,) calls that will still repeat each action
    plans: Plans | None  # warm-started plans, if the policy plans
    freed: NDArray[np.bool_]  # (n,) whether a call since the last decision saw no impact
    observations: NDArray[Any] | None = None  # (n, 10) of the last call


class RepeatingPolicy:
    """A deterministic policy with Stable-Baselines3's ``predict`` that decides every ``repeat`` calls or earlier.

    If ``resting`` is not 0, an impact ends a decision earlier, see :func:`jackbox_env.landing.is_over`.
    """

    repeat: int
    resting = 0  # calls after which an impact ends a decision in any case, see jackbox_env.landing; 0: none ends it
    action_size = 1

    def begin(self, count: int) -> Any:
        """Initial plans of ``count`` environments; None if the policy does not plan."""
        return None

    def decide(self, observations: NDArray[Any], plans: Any) -> tuple[NDArray[Any], Any]:
        """Return actions, shape (k, action_size), and the next plans, for k observations, shape (k, 10)."""
        raise NotImplementedError

    def struck(self, before: NDArray[Any], after: NDArray[Any]) -> NDArray[np.bool_]:
        """Whether an impact came between observations of successive calls, shape (n, 10) each; shape (n,)."""
        raise NotImplementedError

    def torques(self, actions: Actions, observations: NDArray[Any]) -> Actions:
        """Torques in units of the limit, shape (n, 1), that realise the actions in the present control step."""
        return actions

    def predict(
        self, observation: Any, state: Memory | None = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Actions, Memory]:
        """Return torques, shape (n, 1) for observations (n, 10) or (1,) for (10,), and the state for the next call.

        Args:
            observation: of one environment or of n.
            state: as returned by the last call; None: every environment decides.
            episode_start: shape (n,), True at the start of an episode, which forces a decision; None: none starts.
            deterministic: ignored, because these policies draw no actions.

        Raises:
            ValueError: another shape, or a state or ``episode_start`` of another number of environments.
        """
        rows = np.atleast_2d(np.asarray(observation))
        if rows.ndim != 2 or rows.shape[1:] != BOUNDS.shape:
            raise ValueError(f"observation must have shape (n, 10) or (10,), got {np.shape(observation)}")
        count = len(rows)
        if state is None:
            state = Memory(
                np.zeros((count, self.action_size), np.float32), np.zeros(count, np.int64), self.begin(count),
                np.zeros(count, np.bool_),
            )  # fmt: skip
        if len(state.repeats) != count:
            raise ValueError(f"state must be that of {count} environments, as observation is, got {len(state.repeats)}")
        actions, repeats, plans, freed = state.actions.copy(), state.repeats.copy(), state.plans, state.freed
        if self.resting and state.observations is not None:
            struck = self.struck(state.observations, rows)
            freed = freed | ~struck
            repeats[is_over(self.repeat - repeats, freed, struck, self.resting)] = 0
        if episode_start is not None:
            new = _starting(episode_start, count)
            repeats[new] = 0
            if plans is not None:
                plans = plans.replaced(new, self.begin(len(new)))
        due = np.flatnonzero(repeats == 0)
        if len(due):
            actions[due], next_plans = self.decide(rows[due], plans and plans.of(due))
            plans, repeats[due] = plans and plans.replaced(due, next_plans), self.repeat
            freed = freed & (repeats < self.repeat)
        torques = self.torques(actions, rows)
        memory = Memory(actions, repeats - 1, plans, freed, rows.copy() if self.resting else None)
        return torques.copy() if np.ndim(observation) == 2 else torques[0].copy(), memory


def _starting(episode_start: Any, count: int) -> NDArray[np.int64]:
    """Indices of the environments in which an episode starts.

    Raises:
        ValueError: ``episode_start`` has another number of environments.
    """
    starts = np.asarray(episode_start, dtype=np.bool_)
    if starts.shape not in ((), (1,), (count,)):
        raise ValueError(f"episode_start must have shape ({count},), as there are observations, got {starts.shape}")
    return np.flatnonzero(np.broadcast_to(starts, count))
