"""Training and loading."""

from __future__ import annotations

import json
import shutil
import sys
from contextlib import nullcontext
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.vec_env import DummyVecEnv

from agents.runs import read_settings
from agents.settings import TrainSettings
from agents.training import ppo as training
from agents.training.checkpoints import latest_checkpoint
from agents.training.models import make_ppo, make_vec_env
from jackbox_env.sb3 import Durations
from jackbox_env.tools.model_files import read_parameters
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


def test_a_run_with_more_steps_goes_on_from_its_last_model(tmp_path: Path, run: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    last = read_parameters(folder / "model.zip")["policy"]
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


class Bandit(gym.Env[Any, Any]):
    """Long decisions earn more each, short ones more a second: the discount decides."""

    observation_space, action_space = gym.spaces.Box(0.0, 1.0, (1,)), gym.spaces.Box(-1.0, 1.0, (1,))
    seen = np.ones(1, np.float32)

    def reset(self, **_: Any) -> Any:
        self.decisions = 0
        return self.seen, {}

    def step(self, action: Any) -> Any:
        self.decisions += 1
        longer = float(action[0])
        return self.seen, 1.4 + 0.4 * longer, False, self.decisions >= 8, {"duration": 2.0 + longer}


OF_DICTS = {"observation_space": gym.spaces.Dict({"one": Bandit.observation_space}), "seen": {"one": Bandit.seen}}
BANDITS: dict[str, Any] = {
    "PPO": (type("Named", (Bandit,), OF_DICTS), partial(PPO, "MultiInputPolicy", n_steps=64, n_epochs=5)),
    "SAC": (Bandit, partial(SAC, "MlpPolicy", tau=0.05, learning_starts=64, gradient_steps=4, ent_coef=0.02)),
}


@pytest.mark.parametrize("name", BANDITS)
def test_the_discount_by_elapsed_time_picks_the_right_arm(name: str, tmp_path: Path) -> None:
    chosen, (kind, make) = list[float](), BANDITS[name]
    common: dict[str, Any] = {"gamma": 0.8, "batch_size": 64, "learning_rate": 3e-3, "seed": 0, "device": "cpu"}
    for callback in (None, Durations()):
        model = make(env=DummyVecEnv([kind] * 4), policy_kwargs={"net_arch": [16]}, **common)
        model.learn(2048 if name == "PPO" else 1000, callback=callback)
        model.save(tmp_path / "model.zip")
        chosen.append(float(type(model).load(tmp_path / "model.zip").predict(kind.seen, deterministic=True)[0][0]))
    assert chosen[0] > 0.5, "with one discount per decision the long arm is best"
    assert chosen[1] < -0.5


@pytest.mark.parametrize("recurrent", [False, True])
def test_values_after_the_time_limit_are_discounted_as_ppo_does(recurrent: bool) -> None:
    learnt = list[torch.Tensor]()
    for gamma, callback in ((0.8, Durations()), (0.8**2, None), (0.8, None)):
        settings = replace(FLOATING, gamma=gamma)
        environments = make_vec_env(settings.env_settings, 4, 0)
        model: Any = make_ppo(settings, environments)
        if recurrent:
            contrib: Any = pytest.importorskip("sb3_contrib")
            model = contrib.RecurrentPPO("MlpLstmPolicy", environments, n_steps=12, gamma=gamma, seed=0, device="cpu")
        with nullcontext() if callback else pytest.warns(UserWarning, match="last unequally"):
            model.learn(96, callback=callback)
        learnt.append(torch.cat([weight.flatten() for weight in model.policy.state_dict().values()]))
    torch.testing.assert_close(learnt[0], learnt[1], rtol=1e-5, atol=1e-6)
    assert (learnt[0] - learnt[2]).abs().max() > 1e-4


def test_a_training_with_decisions_of_unequal_durations_is_warned_of_it_once() -> None:
    environments = make_vec_env(FLOATING.env_settings, 4, 0)
    model = make_ppo(FLOATING, environments)
    environments.reset()
    environments.step(np.zeros((4, 2)))  # is no training: a warning would be an error
    with pytest.warns(UserWarning, match=r"learn\(n, callback=Durations\(\)\)") as seen:
        model.learn(96)
    assert len(seen) == 1
    # without a discount there is no reason to
    make_ppo(replace(FLOATING, gamma=1.0), make_vec_env(FLOATING.env_settings, 4, 0)).learn(48)


def test_a_loaded_replay_buffer_is_discounted_by_the_model_that_loads_it(tmp_path: Path) -> None:
    for gamma in (0.8, 0.5):
        model: Any = SAC("MlpPolicy", DummyVecEnv([Bandit]), gamma=gamma, device="cpu")
        if gamma == 0.5:
            model.load_replay_buffer(tmp_path / "buffer.pkl")
        model.learn(9, callback=Durations())
        model.save_replay_buffer(tmp_path / "buffer.pkl")
    assert (model.replay_buffer.sample(9).discounts <= 0.5).all()  # at least 0.8**3 by the first gamma


def test_settings_with_a_setting_that_went_are_read() -> None:
    assert TrainSettings.of({**asdict(TINY), "max_minutes": None}) == TINY
