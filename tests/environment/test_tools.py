"""The tools people use with environments: vector environments, wrappers, video, play. No display is needed."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import gymnasium as gym
import numpy as np
import pygame
import pytest
from gymnasium.wrappers import RescaleAction

import jackbox_env  # noqa: F401
from jackbox_env import JackInBoxEnv, JackInBoxVectorEnv, Scene


def test_environments_in_other_processes_under_the_chirp_equal_a_wrapped_one_driven_by_none_bitwise() -> None:
    settings: dict[str, Any] = {"scene": Scene(gravity=3.0), "task": "rattle"}
    # The prefix imports the package.
    envs: Any = gym.make_vec(
        "jackbox_env:JackInBox-v0", 2, "async", {"context": "spawn"}, torque="chirp", **settings,
    )  # fmt: skip
    chirped: Any = RescaleAction(gym.make("JackInBox-v0", torque="chirp", **settings), np.float32(-5), np.float32(5))
    alone = gym.make("JackInBox-v0", **settings)
    envs.reset(seed=9), chirped.reset(seed=10), alone.reset(seed=10)
    for _ in range(80):
        expected, reward, *_ = alone.step(None)
        (observations, rewards, *_), (observation, earned, *_) = (
            env.step(np.full(env.action_space.shape, np.nan)) for env in (envs, chirped)
        )
        np.testing.assert_array_equal([observations[1], observation], [expected] * 2)
        assert rewards[1] == earned == reward
    envs.close()


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


def test_single_environments_of_stable_baselines_have_a_spec_that_makes_each_again() -> None:
    sb3 = pytest.importorskip("jackbox_env.sb3")
    scenes = [{"gravity": 1.0}, {"gravity": 2.0}]
    env = sb3.make_sb3_vec_env(2, scene=scenes, task="spin", with_infos=True, num_threads=1, max_episode_steps=70)
    for number, spec in enumerate(env.get_attr("spec")):
        assert (spec.id, spec.max_episode_steps) == ("JackInBox-v0", 70)
        again: Any = gym.make(spec)
        assert (again.unwrapped.scene.gravity, again.unwrapped.task) == (1.0 + number, "spin")
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
    own = {name for one in ours.__mro__ if one.__module__.startswith("jackbox_env.") for name in vars(one)}
    assert names - own <= inherited
    for name in {"np_random", "np_random_seed"} - inherited:
        with pytest.raises(AttributeError, match="seed"):
            setattr(ours(), name, np.random.default_rng(0))
