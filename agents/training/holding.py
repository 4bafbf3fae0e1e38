"""PPO whose model plays in the ordinary environment as it was trained to: see ``agents/policies/playing.py``."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3 import PPO

from agents.policies.playing import Manner, manner_of, play
from agents.settings import TrainSettings


class HoldingPPO(PPO):
    """PPO whose ``predict`` holds actions and looks ahead in its ``manner``.

    ``predict`` returns a state. Pass it back in, as ``evaluate_policy`` does. Without it every call chooses anew.

    A saved model loads without this project by ``stable_baselines3.PPO.load``: it keeps its settings as plain values.
    Only a model that was trained with the preview of the landing needs ``agents.training.extractor``, so a checkout.
    """

    manner: Manner = Manner()
    trained_by: dict[str, Any] | None = None  # fields of TrainSettings

    def train_by(self, settings: TrainSettings) -> None:
        """Play as models of these settings play."""
        self.trained_by, self.manner = dataclasses.asdict(settings), manner_of(settings)

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "manner"]

    @classmethod
    def load(cls, *args: Any, **more: Any) -> HoldingPPO:
        """Load as Stable-Baselines3 does, which unpickles; the model plays as it did when it was saved."""
        model: HoldingPPO = super().load(*args, **more)
        if model.trained_by is not None:
            model.train_by(TrainSettings.of(model.trained_by))
        return model

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: NDArray[Any] | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[Any], Any]:
        """Return actions and the state for the next call, see :func:`agents.policies.playing.play`.

        Args:
            observation: shape (n, 10) or (10,).
            state: what the last call returned, or None.
            episode_start: shape (n,), where an episode starts; None: nowhere.
            deterministic: choose the mean of the distribution instead of a sample.

        Raises:
            ValueError: a state of another number of environments.
        """
        if self.manner.hold == 1 and self.manner.features is None and self.manner.aims is None:
            return super().predict(observation, state, episode_start, deterministic)

        def choose(seen: NDArray[Any]) -> NDArray[Any]:
            return PPO.predict(self, np.asarray(seen), deterministic=deterministic)[0]

        return play(self.manner, choose, observation, state, episode_start)
