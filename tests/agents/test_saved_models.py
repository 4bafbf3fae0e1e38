"""Models trained without this project's command: played where they were trained, or refused with what would help."""

from __future__ import annotations

import dataclasses
import json
import runpy
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import DQN, PPO, SAC
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecFrameStack, VecNormalize

from agents.evaluation import returns
from agents.evaluation.returns import evaluate
from agents.policies.registry import find_policy
from agents.settings import EnvSettings
from agents.training.models import derived_seed, make_ppo, make_vec_env
from jackbox_env import Action, Drive, Observation, Scene, Task
from jackbox_env.sb3 import Durations, load_model, make_sb3_vec_env, save_model
from tests.agents.small_run import TINY

HERE = EnvSettings(fidelity="exact")
COUNT = 3  # environments


def heights(scene: Any, state: Any, time: float) -> tuple[float, float]:
    return (state.y_jack - state.y_box) / scene.box_half_width, 0.1 * state.omega_box


HEIGHT = Observation(("height", "rate"), -1.0, 1.0, heights)
PUSH = Action(gym.spaces.Box(-2.0, 2.0, (1,)), lambda scene, state, action, time, dt: 0.5 * action[0])
TURNED = Task(("turned",), lambda scene, state, torque, impulse: (state.theta_box,))


def native(count: int = COUNT, **keywords: Any) -> Any:
    return make_sb3_vec_env(count, fidelity="exact", **keywords)


def single(**keywords: Any) -> VecEnv:
    made: Any = gym.make("JackInBox-v0", fidelity="exact", **keywords)
    return DummyVecEnv([lambda: Monitor(made)])


def trained(envs: VecEnv, steps: int = 64, policy: str = "MlpPolicy") -> PPO:
    """A PPO that acts strongly; a little training updates statistics and stores observations."""
    model = PPO(policy, envs, n_steps=32, batch_size=32, n_epochs=1, learning_rate=0.0, seed=0, device="cpu")
    network: Any = model.policy.action_net
    network.weight.data *= 100.0
    return model.learn(steps, callback=Durations())


PLAYED: dict[str, tuple[Callable[[], VecEnv], Callable[[VecEnv], Any]]] = {
    "repeat": (lambda: native(action_repeat=4), trained),
    "bounce": (lambda: native(observation="landing", action="landing", action_repeat="bounce"), trained),
    "discrete": (lambda: native(action="discrete", action_repeat=5), trained),
    "own": (
        lambda: native(
            observation=HEIGHT,
            action=PUSH,
            task=TURNED,
            action_repeat=5,
            scene={"gravity": 2.0},
            randomize={"jack_mass": (2, 6)},
        ),
        trained,
    ),
    "pymunk": (lambda: make_sb3_vec_env(COUNT, action_repeat=10), trained),
    "stacked, then normalized": (lambda: VecNormalize(VecFrameStack(native(action_repeat=5), 2)), trained),
    "normalized, then stacked": (lambda: VecFrameStack(VecNormalize(native(action_repeat=5)), 2), trained),
    "pictures, stacked": (
        lambda: VecFrameStack(native(observation="pixels-36x36x1", action_repeat=10, episode_steps=100), 2),
        partial(trained, policy="CnnPolicy"),
    ),
    "SAC": (lambda: native(action_repeat=10), lambda envs: SAC("MlpPolicy", envs, buffer_size=100, device="cpu")),
    "DQN": (
        lambda: native(action="discrete", action_repeat=10),
        lambda envs: DQN("MlpPolicy", envs, buffer_size=100, device="cpu"),
    ),
    "RecurrentPPO": (
        lambda: native(action_repeat=10),
        lambda envs: pytest.importorskip("sb3_contrib").RecurrentPPO(
            "MlpLstmPolicy", envs, n_steps=32, batch_size=32, n_epochs=1, device="cpu", seed=0
        ),
    ),
}


@pytest.mark.parametrize("name", PLAYED)
def test_a_saved_model_earns_what_it_earns_where_it_was_trained(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make, train = PLAYED[name]
    envs = make()
    model = train(envs)
    assert save_model(model, tmp_path / "model") == tmp_path / "model.zip"
    monkeypatch.setattr(returns, "SIDE_BY_SIDE", COUNT)
    saved = evaluate("", find_policy(str(tmp_path / "model.zip"), HERE, trust=True), HERE.env_settings, 5, 7)
    for layer in (envs, getattr(envs, "venv", None)):
        if isinstance(layer, VecNormalize):
            layer.training = layer.norm_reward = False
    for actor, its in ((model, envs), load_model(tmp_path / "model", COUNT, trust=True)):
        its.seed(derived_seed("evaluation", 7))
        assert evaluate_policy(actor, its, 5, return_episode_rewards=True)[0] == list(saved.returns)
    assert len(set(saved.returns)) == 5
    assert saved.environments == envs.num_envs


# -- env.json ----------------------------------------------------------------------------------------------------------


def entry(folder: Path) -> Any:
    return json.loads((folder / "env.json").read_text())["model.zip"]


def test_the_environment_is_stored_with_objects_by_name(tmp_path: Path) -> None:
    keywords: dict[str, Any] = {"task": "spin", "scene": {"gravity": np.int64(2)}, "control_dt": 0.01}
    save_model(PPO("MlpPolicy", native(**keywords, max_episode_steps=50)), tmp_path / "model.zip")
    _, longer = load_model(tmp_path / "model", trust=True, episode_steps=70, contact="pymunk")
    assert (longer.get_attr("max_episode_steps"), longer.get_attr("contact")) == ([70], ["pymunk"])
    exact = {"fidelity": "exact", "contact": None, "substeps": None}
    stored = {"task": "spin", "scene": {"gravity": 2.0}, "control_dt": 0.01, "max_episode_steps": 50}
    assert entry(tmp_path) == {
        "env": {**exact, **stored}, "missing": [], "wrappers": [], "algorithm": "stable_baselines3.ppo.ppo:PPO",
    }  # fmt: skip
    for unlimited in (native(episode_steps=600), single(episode_steps=600, max_episode_steps=700)):
        save_model(PPO("MlpPolicy", unlimited), tmp_path / "model.zip")
        assert entry(tmp_path)["env"] == {**exact, "episode_steps": 600}
    save_model(PPO("MlpPolicy", native(observation=HEIGHT, action=PUSH)), tmp_path / "model.zip")
    of_tests = {"observation": f"{__name__}:HEIGHT", "action": f"{__name__}:PUSH"}
    assert entry(tmp_path)["env"] == {**exact, **of_tests}
    acting = find_policy(str(tmp_path / "model.zip"), HERE, trust=True)
    assert acting.keywords["observation"] is HEIGHT


def test_objects_without_a_name_are_warned_of_and_asked_for(tmp_path: Path) -> None:
    mine = Observation(("height", "rate"), -1.0, 1.0, heights)
    envs = native(scene=Scene(drive=Drive(np.cos)), observation=mine, randomize=lambda rng: {})
    with pytest.warns(UserWarning, match=r"env.json cannot store scene and observation and randomize, .* --env scene="):
        save_model(PPO("MlpPolicy", envs), tmp_path / "model.zip")
    assert entry(tmp_path)["missing"] == ["scene", "observation", "randomize"]
    chosen: dict[str, Any] = {"scene": {}, "randomize": None}
    with pytest.raises(ValueError, match="cannot store the observation that .* --env observation=file"):
        find_policy(str(tmp_path / "model.zip"), HERE, trust=True, chosen=chosen)
    acting = find_policy(str(tmp_path / "model.zip"), HERE, trust=True, chosen={**chosen, "observation": mine})
    assert acting.keywords["observation"] is mine


SCRIPT = (
    "from stable_baselines3 import PPO\n"
    "from jackbox_env import Observation\n"
    "from jackbox_env.sb3 import make_sb3_vec_env, save_model\n\n"
    'HEIGHT = Observation(("height",), -1.0, 1.0, lambda scene, state, time: (0.1 * state.y_jack,))\n'
)


def test_objects_of_a_script_are_named_by_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "training.py").write_text(
        SCRIPT + 'if __name__ == "__main__":\n'
        '    save_model(PPO("MlpPolicy", make_sb3_vec_env(2, observation=HEIGHT)), "model.zip")\n'
    )
    monkeypatch.chdir(tmp_path)
    runpy.run_path("training.py", run_name="__main__")
    assert entry(tmp_path)["env"]["observation"] == f"{tmp_path}/training.py:HEIGHT"
    acting = find_policy(str(tmp_path / "model.zip"), HERE, trust=True)
    assert acting.keywords["observation"].names == ("height",)
    assert acting.keywords["fidelity"] is None  # gym.make's default, as in its training


def test_a_script_that_trains_when_it_is_run_for_its_objects_saves_nothing(tmp_path: Path) -> None:
    script = tmp_path / "unguarded.py"
    script.write_text(
        SCRIPT + f'save_model(PPO("MlpPolicy", make_sb3_vec_env(2, observation=HEIGHT)), "{tmp_path}/model.zip")\n'
    )
    runpy.run_path(str(script), run_name="__main__")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(ValueError, match="unguarded.py is run for its HEIGHT, so it must train under if"):
        find_policy(str(tmp_path / "model.zip"), HERE, trust=True)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == before


def test_models_share_a_folder_and_a_renamed_one_is_known(tmp_path: Path) -> None:
    def repeat(path: Path, **more: Any) -> Any:
        return find_policy(str(path), HERE, trust=True, **more).keywords["action_repeat"]

    one, other = tmp_path / "model.zip", tmp_path / "other.zip"
    save_model(PPO("MlpPolicy", native(action_repeat=4)), one)
    one.rename(other)
    assert repeat(other) == 4
    save_model(PPO("MlpPolicy", native()), one)
    save_model(PPO("MlpPolicy", native(action_repeat=2)), other)
    assert find_policy(str(one), HERE, trust=True).keywords["action_repeat"] == 1
    assert repeat(other, chosen={"action_repeat": 3}) == 3  # chosen goes first
    other.rename(tmp_path / "third.zip")
    with pytest.raises(FileNotFoundError, match="third.zip needs an env.json beside it"):  # it has two entries
        repeat(tmp_path / "third.zip", chosen={"action_repeat": 3})


class Other(gym.Wrapper[Any, Any, Any, Any]):
    """A wrapper that is not known."""


# -- loaded where there is no checkout of this project -----------------------------------------------------------------


def test_a_saved_model_loads_without_this_project(tmp_path: Path) -> None:
    settings = dataclasses.replace(TINY, action_repeat=4)
    model = make_ppo(settings, make_vec_env(settings.env_settings, 2, 0))
    model.save(tmp_path / "model.zip")
    actions, _ = model.policy.predict(np.zeros((3, 10), np.float32), deterministic=True)
    with pytest.MonkeyPatch.context() as patch:
        for name in [*sys.modules]:
            if name.split(".")[0] in ("agents", "jackbox_env", "scripts", "tests"):
                patch.setitem(sys.modules, name, None)  # importing it raises an error
        loaded = PPO.load(tmp_path / "model.zip")
    assert loaded.lr_schedule(0.5) == 0.5 * TINY.learning_rate
    assert loaded.predict(np.zeros((3, 10), np.float32), deterministic=True)[0].tolist() == actions.tolist()
    for remaining in (1.0, 0.25, 0.0):  # it falls to 0
        assert model.lr_schedule(remaining) == pytest.approx(TINY.learning_rate * remaining, abs=1e-18)
