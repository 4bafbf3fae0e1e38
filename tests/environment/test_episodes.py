"""The length of an episode: ``episode_steps`` control steps, the same wherever an environment is made."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.wrappers import TimeAwareObservation

from jackbox_env import JackInBoxEnv, Task
from tests.batches.several import EVERY_MODEL

EXACT: dict[str, Any] = {"contact": "exact"}


def again(spec: Any) -> EnvSpec:
    """A spec that has been JSON."""
    return EnvSpec.from_json(spec.to_json())


def ended(env: Any, most: int = 1100) -> int | None:
    """Decisions of an episode until it is truncated; None: more than ``most``."""
    env.reset(seed=0)
    return next((step for step in range(1, most) if np.any(env.step(env.action_space.sample())[3])), None)


@pytest.mark.parametrize(
    ("settings", "decisions"),
    [
        ({}, 500),
        ({"episode_steps": 1000}, 1000),
        ({"episode_steps": None}, None),
        ({"action_repeat": 4}, 125),
        ({"action_repeat": 4, "episode_steps": 4000}, 1000),
        ({"action_repeat": 4, "episode_steps": 501}, 126),
        ({"max_episode_steps": 7}, 7),
        ({"action_repeat": 4, "episode_steps": 30, "max_episode_steps": 7}, 7),
    ],
)
def test_an_episode_is_as_long_wherever_it_is_made(settings: dict[str, Any], decisions: int | None) -> None:
    sb3 = pytest.importorskip("jackbox_env.sb3")
    single, vector = gym.make("JackInBox-v0", **EXACT, **settings), gym.make_vec("JackInBox-v0", 2, **EXACT, **settings)
    stable = sb3.make_sb3_vec_env(1, **EXACT, **settings)
    specs: list[Any] = [single.spec, vector.spec, stable.get_attr("spec")[0]]
    assert [spec.max_episode_steps for spec in specs] == [decisions] * 3
    envs = [single, gym.make(again(specs[0])), gym.make(again(specs[2])), vector, gym.make_vec(again(specs[1]))]
    assert [ended(env) for env in (*envs, stable.vector_env)] == [decisions] * 6


def test_with_bounces_an_episode_has_no_number_of_decisions() -> None:
    for limit, most in ((None, 500), (3, 3)):
        settings = {**EXACT, "action_repeat": "bounce", "max_episode_steps": limit}
        single, vector = gym.make("JackInBox-v0", **settings), gym.make_vec("JackInBox-v0", 1, **settings)
        for env in (single, vector, gym.make(again(single.spec)), gym.make_vec(again(vector.spec))):
            assert (env.spec.max_episode_steps, ended(env) or 501) <= (limit, most)  # type: ignore[union-attr]
        assert single.unwrapped.time == pytest.approx(10.0) or limit  # type: ignore[attr-defined]


def test_gymnasiums_own_limit_can_only_shorten_an_episode() -> None:
    for limit, shown in ((1000, 1000), (-1, 500)):
        env = gym.make("JackInBox-v0", max_episode_steps=limit, **EXACT)
        assert (env.spec.max_episode_steps, ended(env)) == (shown, 500)  # type: ignore[union-attr]
        longer = gym.make(env.spec, max_episode_steps=-1, episode_steps=600)  # type: ignore[arg-type]
        assert (longer.spec.max_episode_steps, ended(longer)) == (600, 600)  # type: ignore[union-attr]
    several: Any = gym.make_vec("JackInBox-v0", 1, vectorization_mode="sync", **EXACT)
    assert (gym.spec("JackInBox-v0").max_episode_steps, several.spec.max_episode_steps) == (None, None)
    assert several.envs[0].spec.max_episode_steps == 500
    assert TimeAwareObservation(gym.make("JackInBox-v0")).observation_space.high[-1] == 500  # type: ignore[attr-defined]


@EVERY_MODEL
def test_the_end_of_an_episode_cuts_a_decision(contact: str) -> None:
    env = JackInBoxEnv(contact=contact, action_repeat=4, episode_steps=10)
    env.reset(seed=0)
    ends = [env.step(0.0)[2:] for _ in range(3)]
    assert [truncated for _, truncated, _ in ends] == [False, False, True]
    assert [info["duration"] for *_, info in ends] == [0.08, 0.08, 0.04]


@pytest.mark.parametrize("ends", [3, 1])
def test_set_state_continues_an_episode_and_a_finished_one_starts_anew(ends: int) -> None:
    over = Task(("none",), lambda scene, state, torque, impulse: (0.0,), lambda scene, state, torque, impulse: True)
    env = JackInBoxEnv(episode_steps=3, task=over if ends == 1 else "juggle")

    def step(*steps: int) -> int:
        env.set_state(np.zeros(12), 0.0, *steps)
        env.step(None)
        return env.elapsed_steps

    assert [step() for _ in range(7)] == [number % ends + 1 for number in range(7)]
    assert [step(2), step(), step(2)] == [3, 1, 3]  # the count of steps is restored
    env.set_state(np.zeros(12), 0.0, 3)
    with pytest.raises(gym.error.ResetNeeded, match="the episode has had its 3 steps"):
        env.step(None)
    assert step() == 1
