"""Actions that are held: in training, and by a trained model in the ordinary environment."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import jackbox_env  # noqa: F401
from agents.evaluation.returns import evaluate
from agents.runs import describe
from agents.training import ppo as training
from agents.training.holding import HoldingPPO
from agents.training.models import holding, load_model, make_ppo, make_vec_env
from jackbox_env.files import new_folder
from tests.agents.small_run import TINY

HOLD = 5
HELD = replace(TINY, contact="exact", hold=HOLD, preview=True)


@pytest.fixture(scope="module")
def model() -> HoldingPPO:
    """An untrained policy that moves much: its standard deviation is 1."""
    return make_ppo(HELD, make_vec_env(HELD.env_settings, 1, 0))


# -- training ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("contact", ["exact", "pymunk"])
def test_held_environments_are_the_environments_stepped_by_hand(contact: str) -> None:
    count, settings = 3, {"contact": contact}
    held, plain = holding(make_vec_env(settings, count, 7), HELD), make_vec_env(settings, count, 7)
    np.testing.assert_array_equal(held.reset(), plain.reset())
    rng = np.random.default_rng(0)
    ended = 0
    for _ in range(2 * 500 // HOLD):
        actions = rng.uniform(-1.0, 1.0, (count, 1)).astype(np.float32)
        observations, rewards, dones, infos = held.step(actions)
        by_hand = [plain.step(actions) for _ in range(HOLD)]
        total = np.sum([step[1] for step in by_hand], axis=0)
        np.testing.assert_allclose(rewards, total, rtol=1e-6)
        assert rewards.dtype == np.float32
        np.testing.assert_array_equal(observations, by_hand[-1][0])
        np.testing.assert_array_equal(dones, by_hand[-1][2])
        for mine, other in zip(infos, by_hand[-1][3], strict=True):
            assert set(mine) == set(other)
            if "episode" in mine:
                ended += 1
                assert mine["episode"]["l"] == other["episode"]["l"] == 500
                assert mine["episode"]["r"] == other["episode"]["r"]
                assert mine["TimeLimit.truncated"] is other["TimeLimit.truncated"] is True
                np.testing.assert_array_equal(mine["terminal_observation"], other["terminal_observation"])
    assert ended == 2 * count


# -- playing -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("contact", ["exact", "pymunk"])
def test_a_held_policy_plays_as_by_hand_in_one_environment(model: HoldingPPO, contact: str) -> None:
    played, by_hand = (gym.make("JackInBox-v0", contact=contact) for _ in range(2))
    seen, _ = played.reset(seed=3)
    other, _ = by_hand.reset(seed=3)
    state = None
    for _ in range(20):
        chosen = model.policy.predict(other, deterministic=True)[0]
        for _ in range(HOLD):
            action, state = model.predict(seen, state, deterministic=True)
            np.testing.assert_array_equal(action, chosen)
            seen, *_ = played.step(action)
            other, *_ = by_hand.step(chosen)
            np.testing.assert_array_equal(seen, other)


def test_each_environment_chooses_where_its_own_episode_starts(model: HoldingPPO) -> None:
    rng = np.random.default_rng(1)
    observations = rng.uniform(-1.0, 1.0, (23, 3, 10)).astype(np.float32)
    starts = np.zeros((23, 3), dtype=bool)
    starts[0] = True
    starts[7, 1] = starts[9, 1] = starts[10, 2] = True
    state: Any = None
    age, held = np.zeros(3, dtype=int), np.zeros((3, 1), dtype=np.float32)
    for seen, start in zip(observations, starts, strict=True):
        actions, state = model.predict(seen, state, start, deterministic=True)
        for number in range(3):
            age[number] = 0 if start[number] else age[number]
            if age[number] % HOLD == 0:
                held[number] = model.policy.predict(seen[number], deterministic=True)[0]
            age[number] += 1
        np.testing.assert_allclose(actions, held, atol=1e-6)


def test_a_model_that_aims_plays_in_the_ordinary_environment_as_it_was_trained_to() -> None:
    settings = replace(HELD, landing=True, hold=20)
    trained_in, plain = (make_vec_env(settings.env_settings, 2, 0) for _ in range(2))
    aiming = holding(trained_in, settings)
    model = make_ppo(settings, aiming)
    trained_in.seed(3)
    plain.seed(3)
    seen, shown = aiming.reset(), plain.reset()
    state = None
    for _ in range(5):
        seen, rewards, _, _ = aiming.step(model.policy.predict(seen, deterministic=True)[0])  # type: ignore[arg-type]
        total = np.zeros(2)
        for _ in range(20):
            torques, state = model.predict(shown, state, deterministic=True)
            assert torques.shape == (2, 1)
            shown, earned, _, _ = plain.step(torques)
            total += earned
        np.testing.assert_allclose(total, rewards, rtol=1e-3)
        np.testing.assert_allclose(shown, seen, atol=1e-3)  # type: ignore[arg-type]
    alone, _ = model.predict(shown[0], None, deterministic=True)  # type: ignore[index]
    assert alone.shape == (1,)


def test_a_model_that_looks_ahead_sees_in_the_ordinary_environment_what_it_was_trained_on() -> None:
    settings = replace(HELD, lookahead=8, preview=True)
    trained_in = holding(make_vec_env(settings.env_settings, 2, 0), settings)
    looking, plain = make_ppo(settings, trained_in), make_vec_env(settings.env_settings, 2, 0)
    trained_in.seed(3)
    plain.seed(3)
    wide: Any = trained_in.reset()
    seen: Any = plain.reset()
    state, moved = None, 0.0
    for _ in range(12):
        wanted = looking.policy.predict(wide, deterministic=True)[0]
        for step in range(HOLD):
            actions, state = looking.predict(seen, state, None, deterministic=True)
            if step == 0:
                expected = np.clip(wanted + wide[:, -3:-2], -1.0, 1.0)
                np.testing.assert_allclose(actions, expected, atol=1e-6)
                moved += float(np.abs(actions).sum())
            seen, *_ = plain.step(actions)
        wide, *_ = trained_in.step(wanted)
        np.testing.assert_array_equal(wide[:, :10], seen)
    assert moved > 1.0


def test_a_model_that_looks_ahead_is_trained_and_loaded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    settings = replace(HELD, lookahead=8)
    folder = new_folder(tmp_path / "run", "run", lambda made: describe(made, settings))
    training.train(settings, folder, progress=False)
    told = capsys.readouterr().out.strip().splitlines()[-2]  # what the time went to
    found = re.fullmatch(r"([0-9,]+) steps in [0-9]+ s, [0-9,]+ per second: (.*)", told)
    assert found, told
    assert int(found[1].replace(",", "")) >= settings.total_steps
    shares = {name: float(share) for name, share in re.findall(r"([a-z ,]+) ([0-9.]+)%", found[2])}
    assert sum(shares.values()) == pytest.approx(100.0, abs=0.5)
    assert shares[", looking ahead"] > shares["environment"] > 0.0
    loaded = load_model(folder)
    assert loaded.manner.features is not None
    (earned,) = evaluate("PPO", loaded, settings.env_settings, 1, 0).returns
    assert earned > 0.0
    with pytest.raises(ValueError, match="lookahead must be 0 or from 8 to 4096, got 3"):
        replace(HELD, lookahead=3)


def test_a_state_of_other_environments_is_refused(model: HoldingPPO) -> None:
    _, state = model.predict(np.zeros((2, 10), dtype=np.float32))
    with pytest.raises(ValueError, match="state must be that of 3 environments, as observation is, got 2"):
        model.predict(np.zeros((3, 10), dtype=np.float32), state)


# -- run folders -------------------------------------------------------------------------------------------------------


def test_training_with_hold_and_preview_saves_loads_and_resumes(tmp_path: Path) -> None:
    folder = new_folder(tmp_path / "run", "test")
    describe(folder, HELD)
    half = replace(HELD, total_steps=1024)
    training.train(half, folder, progress=False)
    (folder / "model.zip").unlink()
    model = training.train(HELD, folder, progress=False)
    assert model.num_timesteps == HELD.total_steps
    assert [episode["l"] for episode in model.ep_info_buffer or ()] == [500] * 12  # from 768 on: 320 actions each
    stored = np.load(folder / "evaluations.npz")
    assert stored["timesteps"].tolist() == [1024, 2048]
    assert np.all(stored["ep_lengths"] == 500)
    loaded = load_model(folder / "model.zip")
    assert loaded.manner.hold == HOLD
    for name, value in model.get_parameters()["policy"].items():
        np.testing.assert_array_equal(value.numpy(), loaded.get_parameters()["policy"][name].numpy())
    returns = [evaluate("PPO", one, HELD.env_settings, 2, seed=0).returns for one in (model, loaded)]
    assert returns[0] == returns[1]
    trusted = tmp_path / "alone.zip"
    trusted.write_bytes((folder / "model.zip").read_bytes())
    (tmp_path / "run" / "settings.json").unlink()
    again = load_model(trusted, trust=True)
    assert again.manner.hold == HOLD
    assert evaluate("PPO", again, HELD.env_settings, 2, seed=0).returns == returns[0]
