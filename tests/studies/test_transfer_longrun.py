"""The long run: what is measured of an episode, and that it is the environment's."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import jackbox_env  # noqa: F401
from agents.policies import baseline
from jackbox_env import FIDELITIES, Impact, Scene
from jackbox_env.tasks import sample_start
from scripts.studies.transfer.longrun import (
    DT,
    SETTINGS,
    STATISTICS,
    STEPS,
    Episodes,
    acting,
    chirp,
    measure,
    random_torques,
    run_episodes,
    run_long,
    stored,
)


def test_statistics_of_made_up_impacts() -> None:
    # feet 0 and 1 in step 3 of 4, one at its very end; foot 1 twice in step 4
    impacts = [Impact(2.5 * DT, 0, 0, 4.0), Impact(3.0 * DT, 0, 1, 1.0)]
    impacts += [Impact(3.2 * DT, 1, 1, 2.0), Impact(3.3 * DT, 1, 1, 3.0)]
    speeds, rates = np.array([1.0, 2.0, 3.0, 4.0]), np.array([-1.0, 1.0, -3.0, 3.0])
    seconds = 4 * DT
    found = measure(impacts, speeds, rates)
    expected = [4 / seconds, 1 / seconds, 10.0 / seconds, 2.5, 3.7, 2.5, 3.7, 2.0]
    assert list(found.values()) == pytest.approx(expected)
    assert tuple(found) == STATISTICS
    without = measure([], speeds, rates)
    assert [name for name in STATISTICS if math.isnan(without[name])] == [
        "median impulse [N s]", "9th decile of impulse [N s]",
    ]  # fmt: skip


@pytest.mark.parametrize("setting", ["balanced", "exact"])
def test_an_episode_of_the_long_run_is_the_environments(setting: str) -> None:
    start = sample_start(Scene(), np.random.default_rng(8))
    found = run_episodes(SETTINGS[setting], chirp, np.random.default_rng(8), 1)
    env: Any = gym.make("JackInBox-v0", fidelity=setting, torque="chirp")
    env.reset(options={"state": start})
    infos = [env.step(np.zeros(1, dtype=np.float32))[4] for _ in range(STEPS)]
    speeds = [math.hypot(*info["state"][9:11]) for info in infos]
    assert found.values["impacts [1/s]"][0] == pytest.approx(sum(info["impacts"] for info in infos) / 10.0)
    assert found.values["impulse [N s per s]"][0] == pytest.approx(sum(info["impulse"] for info in infos) / 10.0)
    assert found.values["mean speed of the jack [m/s]"][0] == pytest.approx(np.mean(speeds))
    assert found.lost == 0
    assert found.depth > 0.0 if setting == "balanced" else found.depth < 1e-9


def test_a_policy_acts_in_the_long_run_as_in_the_environment() -> None:
    level = baseline("level", Scene()).policy
    found = run_episodes(SETTINGS["balanced"], acting(Scene(), level), np.random.default_rng(9), 1)
    env: Any = gym.make("JackInBox-v0", fidelity="balanced")
    observation, _ = env.reset(options={"state": sample_start(Scene(), np.random.default_rng(9))})
    total = 0.0
    for _ in range(STEPS):
        observation, *_, info = env.step(level.predict(observation)[0])
        total += info["impulse"]
    assert found.values["impulse [N s per s]"][0] == pytest.approx(total / 10.0)


def test_a_jack_that_leaves_is_counted_and_not_measured() -> None:
    rng, light = np.random.default_rng(0), Scene(box_mass=0.01)
    found = run_episodes(SETTINGS["coarse"], random_torques(light, rng), rng, 4, light)
    assert found.lost + len(found.values["impacts [1/s]"]) == 4
    assert found.lost >= 1


def test_what_was_measured_is_read_again_from_its_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = Episodes({name: np.arange(3.0) + number for number, name in enumerate(STATISTICS)}, 0.25, 2)
    first = stored(tmp_path / "kept" / "x.npz", lambda: made)
    again = stored(tmp_path / "kept" / "x.npz", lambda: pytest.fail("measured twice"))
    path = tmp_path / "kept" / "x.npz"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    third = stored(path, lambda: made)
    assert f"Skipped: {path} is damaged" in capsys.readouterr().err
    assert path.read_bytes() == whole
    for found in (first, again, third):
        assert (found.depth, found.lost) == (0.25, 2)
        assert all(np.array_equal(found.values[name], made.values[name]) for name in STATISTICS)


def test_the_controls_differ_from_what_they_control_in_one_thing() -> None:
    assert {name: SETTINGS[name] for name in FIDELITIES} == {name: of._asdict() for name, of in FIDELITIES.items()}
    assert SETTINGS["one iteration"] == {**SETTINGS["coarse"], "iterations": 1}
    assert SETTINGS["exact again"] == SETTINGS["exact"]


def test_all_settings_are_run_under_all_torques_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[int] = []

    def quick(setting: Any, torques: Any, rng: np.random.Generator, episodes: int, scene: Scene) -> Episodes:
        ran.append(int(rng.integers(2**40)))
        return Episodes({name: np.ones(episodes - 1) for name in STATISTICS}, 0.0, 1)

    monkeypatch.setattr("scripts.studies.transfer.longrun.run_episodes", quick)
    policies = {"PPO": baseline("level", Scene()).policy}
    found = run_long(tmp_path / "longrun", policies, 4, progress=False)
    assert {condition: list(each) for condition, each in found.items()} == {
        condition: list(SETTINGS) for condition in ("random torques", "the chirp", "PPO")
    }
    assert len(set(ran)) == 18  # each with seeds of its own
    run_long(tmp_path / "longrun", policies, 4, progress=False)
    assert len(ran) == 18
    with pytest.raises(ValueError, match="holds other than 5 episodes for exact under random torques"):
        run_long(tmp_path / "longrun", policies, 5, progress=False)
