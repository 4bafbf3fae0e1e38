"""Steps in PyTorch, environments for Stable-Baselines3 and its saved models refuse in one sentence."""

from __future__ import annotations

import json
import math
from functools import cache, partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from sb3_contrib import ARS
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

import jackbox_env.torch
from agents.policies.registry import find_policy
from jackbox_env.sb3 import Durations, make_sb3_vec_env, save_model
from scripts import evaluate
from tests.agents.test_saved_models import HERE, Other, native
from tests.refusals.sentences import (
    START,
    Refusal,
    Subject,
    assert_refused,
    command,
    contents,
    files,
    fill,
    folder,
    rows,
    single,
)
from tests.states import started

# -- torch and Stable-Baselines3 ---------------------------------------------------------------------------------------

FLOOR = torch.tensor(
    [[0.0] * 12, [0.0] * 4 + [-5.0] + [0.0] * 5 + [-1.0, 0.0]], dtype=torch.float64
)  # an impact at once
SHARES = torch.full((3, 1), 0.1, requires_grad=True)
ANY: Any = jackbox_env.torch.step
NATIVE = Subject(
    partial(make_sb3_vec_env, 3, contact="exact"),
    lambda envs: (envs.seed(1), envs.set_options(), envs.reset()),
    lambda envs: [envs.get_attr(name) for name in ("state", "time")],
)


def monitored() -> Any:
    return started(VecMonitor(make_sb3_vec_env(2, contact="exact", max_episode_steps=1), info_keywords=("impacts",)))


WITHOUT = "Durations needs environments whose infos have 'duration', got infos without"


def learn(algorithm: Any, first: Any = True, again: Any = True, envs: Any = None, **more: Any) -> None:
    """Train twice, with Durations unless it is None."""
    of_ppo = {"n_steps": 9, "batch_size": 9, "n_epochs": 1} if algorithm is PPO else {}
    policy = "MlpPolicy" if algorithm is not ARS else "LinearPolicy"
    model = algorithm(policy, envs or make_sb3_vec_env(1, contact="exact"), device="cpu", **of_ppo, **more)
    for callback in (first, again):
        model.learn(9, callback=callback and Durations())


LEARNING = [
    Refusal(
        lambda _: ANY(None, FLOOR, torch.full((2,), 0.1, requires_grad=True)),
        ValueError,
        'states must have a derivative, 1 of 2 have none, the first is states[1]; nonsmooth="zero" uses 0',
    ),
    *(
        Refusal(
            lambda _, bad=bad: ANY(None, torch.zeros((2, 12)), torch.tensor([0.0, bad])),
            ValueError,
            f"actions must be finite numbers (clipped to [-1, 1]), got {bad}",
        )
        for bad in (math.nan, math.inf, -math.inf)
    ),
    Refusal(
        lambda _: ANY(None, torch.zeros(12), SHARES),
        ValueError,
        "states and actions must have shapes (N, 12) and (N,) or (N, 1), got (12,), (3, 1)",
    ),
    Refusal(
        lambda _: ANY(None, torch.zeros((3, 12)), SHARES, task="rattle"),
        ValueError,
        "task must be one of 'juggle', 'spin', got 'rattle'",
    ),
    Refusal(
        lambda _: ANY(None, torch.zeros((3, 12)), SHARES, nonsmooth="ignore"),
        ValueError,
        "nonsmooth must be one of 'raise', 'zero', got 'ignore'",
    ),
    Refusal(
        lambda _: ANY(None, np.zeros((3, 12)), SHARES), TypeError, "states must be a torch.Tensor of floats, got ..."
    ),
    Refusal(
        lambda env: env.step(torch.ones(1, requires_grad=True)),
        TypeError,
        "action must be a finite number (clipped to [-1, 1]), got a tensor that requires grad: pass its detach()",
        single(),
    ),
    Refusal(
        lambda _: make_sb3_vec_env(2, with_info=True),
        TypeError,
        "the vector environment of JackInBox-v0 has no argument 'with_info' (did you mean 'with_infos'?): it accepts "
        "num_envs, ...",
    ),
    Refusal(
        lambda _: make_sb3_vec_env(2, autoreset_mode="Disabled"),
        TypeError,
        "make_sb3_vec_env has no argument 'autoreset_mode': an episode that ends starts anew in its step",
    ),
    Refusal(
        lambda _: make_sb3_vec_env(1, max_episode_steps=126, action_repeat=4),
        ValueError,
        "max_episode_steps (shortens an episode of episode_steps=500) must be a whole number from 1 to 125, got 126",
    ),
    Refusal(
        lambda envs: envs.step(np.zeros((2, 1))),
        ValueError,
        "actions must have shape (3, 1) or (3,), got shape (2, 1)",
        NATIVE,
    ),
    Refusal(
        lambda envs: envs.set_attr("state", START),
        AttributeError,
        "state cannot be assigned, got ...: set_state changes it",
        NATIVE,
    ),
    *(
        Refusal(
            lambda envs, bad=bad: (envs.set_options([{"time": 3.0}, bad, {}]), envs.reset()),
            ValueError,
            sentence,
            NATIVE,
        )
        for bad, sentence in (
            ({"bogus": 1}, "options accepts only 'state', 'time', 'scene', got 'bogus'"),
            ({"time": math.nan}, "options['time'] must be a finite number at least -1e+09 and at most 1e+09, got nan"),
            ({"state": np.ones(11)}, "options['state'] must have shape (12,) or (3, 12), got shape (11,)"),
            ({"reset_mask": np.ones(3, bool)}, "options accepts only 'state', 'time', 'scene', got 'reset_mask'"),
        )
    ),
    Refusal(
        lambda envs: envs.step(np.zeros((2, 1))),
        KeyError,
        "\"infos have 'impacts' only in environments made with with_infos=True\"",
        Subject(monitored),
    ),
    Refusal(
        lambda envs: envs.venv.step(np.zeros((2, 1)))[3][0]["something"], KeyError, "'something'", Subject(monitored)
    ),
    *(
        Refusal(lambda _, model=model, more=more: learn(model, **more), kind, sentence)
        for model, more, kind, sentence in (
            (PPO, {"again": None}, RuntimeError, "the durations of decisions are missing: train with the callback ..."),
            (SAC, {"first": None}, ValueError, "Durations must be used from the first step on, got a model of 9 steps"),
            (
                SAC,
                {"n_steps": 2},
                TypeError,
                "Durations needs a ReplayBuffer with n_steps=1 and without optimize_memory_usage, got NStep...",
            ),
            (ARS, {}, TypeError, "ARS has no discount: train it without Durations"),
            (PPO, {"envs": "Pendulum-v1"}, ValueError, WITHOUT),
            (SAC, {"envs": "Pendulum-v1"}, ValueError, WITHOUT),
        )
    ),
]

# -- models of Stable-Baselines3 ---------------------------------------------------------------------------------------


@cache
def stored() -> dict[str, str | bytes]:
    """A saved model and its env.json."""
    fill(folder(), {})
    save_model(PPO("MlpPolicy", native(1)), folder() / "model.zip")
    return {path.name: path.read_bytes() for path in folder().iterdir()}


def damaged(sentence: str, **change: Any) -> Refusal:
    def start(path: Path) -> None:
        entry = {**json.loads(stored()["env.json"])["model.zip"], **change}
        fill(path, {**stored(), "env.json": json.dumps({"model.zip": entry if change else {}})})

    return Refusal(
        lambda _: find_policy("model.zip", HERE, trust=True), ValueError, sentence, Subject(folder, start, contents)
    )


def misfit(sentence: str, option: str) -> Refusal:
    """A saved model that is evaluated elsewhere than it was trained."""
    evaluates = command(evaluate.main, "--policy", "model.zip", "--trust", "--env", option)
    return Refusal(evaluates, SystemExit, sentence, Subject(folder, lambda path: fill(path, stored()), contents))


STATISTICS = {"mean": [0.0] * 10, "variance": [], "clip": 1.0, "epsilon": 1e-8}
DAMAGED: tuple[dict[str, Any], ...] = ({}, {"missing": 5}, {"missing": "abc"}, {"env": []})
BESIDE = "env.json: model.zip must have algorithm (str), env (dict), missing (list)"
MODELS = [
    Refusal(
        lambda _: find_policy("model.zip", HERE),
        ValueError,
        "model.zip can run code, as it is unpickled: if you trust its author, use --trust or trust=True",
        Subject(folder, lambda path: fill(path, stored()), contents),
    ),
    Refusal(
        lambda _: find_policy("best_model.zip", HERE),
        FileNotFoundError,
        "best_model.zip needs an env.json beside it that describes its environment: load it with its environments, as "
        "PPO.load(path, env=envs), and save it by jackbox_env.sb3.save_model",
        files({"best_model.zip": "a"}),
    ),
    Refusal(
        lambda _: find_policy("mine.py:none", HERE, trust=True),
        ValueError,
        "mine.py:none cannot be imported: AttributeError: ...",
        files({"mine.py": ""}),
    ),
    damaged(
        "model.zip cannot be played as env.json describes and options change: ValueError: mean and variance "
        "must be arrays of shape (10,), at least 0 in the variance",
        wrappers=[STATISTICS],
    ),
    damaged(
        "model.zip cannot be played as env.json describes and options change: ValueError: mean and variance "
        "must be arrays of shape (10,), at least 0 in the variance",
        wrappers=[{**STATISTICS, "variance": [-1.0] * 10}],
    ),
    damaged(
        "model.zip cannot be played as env.json describes and options change: ValueError: stack must be a whole "
        "number from 1 to 1000, got 0",
        wrappers=[{"stack": 0}],
    ),
    damaged(
        "model.zip is no model of env.json beside it: ValueError: its algorithm must be of "
        "stable_baselines3 or sb3_contrib, got 'os:system'",
        algorithm="os:system",
    ),
    damaged(
        "model.zip cannot be played as env.json describes and options change: ValueError: observation must be "
        "one of 'state', 'landing', 'pixels', got 'sea'",
        env={"observation": "sea"},
    ),
    damaged(
        "... cannot be used: ValueError: nowhere.py:x cannot be imported: FileNotFoundError: [Errno 2] No such file or "
        "directory: 'nowhere.py'",
        env={"observation": "nowhere.py:x"},
    ),
    *(damaged(f"{BESIDE}, wrappers (list), got {'...' if change else '{}'}", **change) for change in DAMAGED),
    damaged("env.json cannot store the 5 that model.zip was trained with: load it with 5=..., or ...", missing=[5]),
    damaged(
        "model.zip cannot be played as env.json describes and options change: ValueError: mean and variance "
        "must be arrays of shape (20,), at least 0 in the variance",
        wrappers=[{"stack": 2}, {**STATISTICS, "variance": [1.0] * 10}],
    ),
    damaged(
        "model.zip cannot be played as env.json describes and options change: ValueError: Pixels must be at "
        "most 100,000,000 in all pictures, got Pixels(size=(4096, 4096), stack=4095)",
        env={"observation": "pixels-4096x4096x4095"},
    ),
    Refusal(
        lambda _: save_model(PPO("MlpPolicy", "Pendulum-v1"), Path("model.zip")),
        TypeError,
        "save_model needs a model with environments of JackInBox-v0, got <stable_baselines3...",
        files({}),
    ),
    Refusal(
        lambda _: save_model(
            PPO("MlpPolicy", DummyVecEnv([lambda: Other(gym.make("JackInBox-v0"))])), Path("model.zip")
        ),
        ValueError,
        "save_model cannot store Other: of wrappers that change observations or actions it stores "
        "VecNormalize and VecFrameStack",
        files({}),
    ),
    Refusal(
        lambda _: save_model(
            PPO("MlpPolicy", native(2, scene=[{"gravity": 1.0}, {"gravity": 2.0}])), Path("model.zip")
        ),
        ValueError,
        "save_model needs environments with the same scene, got several",
        files({}),
    ),
    misfit(
        "model.zip is no model of env.json beside it: ValueError: Action spaces do not match: "
        "Box(-1.0, 1.0, (1,), float32) != Box(-1.0, 1.0, (2,), float32)",
        "action=landing",
    ),
    misfit(
        "model.zip cannot be played as env.json describes and options change: ValueError: action_repeat must be "
        "a whole number from 1 to 1000000, got 0",
        "action_repeat=0",
    ),
]


@pytest.mark.filterwarnings("ignore:The environment is already wrapped with a `Monitor`")
@rows([*LEARNING, *MODELS])
def test_stable_baselines3_gets_one_sentence_and_nothing_has_changed(row: Refusal) -> None:
    assert_refused(row)


@pytest.mark.filterwarnings("ignore:The environment is already wrapped with a `Monitor`")
def test_a_monitor_records_infos_that_environments_have() -> None:
    envs = started(
        VecMonitor(make_sb3_vec_env(1, contact="exact", max_episode_steps=1, with_infos=True), None, ("impacts",))
    )
    assert envs.step(np.zeros((1, 1)))[3][0]["episode"]["impacts"] == 0
