"""Policies, evaluation, settings, trajectories, films."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agents.evaluation.film import film
from agents.evaluation.returns import Returns, above, evaluate, table
from agents.policies.registry import find_policy
from agents.settings import EnvSettings, TrainSettings
from scripts import train as train_command

# -- scripted policies -------------------------------------------------------------------------------------------------


def test_level_answers_angle_and_rate() -> None:
    level = find_policy("level", EnvSettings()).policy
    observation = np.zeros((4, 10), dtype=np.float32)
    observation[:, 4] = 1.0
    observation[1, 5] = 0.01  # turned counter-clockwise
    observation[2, 6] = 0.01  # turning counter-clockwise
    observation[3, 4:6] = 0.0, -1.0  # far
    actions = level.predict(observation)[0][:, 0]
    # J_b stiffness theta / limit = 14400 * 10 * 0.01 / 90000; J_b damping omega / limit with omega = 0.01 v0 / L
    np.testing.assert_allclose(actions, [0.0, -0.016, -14400 * 5 * 0.01 * 10.8499 / 6 / 90000, 1.0], rtol=1e-3)


# -- evaluation --------------------------------------------------------------------------------------------------------


def test_returns_carry_their_interval() -> None:
    row = Returns("x", (1.0, 2.0, 3.0, 4.0))
    half_width = 3.1824 * np.std([1, 2, 3, 4], ddof=1) / 2  # 97.5 % of Student's t with 3 degrees of freedom
    assert row.mean == 2.5
    assert row.interval == pytest.approx((2.5 - half_width, 2.5 + half_width), rel=1e-4)
    assert table([row]).splitlines()[-1].split() == ["|", "x", "|", "2.5", "|", "0.4", "to", "4.6", "|", "4", "|"]
    assert Returns("x", (1.0,)).half_width == np.inf
    rows = [row, Returns("apart", (9.0, 10.0, 11.0, 12.0)), Returns("near", (2.0, 3.0, 4.0, 5.0))]
    assert [" is above " in above(rows, name, "x") for name in ("apart", "near")] == [True, False]


def test_evaluation_is_repeatable_and_seeded() -> None:
    level = find_policy("level", EnvSettings())
    one, same, other = (evaluate("level", level, {}, 4, seed) for seed in (0, 0, 100))
    assert one.as_json()["environments"] == 4
    assert one == same
    assert len({*one.returns, *other.returns}) == 8


# -- settings ----------------------------------------------------------------------------------------------------------


def test_the_defaults_suit_the_task_and_the_meaning_of_actions(monkeypatch: pytest.MonkeyPatch) -> None:
    def of_the_command(*words: str) -> TrainSettings:
        monkeypatch.setattr("sys.argv", ["train.py", "--seed", "3", *words])
        return train_command.suited()

    assert of_the_command() == TrainSettings.suited() == TrainSettings()
    assert TrainSettings().interface == {"observation": "landing", "action": "landing", "action_repeat": "bounce"}
    torques = TrainSettings.suited(task="spin")
    assert (torques.observation, torques.action, torques.action_repeat, torques.gamma) == ("landing", "torque", 4, 0.99)
    assert of_the_command("--task=spin") == torques
    assert of_the_command("--action", "torque") == replace(torques, task="juggle")
    decided = TrainSettings.suited(action_repeat=20)
    assert (decided.action, decided.action_repeat, decided.gamma) == ("landing", 20, 0.905)
    assert of_the_command("--action-repeat", "20") == of_the_command("--action_repeat=20") == decided
    assert of_the_command("--action-repeat", "bounce") == TrainSettings()


# -- trajectories and films --------------------------------------------------------------------------------------------


def test_films_show_the_policies_side_by_side(tmp_path: Path) -> None:
    import imageio.v3 as imageio

    acts = {name: find_policy(name, EnvSettings()) for name in ("zero", "chirp")}
    path = tmp_path / "film.gif"
    earned = film(acts, {}, path, seed=0, seconds=1.2, width=128, progress=False)
    assert earned.keys() == acts.keys()
    assert 0.0 < earned["zero"] < 60.0  # of 60 steps
    frames = imageio.imread(path)
    assert frames.shape == (30, 128 + 36, 256, 3)  # a caption is as high over small pictures
    left, right = np.split(frames[-1].astype(int), 2, axis=1)
    assert np.abs(left - right).max() > 100  # the chirp turned its box
    with pytest.raises(FileExistsError, match="is never overwritten"):
        film(acts, {}, path, seed=0)


def test_a_film_may_begin_later_and_its_returns_count_from_the_start(tmp_path: Path) -> None:
    import imageio.v3 as imageio

    acts = {name: find_policy(name, EnvSettings()) for name in ("zero", "chirp")}
    whole = film(acts, {}, tmp_path / "whole.gif", seed=0, seconds=0.8, width=128, progress=False)
    part = film(acts, {}, tmp_path / "part.gif", seed=0, seconds=0.4, width=128, progress=False, begin=0.4)
    assert part == whole
    frames, later = (imageio.imread(tmp_path / f"{name}.gif").astype(int) for name in ("whole", "part"))
    assert len(later) == 10 == len(frames) // 2
    assert (
        np.abs(later[0] - frames[10]).mean() < 1.0 < np.abs(later[0] - frames[0]).mean()
    )  # of palettes, and of motion


def test_a_film_shows_every_control_step_of_a_decision_and_stands_still_after_the_episode(tmp_path: Path) -> None:
    import imageio.v3 as imageio

    acts = {name: find_policy(name, EnvSettings()) for name in ("ppo", "zero")}
    acts["short"] = acts["zero"]._replace(keywords={"max_episode_steps": 10})
    earned = film(acts, {"fidelity": "exact"}, tmp_path / "film.gif", 3, 0.8, width=64, progress=False)
    frames = imageio.imread(tmp_path / "film.gif").astype(int)
    ppo, _, short = (np.abs(np.diff(part, axis=0)).sum(axis=(1, 2, 3)) > 0 for part in np.split(frames, 3, axis=2))
    assert ppo.all()
    assert not short[5:].any()
    assert 0.0 < earned["short"] < earned["zero"]
