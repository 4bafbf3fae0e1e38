"""How a trained model plays in the ordinary environment: it holds its actions, and looks ahead if it was trained so.

A policy that decides every control step can hardly tell what one of its actions did. One that holds each action for a
few steps explores further and looks further ahead. The environment that it plays in still asks it at every control
step, and shows it ten numbers.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from stable_baselines3 import PPO

from jackbox_env import Scene
from jackbox_env.lookahead import Futures
from jackbox_env.plans import Plans


class Playing(NamedTuple):
    """What a model carries from call to call, for n environments."""

    actions: NDArray[np.float32]  # (n, 1)
    left: NDArray[np.int64]  # (n,) for how many more calls each action holds
    plans: Plans | None  # of a model that looks ahead


class HoldingPPO(PPO):
    """PPO whose ``predict`` holds each action for ``hold`` calls and looks ahead by ``futures``, if it has any.

    ``predict`` returns a state. Pass it back in, as ``evaluate_policy`` does. Without it every call chooses anew.
    """

    hold: int = 1
    futures: Futures | None = None
    scene: Scene = Scene()  # that the futures are played in

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: NDArray[Any] | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[Any], Any]:
        """Return actions, shape (n, 1) for observations (n, 10) or (1,) for (10,), and the state for the next call.

        Args:
            observation: of one environment or of several; it counts where an action is chosen.
            state: what the last call returned; None: every environment chooses.
            episode_start: shape (n,), where an episode starts; an action is chosen there, with a plan begun anew; None:
                nowhere.
            deterministic: choose the mean of the distribution instead of a sample.

        Raises:
            ValueError: a state of another number of environments.
        """
        if self.hold == 1 and self.futures is None:
            return super().predict(observation, state, episode_start, deterministic)
        rows = np.atleast_2d(observation)
        count = len(rows)
        if state is None:
            plans = self.futures.begin(count) if self.futures else None
            state = Playing(np.zeros((count, 1), np.float32), np.zeros(count, np.int64), plans)
        if len(state.left) != count:
            raise ValueError(f"state must be that of {count} environments, as observation is, got {len(state.left)}")
        actions, left, plans = state.actions.copy(), state.left.copy(), state.plans
        if episode_start is not None:
            new = np.flatnonzero(np.broadcast_to(episode_start, left.shape))
            left[new] = 0
            if self.futures and plans:
                plans = plans.replaced(new, self.futures.begin(len(new)))
        due = np.flatnonzero(left == 0)
        if len(due):
            seen = rows[due]
            if self.futures and plans:
                appended, carried_on = self.futures.look([self.scene], seen, plans.of(due))
                seen, plans = np.concatenate([seen, appended], axis=1), plans.replaced(due, carried_on)
            chosen = super().predict(seen, deterministic=deterministic)[0]
            actions[due] = self.futures.torques(chosen, seen) if self.futures else chosen
            left[due] = self.hold
        return (actions.copy() if np.ndim(observation) == 2 else actions[0].copy()), Playing(actions, left - 1, plans)
