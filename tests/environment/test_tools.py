"""The tools people use with environments: vector environments, wrappers, video, play. No display is needed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pygame
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import (
    ClipAction,
    RescaleAction,
    vector,
)

from jackbox_env import JackInBoxEnv, JackInBoxVectorEnv, Scene
from jackbox_env.envs.settings import Settings
from tests.states import load


def of_stable_baselines(**settings: Any) -> Any:
    subproc = pytest.importorskip("stable_baselines3.common.vec_env.subproc_vec_env")
    made = [lambda: gym.make("jackbox_env:JackInBox-v0", **settings)]  # the prefix imports the package
    return subproc.SubprocVecEnv(made, start_method="spawn")


@pytest.mark.parametrize("mode", ["async", "spawned"])
def test_environments_side_by_side_equal_single_ones_bitwise(mode: Any) -> None:
    settings: dict[str, Any] = {"scene": Scene(gravity=3.0), "task": "rattle"}
    singles = [gym.make("JackInBox-v0", **settings) for _ in range(1 if mode == "spawned" else 2)]
    expected = [single.reset(seed=10 + index) for index, single in enumerate(singles)]
    vector: Any
    if mode == "spawned":
        vector = of_stable_baselines(**settings)
        vector.seed(10)
        observations = vector.reset()
    else:
        vector = gym.make_vec("JackInBox-v0", num_envs=2, vectorization_mode=mode, **settings)
        observations, infos = vector.reset(seed=10)
        np.testing.assert_array_equal(infos["state"], [info["state"] for _, info in expected])
    np.testing.assert_array_equal(observations, [observation for observation, _ in expected])
    for action in np.random.default_rng(0).uniform(-1, 1, (80, len(singles), 1)).astype(np.float32):
        observations, rewards, *_ = vector.step(action)
        steps = [single.step(part) for single, part in zip(singles, action, strict=True)]
        np.testing.assert_array_equal(observations, [step[0] for step in steps])
        np.testing.assert_allclose(rewards, [float(step[1]) for step in steps], rtol=1e-6 if mode == "spawned" else 0.0)
    vector.close()


def test_the_chirp_passes_vector_environments_and_action_wrappers() -> None:
    record = load("seed_scene")[0]
    start = {"state": np.array(record["q"] + record["qdot"])}
    vector = gym.make_vec("JackInBox-v0", num_envs=2, vectorization_mode="sync", torque="chirp")
    five = np.array([-5.0], dtype=np.float32), np.array([5.0], dtype=np.float32)
    wrapped = ClipAction(RescaleAction(gym.make("JackInBox-v0", torque="chirp"), *five))
    envs: list[Any] = [vector, wrapped]
    for env in envs:
        env.reset(options=start)
        for _ in range(50):
            info = env.step(env.action_space.sample())[4]
        for state in np.atleast_2d(info["state"]):
            np.testing.assert_allclose(state, record["states"][9]["state"], atol=1e-12)


def shifted(observations: Any) -> Any:
    return observations + np.float32(0.25)


def test_gymnasiums_batch_wrappers_act_on_the_compiled_batch() -> None:
    settings: dict[str, Any] = {"fidelity": "exact", "action_repeat": 4}
    plain = gym.make_vec("JackInBox-v0", 3, **settings)
    changed = vector.TransformReward(
        vector.TransformObservation(gym.make_vec("JackInBox-v0", 3, **settings), shifted), lambda rewards: 2.0 * rewards
    )
    np.testing.assert_array_equal(changed.reset(seed=1)[0], shifted(plain.reset(seed=1)[0]))
    for actions in np.random.default_rng(0).uniform(-1, 1, (130, 3, 1)).astype(np.float32):  # across a restart
        (observations, rewards, *_), (before, earned, *_) = changed.step(actions), plain.step(actions)
        np.testing.assert_array_equal(observations, shifted(before))
        np.testing.assert_array_equal(rewards, 2.0 * earned)


@pytest.mark.filterwarnings(
    "ignore::pytest.PytestUnraisableExceptionWarning"
)  # moviepy leaves its pipe to the collector
def test_record_video_writes_a_film_one_can_read(tmp_path: Path) -> None:
    pytest.importorskip("moviepy")
    imageio = pytest.importorskip("imageio.v3")
    from gymnasium.wrappers import RecordVideo

    filmed = gym.make("JackInBox-v0", render_mode="rgb_array", max_episode_steps=30)
    env = RecordVideo(filmed, str(tmp_path / "films"), disable_logger=True)
    env.reset(seed=0)
    while not env.step(None)[3]:
        pass
    env.close()
    (film,) = (tmp_path / "films").glob("*.mp4")
    frames = imageio.imread(film)
    assert frames.shape[1:] == (512, 512, 3)
    assert len(frames) >= 30
    assert np.ptp(frames.astype(int), axis=0).max() > 50  # something moves


def test_human_mode_needs_no_render_calls_and_no_mode_no_picture() -> None:
    env = gym.make("JackInBox-v0", render_mode="human", control_dt=0.005)
    env.reset(seed=0)
    for _ in range(3):
        env.step(None)
    assert env.render() is None
    env.close()
    env.close()
    with pytest.warns(UserWarning, match="render"):
        assert gym.make("JackInBox-v0").unwrapped.render() is None


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_the_autoreset_mode_is_where_libraries_read_it(mode: AutoresetMode) -> None:
    """Gymnasium reads the metadata, TorchRL's wrapper the attribute."""
    env: Any = gym.make_vec("JackInBox-v0", num_envs=2, autoreset_mode=mode.name)
    assert env.autoreset_mode is mode is env.metadata["autoreset_mode"]


def test_a_limit_of_none_is_the_registered_one_and_of_minus_one_there_is_none() -> None:
    sb3 = pytest.importorskip("jackbox_env.sb3")
    for limit, steps in ((None, 500), (7, 7), (-1, None)):
        single: Any = gym.make("JackInBox-v0", max_episode_steps=limit)
        vector: Any = gym.make_vec("JackInBox-v0", max_episode_steps=limit, autoreset_mode="DISABLED")
        batch = sb3.make_sb3_vec_env(1, max_episode_steps=limit)
        assert batch.get_attr("spec")[0].max_episode_steps == steps
        assert batch.vector_env.max_episode_steps == vector.max_episode_steps == (steps or -1)
        lengths = []
        for env in (single, vector, batch.vector_env):
            env.reset(seed=0)
            ended = (step for step in range(1, 502) if np.any(env.step([0.0])[3]))
            lengths.append(next(ended, None))
        assert lengths == [steps] * 3


def test_single_environments_of_stable_baselines_have_a_spec_that_makes_each_again() -> None:
    sb3 = pytest.importorskip("jackbox_env.sb3")
    scenes = [{"gravity": 1.0}, {"gravity": 2.0}]
    env = sb3.make_sb3_vec_env(2, scene=scenes, task="spin", with_infos=True, num_threads=1, max_episode_steps=70)
    for number, spec in enumerate(env.get_attr("spec")):
        assert (spec.id, spec.max_episode_steps) == ("JackInBox-v0", 70)
        again: Any = gym.make(spec)
        assert (again.unwrapped.scene.gravity, again.unwrapped.task) == (1.0 + number, "spin")
    assert sb3.make_sb3_vec_env(1, max_episode_steps=-1).get_attr("spec")[0].max_episode_steps is None
    assert gym.spec("JackInBox-v0").kwargs == {}


WITHOUT = [
    "import jackbox_env.sb3",
    "import scripts.train; scripts.train.main()",
    "import scripts.evaluate; scripts.evaluate.main()",
    "gymnasium.make('JackInBox-v0', render_mode='rgb_array')",
    "jackbox_env.JackInBoxVectorEnv(2).tiled(size=(512, 512))",
]


def test_errors_of_missing_packages_name_the_command_that_installs_them() -> None:
    code = "import sys, gymnasium, jackbox_env\nfor name in ('stable_baselines3', 'pygame', 'tyro'):\n"
    code += "    sys.modules[name] = None\n"
    for line in WITHOUT:
        code += f"try: {line}\nexcept SystemExit as ended: assert ended.code\nexcept Exception as error: print(error)\n"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    lines = (done.stdout + done.stderr).splitlines()
    remedies = 'pip install -e ".[train]"', "pip install -e '.[all,dev]'", "pip install pygame-ce"
    assert [sum(line.endswith(remedy) for line in lines) for remedy in remedies] == [1, 2, 2]


# -- play -------------------------------------------------------------------------------------------------------------


def test_play_drives_by_the_chirp_until_an_arrow_key_pushes(monkeypatch: pytest.MonkeyPatch) -> None:
    backend = pytest.importorskip("matplotlib")
    monkeypatch.setattr(backend, "use", lambda *arguments, **settings: None)  # play opens a Tk window at import
    from gymnasium.utils.play import MissingKeysToAction, play

    presses = {10: pygame.KEYDOWN, 20: pygame.KEYUP, 30: pygame.QUIT}  # after so many steps
    actions, torques = list[Any](), list[float]()

    def remember(before: Any, after: Any, action: Any, reward: Any, terminated: Any, truncated: Any, info: Any) -> None:
        actions.append(action if action is None else float(action[0]))
        torques.append(info["torque"])
        if len(actions) in presses:
            pygame.event.post(pygame.event.Event(presses[len(actions)], {"key": pygame.K_LEFT}))

    play(gym.make("JackInBox-v0", render_mode="rgb_array"), callback=remember, noop=None, seed=0)
    assert actions == [None] * 10 + [1.0] * 10 + [None] * 10
    assert set(torques[10:20]) == {90000.0}
    assert not {0.0, 90000.0} & {*torques[:10], *torques[20:]}
    for action, right in (("torque", -1.0), ("discrete", 0)):
        keys: Any = gym.make("JackInBox-v0", action=action).get_wrapper_attr("get_keys_to_action")()
        assert keys[(pygame.K_RIGHT,)] == right < keys[(pygame.K_LEFT,)]
    with pytest.raises(MissingKeysToAction):
        play(gym.make("JackInBox-v0", render_mode="rgb_array", action="landing"))


@pytest.mark.parametrize(
    ("ours", "inherited"),
    [
        (JackInBoxEnv, {"get_wrapper_attr", "has_wrapper_attr", "set_wrapper_attr", "np_random", "np_random_seed"}),
        (JackInBoxVectorEnv, {"close", "closed"}),
    ],
)
def test_every_public_attribute_of_gymnasium_is_ours_refused_or_right_as_inherited(ours: Any, inherited: Any) -> None:
    (base,) = {gym.Env, gym.vector.VectorEnv} & {*ours.__mro__}
    names = {name for name in dir(base) if not name.startswith("_")} - {"spec", "unwrapped"}
    assert names - set(vars(ours)) - set(vars(Settings)) <= inherited
    for name in {"np_random", "np_random_seed"} - inherited:
        with pytest.raises(AttributeError):
            setattr(ours(), name, np.random.default_rng(0))
