"""Environments on a GPU, by kernels translated from PTX to C: equal to the CPU's in every bit."""

from __future__ import annotations

import math
import re
from typing import Any
from unittest.mock import Mock

import gymnasium as gym
import numpy as np
import pytest
import torch

import jackbox_env
from jackbox_env import Action, Observation, Scene, State, Task
from jackbox_env.envs import on_card
from jackbox_env.gpu import device
from jackbox_env.jit.folders import cache_folders
from jackbox_env.model.scene import SceneNumbers
from scripts.studies.speed import gpu
from tests.gpu.test_gpu import needs_gcc
from tests.gpu.translation import loaded

LANDING: dict[str, Any] = {"task": "juggle", "observation": "landing", "action": "landing"}


@pytest.fixture(autouse=True)
def without_card(monkeypatch: pytest.MonkeyPatch) -> None:
    """``device="cuda"`` steps by the translated kernels, in this machine's memory."""
    monkeypatch.setenv("JACKBOX_UNTRIED_GPU", "1")
    monkeypatch.setattr(device, "launcher", loaded)
    monkeypatch.setattr(device, "require", lambda: None)
    monkeypatch.setattr(device, "PLACE", "cpu")


def both(count: int, seed: int = 0, **keywords: Any) -> tuple[Any, Any]:
    """Environments on the card and on the CPU, which begin equally."""
    made = {"num_envs": count, "fidelity": "exact", **keywords}
    card, cpu = gym.make_vec("JackInBox-v0", device="cuda", **made), gym.make_vec("JackInBox-v0", **made)
    np.testing.assert_array_equal(card.reset(seed=seed)[0], cpu.reset(seed=seed)[0])
    return card, cpu


def step_equally(card: Any, cpu: Any, steps: int, seed: int = 0) -> tuple[int, int]:
    """Step both; return how many episodes ended, and how often the CPU stepped a row of the card."""
    ended, left = 0, 0
    cpu.action_space.seed(seed)
    for number in range(steps):
        actions = cpu.action_space.sample()
        *of_card, infos = card.step(torch.from_numpy(actions) if number % 2 else actions)
        *of_cpu, expected = cpu.step(actions)
        for one, other in zip(of_card, of_cpu, strict=True):
            np.testing.assert_array_equal(one, other)
        np.testing.assert_array_equal(infos["duration"], expected["duration"])
        assert ("final_obs" in infos) == ("final_obs" in expected)
        if "final_obs" in expected:
            over = expected["_final_obs"]
            np.testing.assert_array_equal(infos["final_obs"][over], np.stack(expected["final_obs"][over]))
            np.testing.assert_array_equal(infos["final_info"]["duration"], expected["final_info"]["duration"])
        np.testing.assert_array_equal(card.states, cpu.states)
        np.testing.assert_array_equal(card.times, cpu.times)
        ended, left = ended + int((of_cpu[2] | of_cpu[3]).sum()), left + infos["left_to_cpu"]
    assert [card.scene_of(number) for number in range(card.num_envs)] == cpu.scenes
    return ended, left


@needs_gcc
def test_decisions_on_a_card_are_those_of_the_cpu() -> None:
    """Bounces and restarts in both modes, drawn scenes, and feet at rest and huge angles, which the CPU steps."""
    drawn: dict[str, Any] = {
        "randomize": {"restitution": (0.3, 0.7), "jack_mass": (2.0, 16.0)},
        "autoreset_mode": "SAME_STEP",
    }
    ended, left = step_equally(*both(6, **LANDING, **drawn, action_repeat="bounce", episode_steps=250), 60)
    assert ended > 5
    assert left > 5
    step_equally(*both(3, task="juggle"), 9)
    card, cpu = both(3, 7, task="juggle", action="discrete", action_repeat=3, max_episode_steps=9)
    states = np.tile(np.append(np.zeros(9), [0.5, 1.0, 3.0]), (3, 1))
    states[2, [2, 5]] = 1e16
    for envs in (card, cpu):
        envs.set_states(states, 0.25)
    ended, left = step_equally(card, cpu, 40)
    assert ended > 5
    assert left > 5


def test_what_only_the_cpu_has_is_refused_in_a_sentence() -> None:
    pushed = Scene(drive=jackbox_env.Drive(force_x=lambda time: 50.0))
    for keywords, what in (
        ({"render_mode": "rgb_array"}, "a render_mode"),
        ({"with_infos": True}, "with_infos"),
        ({"autoreset_mode": "DISABLED"}, "autoreset_mode DISABLED"),
        ({"torque": "chirp"}, 'torque="chirp"'),
        ({"observation": jackbox_env.Pixels()}, "Pixels"),
        ({"task": Task(("one",), lambda *_: 1.0, start=lambda scene, generator: np.zeros(12))}, "a Task with a start"),
        ({"randomize": lambda generator: {}}, "a function as randomize"),
        ({"scene": [Scene(), Scene(gravity=3.0)]}, "a scene for each environment"),
        ({"scene": pushed}, "forces of a Drive"),
    ):
        with pytest.raises(ValueError, match=f'^device="cuda" does not have {re.escape(what)}: make these'):
            gym.make_vec("JackInBox-v0", num_envs=2, device="cuda", **{"fidelity": "exact", **keywords})
    with pytest.raises(ValueError, match='^device="cuda" needs fidelity="exact", got None$'):
        gym.make_vec("JackInBox-v0", num_envs=2, device="cuda")


@needs_gcc
def test_a_batch_on_a_card_is_used_as_one_on_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its own states, as tensors that NumPy cannot read, seeds, scenes, and sentences."""
    card, cpu = both(2, 5, **LANDING)
    assert (card.np_random_seed, card.scenes, card.with_infos) == (cpu.np_random_seed, cpu.scenes, False)
    card.reset()
    assert card.np_random_seed == (5, 6)
    assert [one for folder in cache_folders() for one in folder.glob("decide-juggle-landing-landing-*.ptx")]
    states, times = card.states + 0.01, card.times + 1.0
    with monkeypatch.context() as patch:
        patch.delattr(torch.Tensor, "__array__")
        card.set_states(states, times)
    np.testing.assert_array_equal(card.states, states)
    np.testing.assert_array_equal(card.times, [1.0, 1.0])
    for wrong, sentence in (
        (lambda: card.step(torch.zeros(3, dtype=torch.bfloat16)), "actions must have shape"),
        (lambda: card.step(torch.zeros((2, 2), requires_grad=True)), "actions must be .* detach"),
        (lambda: card.reset(options={"time": 1.0, "state": None}), "has no options of reset, got time$"),
        (lambda: card.reset(options=[]), "options must be a dict"),
        (lambda: setattr(card, "scene", Scene()), "scene cannot be assigned"),
    ):
        with pytest.raises((TypeError, ValueError, AttributeError), match=sentence):
            wrong()
    assert len(card.reset(options={"reset_mask": None})[0]) == 2
    card._inside[0] = -1  # as if another thread were in it
    with pytest.raises(RuntimeError, match="one thread at a time"):
        card.reset()


def test_without_a_gpu_nothing_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device, "require", Mock(side_effect=ImportError("needs cuda-core")))
    monkeypatch.setattr(on_card, "codes_of", Mock())
    with pytest.raises(ImportError, match="needs cuda-core"):
        gym.make_vec("JackInBox-v0", num_envs=2, fidelity="exact", device="cuda")
    assert not on_card.codes_of.called  # type: ignore[attr-defined]


# -- functions of one's own --------------------------------------------------------------------------------------------


def earned(scene: SceneNumbers, state: State, torque: float, impulse: float) -> float:
    return (math.inf if state.omega_jack > 40.0 else 0.1) + impulse / scene.jack_mass


def lost(scene: SceneNumbers, state: State, torque: float, impulse: float) -> bool:
    return abs(state.theta_jack) > 3.0


def seen(scene: SceneNumbers, state: State, time: float) -> tuple[float, float]:
    return (math.nan if state.vx_jack > 90.0 else state.x_jack), 1.0 / (state.y_box - 7.0)


def turned(scene: SceneNumbers, state: State, action: tuple[float, float], time: float, dt: float) -> float:
    return action[0] * action[1] - state.omega_box / (1.0 + time)


OWN: dict[str, Any] = {
    "task": Task(("earned",), earned, lost),
    "observation": Observation(("x", "rate"), -2.0, 2.0, seen),
    "action": Action(gym.spaces.Box(-1.0, 1.0, (2,)), turned),
}


@needs_gcc
@pytest.mark.slow
def test_forty_random_configurations_with_functions_of_ones_own() -> None:
    rng, ended, left = np.random.default_rng(0), 0, 0
    for number in range(40):
        keywords: dict[str, Any] = {
            "action_repeat": ("bounce", 1, 4, 7)[number % 4],
            "autoreset_mode": ("SAME_STEP", "NEXT_STEP")[number % 3 > 0],
            "episode_steps": int(rng.integers(5, 200)), "control_dt": float(rng.choice([0.01, 0.02, 0.05])),
            "scene": {"restitution": float(rng.choice([1.0, 0.9, 0.5])), "gravity": float(rng.uniform(0.0, 12.0))},
        }  # fmt: skip
        if number % 2:
            keywords["randomize"] = {"jack_arm": (0.3, 1.0), "torque_limit": (1e4, 9e4)}
        more = step_equally(*both(5, number, **OWN, **keywords), 50, number)
        ended, left = ended + more[0], left + more[1]
    assert ended > 100
    assert left > 10


@needs_gcc
@pytest.mark.slow
@pytest.mark.parametrize(
    ("state", "actions"),
    [
        ([0.0] * 11 + [45.0], [[0.0, 0.0]] * 2),  # an infinite reward
        ([0.0] * 9 + [95.0, 0.0, 0.0], [[0.0, 0.0]] * 2),  # NaN observed
        ([0.0, 7.0, 0.0, 0.0, 7.0] + [0.0] * 7, [[0.0, 0.0]] * 2),  # a division by zero
        ([0.0] * 9 + [1e14, 0.0, 0.0], [[0.0, 0.0]] * 2),  # too fast to be followed
        ([0.0] * 12, [[0.0, 0.0], [0.0, math.nan]]),
        ([0.0] * 12, [[0.0], [0.0]]),
    ],
)
def test_errors_are_those_of_the_cpu_and_change_nothing(state: list[float], actions: Any) -> None:
    card, cpu = both(2, **OWN)
    errors = []
    for envs in (card, cpu):
        envs.set_states(np.array([np.zeros(12), state]), 0.0)
        before = envs.states
        with pytest.raises(Exception) as raised:  # noqa: PT011  # the same, whatever it is
            envs.step(torch.tensor(actions) if envs is card else np.array(actions))
        np.testing.assert_array_equal(envs.states, before)
        errors.append((type(raised.value), str(raised.value)))
    assert errors[0] == errors[1]
    step_equally(*both(2, 3, **OWN), 3)


@needs_gcc
@pytest.mark.slow
def test_the_script_for_a_card_finds_the_bits_of_the_cpu(capsys: pytest.CaptureFixture[str]) -> None:
    assert gpu.envs_on_card("cpu", (64,), 30) == 0
    assert re.fullmatch(r"0 of 121 arrays .*\n64 environments: \S+ steps a second\n", capsys.readouterr().out)


def test_json_carries_the_device() -> None:
    card = gym.make_vec("JackInBox-v0", num_envs=2, fidelity="exact", device="cuda", **LANDING)
    assert card.spec is not None
    spec = gym.envs.registration.EnvSpec.from_json(card.spec.to_json())
    assert spec.kwargs["device"] == "cuda"
    assert type(gym.make_vec(spec, num_envs=2)) is type(card)
