"""Training and loading."""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback

from agents.runs import describe, read_settings
from agents.settings import TrainSettings
from agents.training import ppo as training
from agents.training.checkpoints import latest_checkpoint
from agents.training.models import load_model, make_ppo, make_vec_env
from jackbox_env.sb3 import DurationBuffer, Durations
from jackbox_env.tools.files import new_folder
from tests.agents.small_run import TINY

# -- training ----------------------------------------------------------------------------------------------------------


def test_a_run_folder_has_the_settings_command_and_versions_of_its_run(run: Path) -> None:
    assert read_settings(run) == TINY
    record = json.loads((run / "run.json").read_text())
    assert (record["seed"], record["command"]) == (TINY.seed, sys.argv)
    assert set(record["versions"]) >= {"python", "jackbox", "pymunk", "stable-baselines3", "commit"}
    for name in ("model.zip", "best_model.zip", "evaluations.npz", "tensorboard", "checkpoints/ppo_512.zip"):
        assert (run / name).exists(), name
    stored = np.load(run / "evaluations.npz")
    assert stored["timesteps"].tolist() == [1024, 2048]
    assert stored["results"].shape == (2, 4)
    spent = json.loads((run / "time.json").read_text())
    assert spent["steps"] == TINY.total_steps
    assert spent["seconds"] > 0.0
    assert spent["processor_seconds"] > 0.0


def test_a_resumed_run_goes_on_from_the_weights_it_had(tmp_path: Path, run: Path) -> None:
    # Resuming at the total changes nothing: the checkpoint's weights come out again.
    folder = new_folder(tmp_path / "run", "test")
    describe(folder, replace(TINY, total_steps=768))
    (folder / "checkpoints").mkdir()
    checkpoint = folder / "checkpoints" / "ppo_768.zip"
    checkpoint.write_bytes((run / "checkpoints" / "ppo_768.zip").read_bytes())
    resumed = training.train(replace(TINY, total_steps=768), folder, progress=False)
    saved = load_model(checkpoint).get_parameters()
    torch.testing.assert_close(resumed.get_parameters()["policy"], saved["policy"], rtol=0.0, atol=0.0)
    assert saved["policy.optimizer"]["state"], "the optimiser's moments are part of a checkpoint"


def test_a_run_with_more_steps_goes_on_from_its_last_model(tmp_path: Path, run: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    last = load_model(folder / "model.zip").get_parameters()["policy"]
    more = training.extended(folder, TINY.total_steps + 512)
    assert more == read_settings(folder) == replace(TINY, total_steps=TINY.total_steps + 512)
    steps, parameters = latest_checkpoint(folder)
    assert steps == TINY.total_steps
    assert parameters is not None
    torch.testing.assert_close(parameters["policy"], last, rtol=0.0, atol=0.0)
    assert training.train(more, folder, progress=False).num_timesteps == TINY.total_steps + 512


# -- loading -----------------------------------------------------------------------------------------------------------


def test_an_unfinished_training_is_resumed_and_a_finished_one_stays(run: Path, tmp_path: Path) -> None:
    before = (run / "model.zip").stat().st_mtime_ns
    training.trained_in(run, TINY, progress=False)
    assert (run / "model.zip").stat().st_mtime_ns == before
    with pytest.raises(ValueError, match="is a run of other settings: move it away, or choose another folder"):
        training.trained_in(run, replace(TINY, seed=5), progress=False)
    shutil.copytree(run, tmp_path / "new")
    (tmp_path / "new" / "model.zip").unlink()  # as if it had been interrupted
    training.trained_in(tmp_path / "new", TINY, progress=False)
    assert (tmp_path / "new" / "model.zip").is_file()


# -- discounting by elapsed time ---------------------------------------------------------------------------------------


# Without gravity nothing is struck, so that each decision lasts 2 s, and each episode has five.
FLOATING = replace(
    TINY, contact="exact", action="landing", action_repeat="bounce", scene='{"gravity": 0}', gamma=0.8, num_envs=4,
    rollout_steps=12, total_steps=48, batch_size=16,
)  # fmt: skip


def filled(kind: Any, gamma: float, durations: Any = None) -> Any:
    rng, space = np.random.default_rng(0), make_vec_env(TINY.env_settings, 1, 0)
    buffer = kind(7, space.observation_space, space.action_space, "cpu", gae_lambda=0.9, gamma=gamma, n_envs=3)
    buffer.reset()
    for _ in range(7):
        values, logs = torch.from_numpy(rng.normal(size=(2, 3)).astype(np.float32))
        buffer.add(
            rng.normal(size=(3, 10)), rng.normal(size=(3, 1)), rng.normal(size=3), rng.random(3) < 0.3, values, logs
        )
    if durations is not None:
        buffer.durations[:] = durations
    last = torch.from_numpy(rng.normal(size=(3, 1)).astype(np.float32))
    buffer.compute_returns_and_advantage(last, np.array([False, True, False]))
    return buffer


def test_equal_durations_are_one_discount_per_decision() -> None:
    ours, theirs = filled(DurationBuffer, 0.8, 1.5), filled(RolloutBuffer, 0.8**1.5)
    np.testing.assert_allclose(ours.advantages, theirs.advantages, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(ours.returns, theirs.returns, rtol=1e-5, atol=1e-6)
    other = filled(DurationBuffer, 0.8, np.linspace(0.2, 2.0, 21).reshape(7, 3))
    assert abs(other.advantages - theirs.advantages).max() > 0.01


def test_values_after_the_time_limit_are_discounted_as_ppo_does() -> None:
    learnt = list[torch.Tensor]()
    ours: list[BaseCallback] = [Durations()]
    plain: dict[str, Any] = {"rollout_buffer_class": RolloutBuffer}
    for gamma, more, callbacks in ((0.8, {}, ours), (0.8**2, plain, []), (0.8, plain, [])):
        settings = replace(FLOATING, gamma=gamma)
        model = make_ppo(settings, make_vec_env(settings.env_settings, 4, 0), **more)
        model.learn(96, callback=callbacks)
        learnt.append(torch.cat([weight.flatten() for weight in model.policy.state_dict().values()]))
    torch.testing.assert_close(learnt[0], learnt[1], rtol=1e-5, atol=1e-6)
    assert (learnt[0] - learnt[2]).abs().max() > 1e-4


def test_settings_with_a_setting_that_went_are_read() -> None:
    assert TrainSettings.of({**asdict(TINY), "max_minutes": None}) == TINY
