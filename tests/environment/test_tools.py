"""The tools people use with environments: vector environments, wrappers, video, play. No display is needed."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import ClipAction, RecordEpisodeStatistics, RescaleAction

import jackbox_env  # noqa: F401
from jackbox_env import Scene
from tests.states import load

pytestmark = pytest.mark.usefixtures("no_display")


@pytest.fixture
def no_display(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.delenv("DISPLAY", raising=False)


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_make_vec_equals_single_environments_bitwise(mode: Any) -> None:
    scene = Scene(gravity=3.0)
    vector = gym.make_vec("JackInBox-v0", num_envs=3, vectorization_mode=mode, scene=scene, task="rattle")
    singles = [gym.make("JackInBox-v0", scene=scene, task="rattle") for _ in range(3)]
    actions = np.random.default_rng(0).uniform(-1, 1, (80, 3, 1)).astype(np.float32)
    observations, infos = vector.reset(seed=10)
    expected = [single.reset(seed=10 + index) for index, single in enumerate(singles)]
    np.testing.assert_array_equal(observations, [observation for observation, _ in expected])
    np.testing.assert_array_equal(infos["state"], [info["state"] for _, info in expected])
    for action in actions:
        observations, rewards, _, _, infos = vector.step(action)
        steps = [single.step(part) for single, part in zip(singles, action, strict=True)]
        np.testing.assert_array_equal(observations, [step[0] for step in steps])
        np.testing.assert_array_equal(rewards, [step[1] for step in steps])
        np.testing.assert_array_equal(infos["impulse"], [step[4]["impulse"] for step in steps])
    vector.close()


def test_the_chirp_passes_vector_environments_and_action_wrappers() -> None:
    start = np.array(load("seed_scene")[0]["q"] + load("seed_scene")[0]["qdot"])
    reference = load("seed_scene")[0]["states"][9]["state"]
    vector = gym.make_vec("JackInBox-v0", num_envs=2, vectorization_mode="sync", torque="chirp")
    vector.reset(options={"state": start})
    five = np.array([-5.0], dtype=np.float32), np.array([5.0], dtype=np.float32)
    wrapped = ClipAction(RescaleAction(gym.make("JackInBox-v0", torque="chirp"), *five))
    wrapped.reset(options={"state": start})
    for _ in range(50):
        infos = vector.step(vector.action_space.sample())[4]
        info = wrapped.step(wrapped.action_space.sample())[4]
    for state in (*infos["state"], info["state"]):
        np.testing.assert_allclose(state, reference, atol=1e-12)


def test_subproc_vec_env_makes_the_prefixed_id_in_fresh_processes() -> None:
    subproc = pytest.importorskip("stable_baselines3.common.vec_env.subproc_vec_env")
    settings: dict[str, Any] = {"task": "spin"}
    environments = subproc.SubprocVecEnv(
        [lambda: gym.make("jackbox_env:JackInBox-v0", **settings)] * 2, start_method="spawn"
    )
    environments.seed(4)
    observations = environments.reset()
    singles = [gym.make("JackInBox-v0", task="spin") for _ in range(2)]
    np.testing.assert_array_equal(
        observations, [single.reset(seed=4 + index)[0] for index, single in enumerate(singles)]
    )
    for _ in range(20):
        actions = np.full((2, 1), 0.3, dtype=np.float32)
        observations, *_ = environments.step(actions)
        np.testing.assert_array_equal(observations, [single.step(actions[0])[0] for single in singles])
    environments.close()


@pytest.mark.filterwarnings(
    "ignore::pytest.PytestUnraisableExceptionWarning"
)  # moviepy leaves its pipe to the collector
def test_record_video_writes_a_film_one_can_read(tmp_path: Path) -> None:
    pytest.importorskip("moviepy")
    imageio = pytest.importorskip("imageio.v3")
    from gymnasium.wrappers import RecordVideo

    env = RecordVideo(
        gym.make("JackInBox-v0", render_mode="rgb_array", max_episode_steps=30),
        str(tmp_path / "films"),
        disable_logger=True,
    )
    env.reset(seed=0)
    truncated = False
    while not truncated:
        *_, truncated, _ = env.step(None)
    env.close()
    (film,) = (tmp_path / "films").glob("*.mp4")
    frames = imageio.imread(film)
    assert frames.shape[1:] == (512, 512, 3)
    assert len(frames) >= 30
    assert np.ptp(frames.astype(int), axis=0).max() > 50  # something moves


def test_frames_are_rendered_and_recorded_per_step() -> None:
    env = gym.make("JackInBox-v0", render_mode="rgb_array")
    env.reset(seed=0)
    first: Any = env.render()
    for _ in range(10):
        env.step(None)
    later: Any = env.render()
    assert first.shape == later.shape == (512, 512, 3)
    assert first.dtype == np.uint8
    assert not np.array_equal(first, later)
    env.close()


def test_human_mode_steps_without_render_calls() -> None:
    env = gym.make("JackInBox-v0", render_mode="human", control_dt=0.005)
    env.reset(seed=0)
    for _ in range(3):
        env.step(None)
    assert env.render() is None
    env.close()
    env.close()


def test_render_without_a_mode_warns_and_returns_nothing() -> None:
    env = gym.make("JackInBox-v0")
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="render"):
        assert env.unwrapped.render() is None


def test_episode_statistics_and_truncation_pass_through_wrappers() -> None:
    env = RecordEpisodeStatistics(gym.make("JackInBox-v0", max_episode_steps=25))
    env.reset(seed=0)
    total = 0.0
    truncated = False
    while not truncated:
        _, reward, _, truncated, info = env.step(np.zeros(1, dtype=np.float32))
        total += float(reward)
    assert info["episode"]["l"] == 25
    assert info["episode"]["r"] == pytest.approx(total, rel=1e-5)


# -- play -------------------------------------------------------------------------------------------------------------


def played(presses: list[tuple[float, int, int]], seconds: float, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Play without a display; each press is (after seconds, event type, key). Return (action, info) per step."""
    import pygame

    backend = pytest.importorskip("matplotlib")
    monkeypatch.setattr(backend, "use", lambda *arguments, **settings: None)  # play asks for a Tk window at import
    from gymnasium.utils.play import play

    seen: list[Any] = []

    def remember(before: Any, after: Any, action: Any, reward: Any, terminated: Any, truncated: Any, info: Any) -> None:
        seen.append((action, info))

    def press() -> None:
        began = time.monotonic()
        for after, kind, key in [*presses, (seconds, pygame.QUIT, 0)]:
            time.sleep(max(0.0, began + after - time.monotonic()))
            pygame.event.post(pygame.event.Event(kind, {"key": key} if key else {}))

    env = gym.make("JackInBox-v0", render_mode="rgb_array")
    typist = threading.Timer(0.5, press)
    typist.start()
    play(env, callback=remember, noop=None, seed=0)
    typist.join()
    return seen


def test_play_drives_by_the_chirp_until_an_arrow_key_pushes(monkeypatch: pytest.MonkeyPatch) -> None:
    import pygame

    seen = played([(0.4, pygame.KEYDOWN, pygame.K_LEFT), (0.8, pygame.KEYUP, pygame.K_LEFT)], 1.2, monkeypatch)
    actions = [None if action is None else float(action[0]) for action, _ in seen]
    assert actions[0] is None
    assert actions[-1] is None
    assert 1.0 in actions
    pushed = [info["torque"] for action, info in seen if action is not None]
    assert set(pushed) == {90000.0}
    driven = [info["torque"] for action, info in seen if action is None]
    assert all(torque not in (0.0, 90000.0) for torque in driven)


def test_the_arrow_keys_are_opposite_torques_in_the_action_space() -> None:
    import pygame

    env = gym.make("JackInBox-v0")
    keys: Any = env.get_wrapper_attr("get_keys_to_action")()
    assert all(action in env.action_space for action in keys.values())
    assert keys[(pygame.K_LEFT,)] == -keys[(pygame.K_RIGHT,)] == 1.0
