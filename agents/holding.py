"""PPO whose trained model plays in the ordinary environment as it was trained to: see :mod:`agents.playing`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3 import PPO

from agents.playing import Manner, play


class HoldingPPO(PPO):
    """PPO whose ``predict`` holds actions and looks ahead in its ``manner``.

    ``predict`` returns a state. Pass it back in, as ``evaluate_policy`` does. Without it every call chooses anew.
    """

    manner: Manner = Manner()

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: NDArray[Any] | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[Any], Any]:
        """Return actions and the state for the next call, see :func:`agents.playing.play`.

        Args:
            observation: shape (n, 10) or (10,).
            state: what the last call returned, or None.
            episode_start: shape (n,), where an episode starts; None: nowhere.
            deterministic: choose the mean of the distribution instead of a sample.

        Raises:
            ValueError: a state of another number of environments.
        """
        if self.manner.hold == 1 and self.manner.futures is None:
            return super().predict(observation, state, episode_start, deterministic)

        def choose(seen: NDArray[Any]) -> NDArray[Any]:
            return PPO.predict(self, np.asarray(seen), deterministic=deterministic)[0]

        return play(self.manner, choose, observation, state, episode_start)
