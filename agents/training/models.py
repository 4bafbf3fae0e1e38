"""PPO models and their environments: made from settings, loaded without unpickling anything."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecEnv

from agents.files import as_value_error
from agents.policies.landing_features import landing_numbers
from agents.runs import SETTINGS, TRAINED_BY, model_in, read_parameters, read_settings, run_folder
from agents.settings import TrainSettings
from agents.training.durations import DurationBuffer
from agents.training.extractor import WithPreview
from jackbox_env import Scene
from jackbox_env.planning.sb3_wrappers import HoldingVecEnv, LandingControlVecEnv, LookaheadVecEnv
from jackbox_env.sb3 import make_sb3_vec_env


def derived_seed(purpose: str, *numbers: int) -> int:
    """A seed below 2^31 from a purpose and numbers, so that training and evaluation do not share starts."""
    words = np.random.SeedSequence([*purpose.encode(), *numbers]).generate_state(1)
    return int(words[0] >> 1)


def make_vec_env(env_settings: dict[str, Any], num_envs: int, seed: int) -> VecEnv:
    """Environments with the default time limit and statistics of episodes; i starts from ``seed`` + i."""
    environments = make_sb3_vec_env(num_envs, **env_settings)
    environments.seed(seed)
    return environments


def wrapped(environments: VecEnv, settings: TrainSettings, num_threads: int | None = None) -> VecEnv:
    """The environments as training steps them: with action repeat, and a lookahead or landing control."""
    repeat = settings.longest
    if settings.lookahead:
        samples = settings.lookahead
        return LookaheadVecEnv(environments, hold=repeat, samples=samples, follow=True, num_threads=num_threads)
    if settings.landing:
        return LandingControlVecEnv(environments, period=settings.period)  # type: ignore[arg-type]
    return environments if repeat == 1 else HoldingVecEnv(environments, repeat)


def policy_kwargs(settings: TrainSettings) -> dict[str, Any]:
    """Keyword arguments of Stable-Baselines3's policy: its layers, the first deviation, the preview."""
    keywords: dict[str, Any] = {"net_arch": list(settings.hidden_units), "log_std_init": settings.initial_log_std}
    if settings.preview:
        flight = tuple(landing_numbers(Scene.of(settings.scene_fields)))
        keywords |= {"features_extractor_class": WithPreview, "features_extractor_kwargs": {"flight": flight}}
    return keywords


def make_ppo(settings: TrainSettings, environments: VecEnv, **keywords: Any) -> PPO:
    """An untrained PPO model of these settings, for environments as :func:`wrapped` makes them.

    A saved model loads without this project by ``stable_baselines3.PPO.load``, except if ``settings.preview`` is on or
    ``settings.repeat`` is "bounce": then ``agents.training`` must be importable, as in a checkout. It stores the
    settings as ``trained_by``.
    """
    model = PPO(
        "MlpPolicy",
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
        **{"rollout_buffer_class": DurationBuffer if settings.repeat == "bounce" else None, **keywords},
    )
    setattr(model, TRAINED_BY, dataclasses.asdict(settings))  # saved with the model
    return model


def load_model(path: Path) -> PPO:
    """Load a run folder's best model (else its last), or a model file in a run folder, to train or evaluate it further.

    The model is built from the run's settings.json and reads only tensors from the zip: nothing is unpickled, so an
    untrusted model cannot run code. Its environment, ``model.get_env()``, is that of the stored settings, wrapped as in
    training. To play in the ordinary environment use :func:`agents.policies.registry.find_policy`.

    Args:
        path: run folder, or a .zip in it (or in a folder below it). A damaged best model in a run folder is skipped,
            with a note on standard error.

    Raises:
        FileNotFoundError: there is no model, or no settings.json above it.
        ValueError: the settings make no model, or the file is no model of these settings.
    """
    file = model_in(path)
    folder = run_folder(file)
    if folder is None:
        raise FileNotFoundError(f"{file} has no {SETTINGS} beside it to rebuild the model from")
    settings = read_settings(folder)
    with as_value_error(f"{folder / SETTINGS} makes no model"):
        environments = make_vec_env(settings.env_settings, 1, settings.seed)
        model = make_ppo(settings, wrapped(environments, settings))
    with as_value_error(f"{file} is no model of the settings beside it"):
        model.set_parameters(read_parameters(file), device="cpu")
    return model
