"""PPO models and their environments: made from settings, loaded without unpickling anything."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecEnv

from agents.files import as_value_error
from agents.policies.pictures import policy_kwargs
from agents.runs import SETTINGS, TRAINED_BY, model_in, read_parameters, run_folder, trusted_settings
from agents.settings import TrainSettings
from jackbox_env.sb3 import make_sb3_vec_env
from jackbox_env.tools import checks as check


def derived_seed(purpose: str, *numbers: int) -> int:
    """A seed below 2^31 from a purpose and numbers, so that training and evaluation do not share starts."""
    words = np.random.SeedSequence([*purpose.encode(), *numbers]).generate_state(1)
    return int(words[0] >> 1)


def make_vec_env(env_settings: dict[str, Any], num_envs: int, seed: int) -> VecEnv:
    """Environments with the default time limit; i starts from ``seed`` + i."""
    environments = make_sb3_vec_env(num_envs, **env_settings)
    environments.seed(seed)
    return environments


def try_out(settings: TrainSettings) -> None:
    """Make and reset an environment of a training, which raises for what cannot be trained."""
    environments = make_vec_env(settings.env_settings, 1, 0)
    space = environments.action_space
    if isinstance(space, gym.spaces.Box) and not space.is_bounded():
        raise ValueError(f"PPO needs an action within finite bounds, got {check.shown(space)}")
    environments.reset()
    environments.close()


def make_ppo(settings: TrainSettings, environments: VecEnv) -> PPO:
    """An untrained PPO model of these settings.

    A saved model loads without this project by ``stable_baselines3.PPO.load``. It stores the settings as
    ``trained_by``.
    """
    model = PPO(
        "CnnPolicy" if settings.pixels else "MlpPolicy",
        environments,
        learning_rate=LinearSchedule(settings.learning_rate, 0.0, 1.0),  # of SB3, so that the model loads anywhere
        n_steps=settings.rollout_steps,
        batch_size=min(settings.batch_size, settings.rollout_steps * environments.num_envs),
        n_epochs=settings.epochs,
        gamma=settings.gamma,
        gae_lambda=settings.gae_lambda,
        clip_range=settings.clip_range,
        ent_coef=settings.entropy_coefficient,
        policy_kwargs=policy_kwargs(settings),
        seed=settings.seed,
        device="cpu",
    )
    setattr(model, TRAINED_BY, dataclasses.asdict(settings))  # saved with the model
    return model


def load_model(path: Path, trust: bool = False) -> PPO:
    """Load a run folder's best model (else its last), or a model file in a run folder, to train or evaluate it further.

    The model is built from the run's settings.json and reads only tensors from the zip: nothing is unpickled, so an
    untrusted model cannot run code. Its environment, ``model.get_env()``, is that of the stored settings.

    Args:
        path: run folder, or a .zip in it (or in a folder below it). A damaged best model in a run folder is skipped,
            with a note on standard error.
        trust: run the code of a task, observation or action of a user that the settings name.

    Raises:
        FileNotFoundError: there is no model, or no settings.json above it.
        ValueError: the settings make no model, or the file is no model of these settings.
    """
    file = model_in(path)
    folder = run_folder(file)
    if folder is None:
        raise FileNotFoundError(f"{file} has no {SETTINGS} beside it to rebuild the model from")
    settings = trusted_settings(folder, trust)
    with as_value_error(f"{folder / SETTINGS} makes no model"):
        model = make_ppo(settings, make_vec_env(settings.env_settings, 1, settings.seed))
    with as_value_error(f"{file} is no model of the settings beside it"):
        model.set_parameters(read_parameters(file), device="cpu")
    return model
