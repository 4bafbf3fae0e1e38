"""The environment: starts, restored states, settings."""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import jackbox_env
from jackbox_env import Chirp, Drive, Scene
from jackbox_env.mechanics import gaps
from tests.environment.start import Env, make
from tests.states import inside

# -- starts ------------------------------------------------------------------------------------------------------------


def test_starts_are_drawn_as_documented_and_from_the_seed(env: Env) -> None:
    starts = np.array([env.reset(seed=seed)[1]["state"] for seed in range(400)])
    np.testing.assert_array_equal(starts[:, [0, 1, 2, *range(6, 12)]], 0.0)
    for column, bound in ((3, 1.0), (4, 1.0), (5, 0.5)):
        assert 0.97 * bound < np.abs(starts[:, column]).max() <= bound
        assert abs(starts[:, column].mean()) < 0.1 * bound
    again = np.array([env.reset(seed=seed)[1]["state"] for seed in range(3)])
    np.testing.assert_array_equal(again, starts[:3])
    assert not np.array_equal(env.reset()[1]["state"], env.reset()[1]["state"])


@pytest.mark.parametrize(("arm", "spread"), [(5.0, 0.2), (5.999999, 2e-7), (6.0, 0.0), (7.0, 0.0), (8.48, 0.0)])
def test_long_arms_start_where_they_fit(arm: float, spread: float) -> None:
    scene = Scene(jack_arm=arm)
    env = make(scene=scene)
    for seed in range(50):
        state = env.reset(seed=seed)[1]["state"]
        assert np.abs(state[3:5]).max() <= spread * (1 + 1e-9)
        assert gaps(scene, state).min() >= -1e-9
        if arm >= 6.0:
            assert state[5] == math.pi / 4
        env.step(None)


def test_reset_to_a_state_returns_exactly_that_state(env: Env) -> None:
    rng = np.random.default_rng(4)
    for _ in range(200):
        state, time = inside(Scene(), rng), rng.uniform(-5.0, 1e6)
        _, info = env.reset(seed=0, options={"state": state.tolist(), "time": time})
        np.testing.assert_array_equal(info["state"], state)
        assert info["time"] == time == env.unwrapped.time  # type: ignore[attr-defined]
        env.step(np.zeros(1, dtype=np.float32))
    _, info = env.reset()
    assert info["time"] == 0.0


def test_the_same_actions_from_a_saved_state_give_the_same_future_bitwise(env: Env) -> None:
    actions = np.random.default_rng(6).uniform(-1, 1, (400, 1)).astype(np.float32)
    env.reset(seed=2)
    saved = (env.unwrapped.state, env.unwrapped.time)  # type: ignore[attr-defined]
    path = []
    for step, action in enumerate(actions):
        if step == 150:
            saved = (env.unwrapped.state, env.unwrapped.time)  # type: ignore[attr-defined]
            twins: list[Env] = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
        path.append(env.step(action)[0])
    used = make()
    used.reset(seed=9)
    used.unwrapped.set_state(*saved)  # type: ignore[attr-defined]
    for one in [*twins, used]:
        for expected, action in zip(path[150:], actions[150:], strict=True):
            np.testing.assert_array_equal(one.step(action)[0], expected)


def state_with(**places: float) -> list[float]:
    state = [0.0] * 12
    for place, value in places.items():
        state[int(place[1:])] = value
    return state


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"state": state_with(s3=5.0 + 2e-9)}, r"at most 1e-09 m outside\), got a foot 2e-09 m outside"),
        (
            {"state": state_with(s3=50.0)},
            "every foot inside the box .* got a foot 45 m outside; .* goes back with set_state",
        ),
        ({"state": state_with(s8=math.nan)}, "state must be finite, got omega_box = nan"),
        ({"state": state_with(s10=-math.inf)}, "state must be finite, got vy_jack = -inf"),
        ({"state": np.zeros(11)}, r"state must have shape \(12,\), got shape \(11,\)"),
        ({"state": "rest"}, "state must hold 12 numbers, got 'rest'"),
        ({"time": math.nan}, r"options\['time'\] must be a finite number at least -1e\+09 and at most 1e\+09, got nan"),
        ({"time": 2e9}, r"options\['time'\] must be a finite number .* got 2000000000.0"),
        ({"time": "noon"}, r"options\['time'\] must be a finite number"),
        ([("time", 1.0)], "options must be a dict of 'state', 'time' and 'scene' or None, got"),
        ("rest", "options must be a dict of 'state', 'time' and 'scene' or None, got 'rest'"),
        ({"scene": {1: 2}}, r"options\['scene'\] must have names of fields as its keys, got 1"),
        ({"stat": np.zeros(12)}, "options takes only 'state', 'time', 'scene', got 'stat'"),
    ],
)
def test_bad_starts_are_refused_and_change_nothing(env: Env, options: Any, sentence: str) -> None:
    env.reset(seed=0)
    env.step(None)
    bare: Any = env.unwrapped
    before, generator = bare.state, copy.deepcopy(bare.np_random)
    with pytest.raises((TypeError, ValueError), match=sentence):
        env.reset(seed=7, options=options)
    np.testing.assert_array_equal(bare.state, before)
    assert bare.np_random.bit_generator.state == generator.bit_generator.state
    env.step(None)


def test_an_option_that_is_none_is_as_one_that_is_not_given(env: Env) -> None:
    plain, _ = env.reset(seed=3)
    given, info = env.reset(seed=3, options={"time": None, "state": None, "scene": None})
    np.testing.assert_array_equal(plain, given)
    assert info["time"] == 0.0


def test_starts_within_the_rounding_of_a_far_off_place_are_taken(env: Env) -> None:
    far = np.array(state_with(s0=1e9, s1=-1e9, s3=1e9 + 5.0 + 2.4e-7, s4=-1e9))  # 2 units in the last place outside
    np.testing.assert_array_equal(env.reset(options={"state": far})[1]["state"], far)
    far[3] = 1e9 + 5.001
    with pytest.raises(ValueError, match="at most 4.76837e-07 m outside"):
        env.reset(options={"state": far})


def test_set_state_takes_what_pymunk_may_produce(env: Env) -> None:
    env.reset(seed=0)
    deep = np.array(state_with(s3=5.7, s9=3.0))
    env.unwrapped.set_state(deep, time=2.0)  # type: ignore[attr-defined]
    np.testing.assert_array_equal(env.unwrapped.state, deep)  # type: ignore[attr-defined]
    *_, info = env.step(np.zeros(1, dtype=np.float32))
    assert info["impacts"] == 1
    assert info["time"] == 2.02
    with pytest.raises(ValueError, match="at most 1 m outside, got 1.5 m"):
        env.unwrapped.set_state(state_with(s3=6.5))  # type: ignore[attr-defined]


# -- construction ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"contact": "exact", "substeps": 4}, "contact='exact' has no substeps or iterations, got substeps=4"),
        ({"contact": "box2d"}, "contact must be one of 'pymunk', 'exact', got 'box2d'"),
        ({"contact": 1}, "contact must be one of 'pymunk', 'exact', got 1"),
        ({"fidelity": "perfect"}, "fidelity must be one of 'coarse', 'balanced', 'fine', 'exact', got 'perfect'"),
        ({"fidelity": "exact", "substeps": 4}, "fidelity='exact' has no substeps, got substeps=4"),
        ({"task": "fly"}, "task must be one of 'juggle', 'spin', 'rattle', got 'fly'"),
        ({"torque": "sine"}, "torque must be one of 'agent', 'chirp', got 'sine'"),
        ({"substeps": 0}, "substeps must be a whole number from 1 to 1000000, got 0"),
        ({"substeps": 2.5}, "substeps must be a whole number from 1 to 1000000, got 2.5"),
        ({"substeps": "4"}, "substeps must be a whole number from 1 to 1000000, got '4'"),
        ({"substeps": True}, "substeps must be a whole number from 1 to 1000000, got True"),
        ({"control_dt": 0.0}, "control_dt must be a finite number above 0, got 0.0"),
        ({"control_dt": -0.02}, "control_dt must be a finite number above 0, got -0.02"),
        ({"control_dt": math.inf}, "control_dt must be a finite number above 0, got inf"),
        ({"control_dt": "fast"}, "control_dt must be a finite number above 0, got 'fast'"),
        ({"scene": {"jack_arm": 9.0}}, r"jack_arm must be below sqrt\(2\) \* box_half_width = 8.48528 m"),
        ({"scene": {"mass": 9.0}}, "scene takes only .* got 'mass'"),
        ({"scene": "moon"}, "scene must be a Scene, a dict of its fields or None, got 'moon'"),
        ({"scene": {"gravity": math.nan}}, "gravity must be a finite number .* got nan"),
        ({"scene": {"restitution": 1.5}}, "restitution must be a finite number at least 0 and at most 1, got 1.5"),
        ({"wind": 3}, "wind"),
    ],
)
def test_bad_arguments_are_refused_at_construction(settings: dict[str, Any], sentence: str) -> None:
    with pytest.raises((TypeError, ValueError), match=sentence):
        make(**settings)


def test_an_unknown_render_mode_is_refused() -> None:
    with pytest.raises(ValueError, match="render_mode must be one of 'human', 'rgb_array', got 'ascii'"):
        jackbox_env.JackInBoxEnv(render_mode="ascii")


def test_a_scene_is_given_as_a_scene_or_as_a_plain_dict() -> None:
    as_dict = make(scene={"gravity": 0.0, "drive": {"amplitude": 5.0}})
    assert as_dict.unwrapped.scene == Scene(gravity=0.0, drive=Chirp(amplitude=5.0))  # type: ignore[attr-defined]
    assert make().unwrapped.scene == Scene()  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"scene": Scene(gravity=1.62, jack_arm=2.0)},
        {"scene": {"gravity": 1.62, "drive": {"rate": 0.1}}, "task": "spin", "substeps": 8},
        {"torque": "chirp", "control_dt": 0.01},
    ],
    ids=str,
)
def test_specs_round_trip_through_json(settings: dict[str, Any]) -> None:
    env = make(**settings)
    assert env.spec is not None
    assert env.spec.entry_point == "jackbox_env.env:JackInBoxEnv"
    again: Any = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.scene == env.unwrapped.scene  # type: ignore[attr-defined]
    actions = np.random.default_rng(0).uniform(-1, 1, (60, 1)).astype(np.float32)
    np.testing.assert_array_equal(env.reset(seed=1)[0], again.reset(seed=1)[0])
    for action in actions:
        (left, left_reward, *_), (right, right_reward, *_) = env.step(action), again.step(action)
        np.testing.assert_array_equal(left, right)
        assert left_reward == right_reward


def test_a_drive_of_functions_has_no_json_form() -> None:
    env = make(scene=Scene(drive=Drive(torque=math.sin)))
    assert env.spec is not None
    with pytest.raises(TypeError, match="builtin_function_or_method is not JSON serializable"):
        env.spec.to_json()


def test_scenes_of_other_people_run_end_to_end() -> None:
    shaken = Scene(
        gravity=0.0, box_half_width=1.0, jack_arm=0.2, drive=Drive(force_x=lambda t: 900.0 * math.sin(9 * t))
    )
    env = make(scene=shaken, task="rattle")
    env.reset(seed=0)
    infos = [env.step(None)[4] for _ in range(500)]
    assert np.ptp([info["state"][0] for info in infos]) > 0.1
    assert all(info["torque"] == 0.0 for info in infos)


def test_the_prefixed_id_imports_the_package() -> None:
    assert isinstance(gym.make("jackbox_env:JackInBox-v0").unwrapped, jackbox_env.JackInBoxEnv)


@pytest.mark.parametrize("policy", [lambda: 1.0, lambda: -1.0], ids=["full", "full reversed"])
def test_no_legal_action_breaks_a_default_episode(policy: Callable[[], float]) -> None:
    env = make()
    for seed in range(8):
        env.reset(seed=seed)
        truncated = False
        while not truncated:
            observation, _, _, truncated, _ = env.step(policy())
        assert observation in env.observation_space


@pytest.mark.parametrize("contact", ["pymunk", "exact"])
def test_a_start_too_far_off_is_refused_before_anything_changes(contact: str) -> None:
    # At 1e15 m places are an eighth of a metre apart.
    far = np.zeros(12)
    far[[0, 3, 5]] = 1e15, 1e15, math.pi / 4.0
    env = gym.make("JackInBox-v0", contact=contact)
    env.reset(seed=1)
    before = env.unwrapped.np_random.bit_generator.state
    with pytest.raises(ValueError, match="near enough to the origin for float64 to resolve L / 1000, got 1e[+]15 m"):
        env.reset(seed=2, options={"state": far})
    assert env.unwrapped.np_random.bit_generator.state == before
    envs: Any = gym.make_vec("JackInBox-v0", num_envs=2, contact=contact)
    with pytest.raises(ValueError, match="near enough to the origin for float64 to resolve L / 1000, got 1e[+]15 m"):
        envs.reset(seed=2, options={"state": far})
    assert envs.np_random_seed == (-1, -1)
