"""Models trained without this project's command: played as trained, or refused with the option that would help."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import A2C, PPO, SAC, TD3
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecFrameStack, VecNormalize

from agents.policies.models import Options
from agents.policies.registry import find_policy
from agents.settings import EPISODE_STEPS, EnvSettings, TrainSettings
from agents.training.models import make_ppo, make_vec_env
from jackbox_env import Drive, LandingControl, Scene, Task
from jackbox_env.sb3 import make_sb3_vec_env, save_model
from jackbox_env.sb3_wrappers import HoldingVecEnv, LandingControlVecEnv, LookaheadVecEnv
from jackbox_env.tasks import juggle
from tests.agents.small_run import TINY
from tests.agents.test_commands import script

HERE = EnvSettings(fidelity="exact")
# Landing control computes torques from observations, which are rounded to float32, and each impact multiplies the
# difference: after 2 s it is about 1e-6, whatever the machine, and after 6 s everything.
SHORT = 100  # control steps


def native(count: int = 2, **keywords: Any) -> Any:
    return make_sb3_vec_env(count, fidelity="exact", **keywords)


def single_of() -> Any:
    return gym.make("JackInBox-v0", fidelity="exact", max_episode_steps=SHORT)


def single(**landing: Any) -> VecEnv:
    return DummyVecEnv([lambda: Monitor(LandingControl(single_of(), **landing))])


def trained(envs: VecEnv, steps: int = 64) -> PPO:
    """A PPO that acts strongly; a little training updates statistics and stores observations."""
    model = PPO("MlpPolicy", envs, n_steps=32, batch_size=32, n_epochs=1, learning_rate=0.0, seed=0, device="cpu")
    network: Any = model.policy.action_net
    network.weight.data *= 100.0
    return model.learn(steps)


def earned(policy: Any, count: int = 2, steps: int = EPISODE_STEPS) -> Any:
    """Returns of two episodes without wrappers."""
    plain = native(count, max_episode_steps=steps)
    plain.seed(3)
    return evaluate_policy(policy, plain, 2, return_episode_rewards=True)[0]


WRAPPED: dict[str, tuple[Callable[[], VecEnv], Options]] = {
    "torques": (native, Options(repeat=1)),
    "held": (lambda: HoldingVecEnv(native(), 4), Options(repeat=4)),
    "bounce": (lambda: LandingControlVecEnv(native(max_episode_steps=SHORT), period="bounce"), Options("bounce")),
    "period": (lambda: LandingControlVecEnv(native(max_episode_steps=SHORT), period=0.2), Options(0.2)),
    "single": (lambda: single(period="bounce"), Options(landing="bounce")),
    "normalized": (lambda: VecNormalize(HoldingVecEnv(native(), 5)), Options(repeat=5, vecnormalize=Path("stats.pkl"))),
}


@pytest.mark.parametrize("name", WRAPPED)
def test_a_saved_model_acts_as_it_was_trained(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make, options = WRAPPED[name]
    monkeypatch.chdir(tmp_path)
    envs = make()
    model = trained(envs)
    assert save_model(model, tmp_path / "model") == tmp_path / "model.zip"
    if isinstance(envs, VecNormalize):
        envs.save("stats.pkl")
        envs.training = envs.norm_reward = False
    saved = find_policy("model.zip", HERE, trust=True).policy
    (tmp_path / "env.json").rename(tmp_path / "elsewhere.json")
    by_options = find_policy("model.zip", HERE, trust=True, options=options).policy
    envs.seed(3)
    under_wrappers, _ = evaluate_policy(model, envs, 2, return_episode_rewards=True)
    steps, tolerance = (EPISODE_STEPS, 1e-12) if options.landing is None else (SHORT, 1e-4)
    for policy in (saved, by_options):
        np.testing.assert_allclose(earned(policy, envs.num_envs, steps), under_wrappers, rtol=tolerance)


@pytest.mark.parametrize(
    ("name", "other"), [("held", Options(repeat=1)), ("bounce", Options(0.2)), ("period", Options("bounce"))]
)
def test_otherwise_it_would_earn_something_else(name: str, other: Options, tmp_path: Path) -> None:
    make, options = WRAPPED[name]
    trained(make()).save(tmp_path / "model.zip")
    one, another = (
        earned(find_policy(str(tmp_path / "model.zip"), HERE, trust=True, options=by).policy, steps=SHORT)
        for by in (options, other)
    )
    assert one != pytest.approx(another, rel=1e-3)


def test_a_lookahead_is_stored_with_its_options(tmp_path: Path) -> None:
    envs = LookaheadVecEnv(native(), hold=10, turns=3, samples=8, pieces=8, follow=True)
    save_model(trained(envs), tmp_path / "model.zip")
    policy: Any = find_policy(str(tmp_path / "model.zip"), HERE, trust=True).policy
    actions, memory = policy.predict(np.zeros((2, 10), np.float32))
    assert actions.shape == (2, 1)
    assert memory.repeats.tolist() == [9, 9]
    assert memory.plans is not None


@pytest.mark.parametrize("algorithm", [A2C, SAC, TD3])
def test_other_algorithms_load_too(algorithm: Any, tmp_path: Path) -> None:
    model = algorithm("MlpPolicy", native(1), device="cpu")
    save_model(model, tmp_path / "model.zip")
    policy: Any = find_policy(str(tmp_path / "model.zip"), HERE, trust=True).policy
    assert type(policy.model) is algorithm


VARIED: list[tuple[Callable[[], VecEnv], str, str]] = [
    (lambda: LandingControlVecEnv(native(), period=0.2), '{"gravity": [1, 2], "box_mass": [300, 500]}', "landings"),
    (lambda: LookaheadVecEnv(native(), samples=8, pieces=8), '{"jack_mass": [2, 6]}', "rollouts"),
    (lambda: LandingControlVecEnv(native(), period=0.2), '{"jack_mass": [2, 6]}', ""),  # they do not depend on it
    (lambda: HoldingVecEnv(native(), 4), '{"gravity": [1, 2]}', ""),
]


@pytest.mark.parametrize(("make", "ranges", "computed"), VARIED)
def test_what_is_computed_in_one_scene_is_not_played_in_scenes_that_vary(
    make: Callable[[], VecEnv], ranges: str, computed: str, tmp_path: Path
) -> None:
    save_model(PPO("MlpPolicy", make()), tmp_path / "model.zip")
    settings, name = EnvSettings(randomize=ranges), str(tmp_path / "model.zip")
    if not computed:
        find_policy(name, settings, trust=True)
        return
    fields = " and ".join(json.loads(ranges))
    with pytest.raises(ValueError, match=f"{computed} in one scene: leave {fields} out of --randomize"):
        find_policy(name, settings, trust=True)


# -- env.json ----------------------------------------------------------------------------------------------------------


def entry(folder: Path) -> Any:
    return json.loads((folder / "env.json").read_text())["model.zip"]


def test_the_environment_is_stored_where_it_differs_and_functions_are_left_out(tmp_path: Path) -> None:
    save_model(PPO("MlpPolicy", native(task="spin", scene={"gravity": 2}, control_dt=0.01)), tmp_path / "model.zip")
    env = {"task": "spin", "fidelity": "exact", "control_dt": 0.01, "scene": {"gravity": 2.0}}
    assert entry(tmp_path)["env"] == env
    of_mine = native(task=Task(("a",), juggle), scene=Scene(drive=Drive(np.cos)), randomize=lambda rng: {})
    save_model(PPO("MlpPolicy", of_mine), tmp_path / "model.zip")
    assert entry(tmp_path)["env"] == {"task": None, "fidelity": "exact"}
    assert entry(tmp_path)["functions"] == ["task", "randomize", "scene"]


def test_settings_of_single_environments_are_named(tmp_path: Path) -> None:
    scenes = [{"gravity": 2.0}, {"gravity": 3.0, "jack_mass": 5.0}]
    envs = native(scene=scenes, control_dt=np.float32(0.5), randomize={"box_mass": np.array([300, 400])})
    save_model(PPO("MlpPolicy", envs), tmp_path / "model.zip")
    assert entry(tmp_path)["each"] == ["scene"]
    expected = {"task": "juggle", "fidelity": "exact", "control_dt": 0.5, "randomize": {"box_mass": [300, 400]}}
    assert entry(tmp_path)["env"] == expected
    tasks = DummyVecEnv([partial(gym.make, "JackInBox-v0", task=task) for task in ("spin", "juggle")])
    save_model(PPO("MlpPolicy", tasks), tmp_path / "model.zip")
    assert (entry(tmp_path)["each"], entry(tmp_path)["env"]) == (["task"], {"scene": {}})
    save_model(PPO("MlpPolicy", native(scene=scenes[:1] * 2)), tmp_path / "model.zip")
    assert (entry(tmp_path)["each"], entry(tmp_path)["env"]["scene"]) == ([], scenes[0])


def test_models_share_a_folder_and_a_renamed_one_is_known(tmp_path: Path) -> None:
    one, other = tmp_path / "model.zip", tmp_path / "other.zip"
    save_model(PPO("MlpPolicy", HoldingVecEnv(native(), 4)), one)
    one.rename(other)
    assert find_policy(str(other), HERE, trust=True).policy.repeat == 4  # type: ignore[attr-defined]
    save_model(PPO("MlpPolicy", native()), one)
    save_model(PPO("MlpPolicy", HoldingVecEnv(native(), 2)), other)
    assert find_policy(str(one), HERE, trust=True).policy.repeat == 1  # type: ignore[attr-defined]
    other.rename(tmp_path / "third.zip")  # env.json has two entries, but none of this name: options describe it
    by_options = find_policy(str(tmp_path / "third.zip"), HERE, trust=True, options=Options(repeat=3)).policy
    assert by_options.repeat == 3  # type: ignore[attr-defined]
    with pytest.raises(
        ValueError, match=r"model.zip acts as env.json beside it describes: leave --repeat out, or move"
    ):
        find_policy(str(one), HERE, trust=True, options=Options(repeat=3))
    stored = json.loads((tmp_path / "env.json").read_text())
    stored["model.zip"]["normalize"] = {"mean": [0.0], "variance": [1.0], "clip": 10.0, "epsilon": 1e-8}
    (tmp_path / "env.json").write_text(json.dumps(stored))
    with pytest.raises(ValueError, match="mean and variance must be 10 numbers each"):
        find_policy(str(one), HERE, trust=True)
    (tmp_path / "env.json").write_text('{"model.zip": {}}')
    for call in (lambda: find_policy(str(one), HERE, trust=True), lambda: save_model(PPO("MlpPolicy", native()), one)):
        with pytest.raises(ValueError, match=r"env.json: model.zip must have env, .*, got {}"):
            call()


def test_a_model_of_another_environment_is_not_saved(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="save_model needs a model with environments of JackInBox-v0"):
        save_model(PPO("MlpPolicy", "Pendulum-v1"), tmp_path / "model.zip")
    assert not list(tmp_path.iterdir())


# -- what does not fit -------------------------------------------------------------------------------------------------

REFUSED: dict[str, tuple[Callable[[], VecEnv], list[str], str]] = {
    "landing": (
        lambda: LandingControlVecEnv(native(), period="bounce"), [],
        r"must observe 10 numbers and choose 1, got shapes \(10,\) and \(2,\); LandingControlVecEnv would fit: use --",
    ),
    "torques": (native, ["--landing", "0.4"], "actions are torques: leave --landing out"),
    "lookahead": (
        lambda: LookaheadVecEnv(native(), samples=8, pieces=8), [],
        r"LookaheadVecEnv would perhaps fit: save the model by jackbox_env.sb3.save_model",
    ),
    "stacked": (lambda: VecFrameStack(native(), 3), [], "VecFrameStack would perhaps fit"),
    "statistics": (
        lambda: VecNormalize(native()), ["--repeat", "2"],
        "was trained under VecNormalize, whose statistics are missing: use --vecnormalize FILE.pkl, or save it by jack",
    ),
    "other statistics": (native, ["--vecnormalize", "model.zip"], "model.zip has no statistics of VecNormalize: "),
    "both": (native, ["--landing", "bounce", "--repeat", "4"], "cannot act by --landing and --repeat 4: a landing"),
    "repeat": (native, ["--repeat", "0"], "repeat must be a whole number from 1 to 500, got 0"),
    "period": (native, ["--landing", "0"], "landing must be a finite number above 0 and at most 10, got 0.0"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_a_model_that_does_not_fit_is_refused_with_what_would(name: str, tmp_path: Path) -> None:
    make, options, sentence = REFUSED[name]
    trained(make()).save(tmp_path / "model.zip")
    done = script("evaluate", "--policy", "model.zip", "--trust", *options, cwd=tmp_path, status=2)
    (line,) = done.stderr.splitlines()
    assert line.startswith("model.zip ")
    with pytest.raises(ValueError, match=sentence):
        raise ValueError(line)


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: VecFrameStack(native(), 3), "VecFrameStack"),
        (lambda: VecNormalize(VecNormalize(native())), "a second VecNormalize"),
        (lambda: HoldingVecEnv(HoldingVecEnv(native(), 2), 2), "HoldingVecEnv around another that repeats actions"),
        (lambda: native(torque="chirp"), "torque='chirp'"),
        (
            lambda: DummyVecEnv([partial(LandingControl, single_of(), period=period) for period in (1, 2)]),
            "wrappers that differ between its environments",
        ),
    ],
)
def test_an_unknown_wrapper_is_named(make: Callable[[], VecEnv], name: str, tmp_path: Path) -> None:
    save_model(trained(make()), tmp_path / "model.zip")
    with pytest.raises(ValueError, match=f"was trained under {name}, which cannot be played here"):
        find_policy(str(tmp_path / "model.zip"), HERE, trust=True)


def test_without_env_json_and_in_another_environment_there_is_a_note(tmp_path: Path) -> None:
    save_model(trained(native(task="spin")), tmp_path / "model.zip")
    few = ["--policy", "model.zip", "--episodes", "1"]
    done = script("evaluate", *few, "--trust", cwd=tmp_path)
    assert "Note: model.zip was trained in another environment (task spin, fidelity exact)" in done.stderr
    assert "Note:" not in script("evaluate", *few, "--trust", "--task", "spin", cwd=tmp_path).stderr
    assert "use --trust" in script("evaluate", *few, cwd=tmp_path, status=2).stderr
    done = script("evaluate", "--policy", "level", "--repeat", "4", cwd=tmp_path, status=2)
    assert done.stderr == "--landing, --repeat and --vecnormalize are for model files, got level\n"
    save_model(trained(native(task=Task(("a",), juggle))), tmp_path / "model.zip")
    done = script("evaluate", *few, "--trust", cwd=tmp_path)
    assert "Note: model.zip was trained with task by functions of its own; here it plays on task juggle" in done.stderr
    several = native(scene=[{}, {"gravity": 2}], max_episode_steps=1000)
    save_model(trained(several), tmp_path / "model.zip")
    done = script("evaluate", *few, "--trust", cwd=tmp_path)
    assert "with another scene in each environment, episodes of 1000 steps, not of 500; here it plays" in done.stderr
    assert done.stderr.count("Note:") == 1
    (tmp_path / "env.json").unlink()
    done = script("evaluate", *few, "--trust", cwd=tmp_path)
    assert "Note: no env.json beside model.zip describes it, so it decides in every control step" in done.stderr


# -- loaded where there is no checkout of this project -----------------------------------------------------------------

LOADING = """
import sys
class Refused:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("agents", "jackbox_env", "scripts", "tests"):
            raise ModuleNotFoundError(f"No module named {name!r}")
sys.meta_path.insert(0, Refused())
import numpy as np
from stable_baselines3 import PPO
model = PPO.load("model.zip")
print(model.lr_schedule(0.5), model.predict(np.zeros((3, 10), np.float32), deterministic=True)[0].ravel().tolist())
"""


def test_a_saved_model_loads_without_this_project_and_stores_its_settings(tmp_path: Path) -> None:
    settings = dataclasses.replace(TINY, repeat=4)
    model = make_ppo(settings, make_vec_env(settings.env_settings, 2, 0))
    model.save(tmp_path / "model.zip")
    actions, _ = model.policy.predict(np.zeros((3, 10), np.float32), deterministic=True)
    command = [sys.executable, "-W", "error::UserWarning", "-c", LOADING]
    out = subprocess.check_output(command, cwd=tmp_path, env={**os.environ, "PYTHONPATH": ""}, text=True)
    assert out == f"{0.5 * TINY.learning_rate} {actions.ravel().tolist()}\n"
    again: Any = PPO.load(tmp_path / "model.zip", device="cpu")
    assert TrainSettings.of(again.trained_by) == settings
    for remaining in (1.0, 0.25, 0.0):  # it falls to 0
        assert model.lr_schedule(remaining) == pytest.approx(TINY.learning_rate * remaining, abs=1e-18)
