"""The planner: its reading of observations, its returns, and plans that depend on the seed alone."""

from __future__ import annotations

from typing import Any, cast

import gymnasium as gym
import numpy as np
import pytest

from agents.evaluation.returns import evaluate
from agents.policies.planner import Planner
from agents.policies.registry import find_policy
from agents.policies.scripted import state_of
from agents.policies.value import Value
from agents.settings import EnvSettings
from jackbox_env import Drive, Scene, State
from jackbox_env.model.observation import STATE, observe
from jackbox_env.simulators.agent_functions import observed
from tests.agents.untrained import layers_for, states_in

SMALL: dict[str, Any] = {"samples": 24, "elites": 4, "iterations": 2, "knots": 16}


@pytest.mark.parametrize("scene", [Scene(), Scene(box_half_width=2.0, jack_arm=0.5, gravity=1.62)])
def test_the_state_is_read_off_the_observation(scene: Scene) -> None:
    for seen in observed(scene, states_in(scene, 50)):
        state = state_of(scene, seen.tolist())
        np.testing.assert_allclose(observe(scene.numbers, State(*state.tolist()), 0.0, STATE), seen, atol=2e-6)
        assert state[[0, 1, 6, 7]].tolist() == [0.0] * 4


def test_a_plan_earns_what_the_environment_pays() -> None:
    search = Planner(Scene(), "spin", **SMALL).search
    env = gym.make("JackInBox-v0", contact="exact", task="spin")
    start = env.reset(seed=3)[1]["state"]
    plan = np.round(np.random.default_rng(1).uniform(-1.0, 1.0, 16) * 64.0) / 64.0
    returns, ends = search.evaluate(Scene(), start[None], plan[None, None])
    earned = sum(float(env.step(np.array([torque]))[1]) for torque in plan.repeat(5))
    assert earned == pytest.approx(returns[0, 0], abs=1e-9)
    np.testing.assert_allclose(ends[0, 0], env.unwrapped.state, atol=1e-9)  # type: ignore[attr-defined]


def test_plans_are_continued_until_an_episode_starts() -> None:
    planner = Planner(Scene(), **SMALL)
    env = gym.make("JackInBox-v0", contact="exact", **planner.in_env.keywords)
    observation, plans = env.reset(seed=0)[0], None
    for step in range(3):
        action, plans = planner.predict(observation, plans, np.array([step == 0]))
        assert action in env.action_space
        assert plans.decisions == step + 1
        observation, *_, info = env.step(action)
        assert info["duration"] == pytest.approx(0.1)
    fresh, _ = planner.predict(observation, plans, np.array([True]))
    assert fresh == planner.predict(observation)[0] != planner.predict(observation, plans, np.array([False]))[0]


@pytest.mark.parametrize("value", [None, Value(EnvSettings(contact="exact"), layers_for(96))])
def test_each_environment_is_planned_for_alone(value: Value | None) -> None:
    planner, seen = Planner(Scene(), **SMALL, value=value), observed(Scene(), states_in(Scene(), 9))
    together, plans = planner.predict(seen)
    later, _ = planner.predict(seen, plans, np.arange(9) == 1)
    for number in range(9):
        alone, plan = planner.predict(seen[number])
        assert together[number] == alone
        assert later[number] == planner.predict(seen[number], plan, np.array([number == 1]))[0]


def test_the_seed_decides_and_not_the_threads() -> None:
    seen = observed(Scene(), states_in(Scene(), 3))
    together, plans = Planner(Scene(), **SMALL).predict(seen)
    assert not np.array_equal(Planner(Scene(), seed=1, **SMALL).predict(seen)[0], together)
    np.testing.assert_array_equal(Planner(Scene(), num_threads=2, **SMALL).predict(seen)[0], together)
    with pytest.raises(ValueError, match="state must be that of 2 environments.*, got 3"):
        Planner(Scene(), **SMALL).predict(seen[:2], plans)


def test_it_juggles_better_than_the_level_box() -> None:
    settings = EnvSettings(contact="exact")
    level = evaluate("level", find_policy("level", settings, 0), settings.env_settings, 3, 0)
    planner = evaluate("planner", Planner(Scene(), **{**SMALL, "knots": 32}).in_env, settings.env_settings, 3, 0)
    assert planner.mean > level.mean + 15.0


def test_the_planner_by_its_name_has_the_settings_of_the_environment() -> None:
    settings = EnvSettings(task="spin", control_dt=0.05, scene='{"gravity": 3.0}')
    planner, fast = (cast(Planner, find_policy(name, settings, 7).policy) for name in ("planner", "planner-fast"))
    search = planner.search
    assert (planner._scene.gravity, search.repeat, search.seed, search.task.terms) == (3.0, 2, 7, ("spin",))
    assert Planner(Scene(drive=Drive(force_x=lambda t: t)))._scene.drive is None
    assert fast.search.samples < search.samples
