"""The settings of ``make demo`` for RL Baselines3 Zoo (``pip install rl_zoo3``), which then does the training.

python -m rl_zoo3.train --algo ppo --env JackInBox-v0 --gym-packages jackbox_env --conf-file agents.training.zoo
"""

from __future__ import annotations

from typing import Any

from agents.settings import TrainSettings


def zoo_settings(settings: TrainSettings) -> dict[str, Any]:
    """The settings in the zoo's format. The zoo makes single environments and steps them in turn."""
    return {
        **settings.arguments,
        "env_kwargs": settings.env_settings,
        "n_envs": settings.num_envs,
        "n_timesteps": settings.total_steps,
        "learning_rate": f"lin_{settings.learning_rate}",
        # The zoo's buffer has one discount for all decisions; with one per bounce they last 0.8 s in the mean.
        "gamma": settings.gamma**0.8 if settings.action_repeat == "bounce" else settings.gamma,
    }


hyperparams = {"JackInBox-v0": zoo_settings(TrainSettings())}
