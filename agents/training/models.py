"""PPO models: made from settings, loaded without unpickling anything."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecEnv

from agents.files import first_line
from agents.policies.landing_features import flight_of
from agents.runs import SETTINGS, read_settings
from agents.settings import TrainSettings
from agents.training.checkpoints import is_whole, read_parameters
from agents.training.extractor import WithPreview
from agents.training.holding import HoldingPPO
from jackbox_env import Scene
from jackbox_env.planning.sb3_wrappers import HoldingVecEnv, LandingControlVecEnv, LookaheadVecEnv
from jackbox_env.sb3 import make_sb3_vec_env


def derived_seed(purpose: str, *numbers: int) -> int:
    """A seed below 2^31 from a purpose and numbers: training and evaluation never share starts by accident."""
    words = np.random.SeedSequence([*purpose.encode(), *numbers]).generate_state(1)
    return int(words[0] >> 1)


def make_vec_env(env_settings: dict[str, Any], num_envs: int, seed: int) -> VecEnv:
    """Environments of the default time limit side by side, with statistics of episodes; i starts from ``seed`` + i."""
    environments = make_sb3_vec_env(num_envs, **env_settings)
    environments.seed(seed)
    return environments


def holding(environments: VecEnv, settings: TrainSettings, num_threads: int | None = None) -> VecEnv:
    """The environments as training steps them: an action for ``hold`` control steps, with a look ahead, or aiming."""
    hold = settings.hold
    if settings.lookahead:
        samples = settings.lookahead
        return LookaheadVecEnv(environments, hold=hold, samples=samples, follow=True, num_threads=num_threads)
    if settings.landing:
        return LandingControlVecEnv(environments, period=hold * settings.control_dt)  # type: ignore[arg-type]
    return environments if hold == 1 else HoldingVecEnv(environments, hold)


def policy_kwargs(settings: TrainSettings) -> dict[str, Any]:
    """What Stable-Baselines3's policy is made with: its layers, the first deviation, the preview."""
    found: dict[str, Any] = {"net_arch": list(settings.hidden_units), "log_std_init": settings.initial_log_std}
    if settings.preview:
        flight = flight_of(Scene.of(settings.scene_fields))
        found |= {"features_extractor_class": WithPreview, "features_extractor_kwargs": {"flight": flight}}
    return found


def make_ppo(settings: TrainSettings, environments: VecEnv, **more: Any) -> HoldingPPO:
    """An untrained PPO model of these settings, for environments as :func:`holding` makes them.

    Its ``predict`` plays in environments that ask at every control step. What it saves loads without this project,
    except where ``settings.preview`` is on: then ``agents.training.extractor`` must be importable, as in a checkout.
    """
    model = HoldingPPO(
        "MlpPolicy",
        environments,
        learning_rate=LinearSchedule(settings.learning_rate, 0.0, 1.0),  # not ours, so that the model loads anywhere
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
        **more,
    )
    model.train_by(settings)
    return model


def run_folder(file: Path) -> Path | None:
    """The run folder that a model file is in, or that it is; None if there is none."""
    folders = (file, *file.parents[:2])
    return next((folder for folder in folders if (folder / SETTINGS).is_file()), None)


def load_model(path: Path, trust: bool = False) -> HoldingPPO:
    """Load a run folder's best model (else its last), or the model file in a run folder.

    The model is built from the run's settings.json and takes only tensors from the zip: nothing is unpickled, so an
    untrusted model cannot run code. It plays in environments that ask at every control step: ``predict`` repeats each
    action as long as in training, if it is given the state that it returned last.

    Args:
        path: run folder, or a .zip in it (or in a folder below it). A damaged best model in a run folder is skipped,
            and standard error says so.
        trust: unpickle a model that has no settings.json, as ``HoldingPPO.load`` does: only from people you trust.

    Raises:
        FileNotFoundError: there is no model, or no settings.json above it and ``trust`` is off.
        ValueError: the settings make no model, or the file is no model of these settings.
    """
    file = path
    if path.is_dir():
        file = path / "best_model.zip" if is_whole(path / "best_model.zip") else path / "model.zip"
    if not file.is_file():
        raise FileNotFoundError(f"{path} holds no model: best_model.zip or model.zip was looked for")
    if file.suffix == ".npz":
        raise ValueError(f"{file} holds weights alone: give its folder, {file.parent}")
    folder = run_folder(file)
    if folder is None and not trust:
        raise FileNotFoundError(
            f"{file} has no {SETTINGS} beside it to rebuild the model from; if you trust its author, use --trust"
        )
    if folder is None:
        with _refusing(f"{file} is no model of Stable-Baselines3"):
            return HoldingPPO.load(file, device="cpu")
    settings = read_settings(folder)
    with _refusing(f"{folder / SETTINGS} makes no model"):
        environments = make_vec_env(settings.env_settings, 1, settings.seed)
        model = make_ppo(settings, holding(environments, settings))
    with _refusing(f"{file} is no model of the settings beside it"):
        model.set_parameters(read_parameters(file), device="cpu")
    return model


@contextmanager
def _refusing(what: str) -> Iterator[None]:
    """Turn any failure in the block into a ValueError that says so."""
    try:
        yield
    except Exception as error:
        raise ValueError(f"{what}: {first_line(error)}") from error
