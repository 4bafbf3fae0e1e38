"""The same bits for one environment, in a batch, in a rollout and after it is restored, from any number of threads."""

from __future__ import annotations

import copy
import math
import random
from collections import Counter
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from hypothesis import assume, given, note, settings
from hypothesis import strategies as st

from jackbox_env import Drive, JackInBoxEnv, Scene, Task, rollout
from jackbox_env.mechanics import energy
from tests.batches.alike import CALLS, Alike, play
from tests.batches.drawn import FALL, draw_setup
from tests.batches.several import EVERY_MODEL, SCENES, assert_same
from tests.invariants.cases import HypothesisDraw
from tests.states import inside

# -- all kinds of environments ----------------------------------------------------------------------------------------

EXAMPLES: int = settings.default.max_examples  # type: ignore[union-attr]


@EVERY_MODEL
@pytest.mark.timeout(0 if EXAMPLES > 1000 else 300)
def test_every_kind_of_environment_does_the_same_whatever_is_called(contact: str, cases: Callable[[int], int]) -> None:
    counts: Counter[str] = Counter()

    @settings(max_examples=EXAMPLES // 3 * cases(3))
    @given(st.data())
    def does_the_same(data: st.DataObject) -> None:
        draw = HypothesisDraw(data.draw)
        setup = draw_setup(draw, contact)
        note(f"All kinds of environments with {setup}")
        try:
            counts.update(play(Alike(**setup), draw, 15))
        except ValueError as error:  # a scene that pymunk does not solve, also one that a reset changes
            assume("couple the feet so strongly" not in str(error))
            raise

    does_the_same()
    ends = "ends True False", "ends False True", "ends False False"
    assert min(counts[name] for name in ("impacts", *ends, *[call.__name__ for call in CALLS])) >= 3, counts
    assert counts["lost"] <= 0.1 * EXAMPLES, counts


@EVERY_MODEL
def test_an_end_in_the_last_decision_is_no_truncation_to_stable_baselines(contact: str) -> None:
    alike = Alike({"contact": contact, "task": FALL, "action_repeat": "bounce"}, [Scene()], 2, range(2), limit=1)
    alike.reset_some(np.ones(2, dtype=np.bool_), 4)
    for seed in range(3):
        alike.step(random.Random(seed))
    assert alike.counts["ends True True"] >= 4


@EVERY_MODEL
def test_one_ulp_of_a_start_would_be_seen(contact: str) -> None:
    alike = Alike({"contact": contact}, [Scene()], 6, range(3))
    alike.reset_some(np.ones(6, dtype=np.bool_), 4)
    states = alike.batches[0].states
    states[1, 3] = np.nextafter(states[1, 3], 9.0)
    for batch in alike.batches:
        batch.set_states(states, 0.0)
    with pytest.raises(AssertionError, match="environment 1/4/state"):
        alike.step(random.Random(0))


def test_a_rule_that_only_a_batch_follows_would_be_seen() -> None:
    alike = Alike({"contact": "exact", "action": "landing", "action_repeat": "bounce"}, [Scene()], 3, [2])
    alike.rows[2].env.repeat = alike.rows[2].env.repeat._replace(max_contact_steps=0)
    with pytest.raises(AssertionError, match="environment 2/"):
        play(alike, random.Random(0), 30)


@EVERY_MODEL
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_a_batch_returns_all_that_gymnasiums_of_single_environments_returns(contact: str, mode: AutoresetMode) -> None:
    arguments: dict[str, Any] = {
        "contact": contact, "max_episode_steps": 40, "task": "rattle", "scene": {"jack_arm": 4.0}, "control_dt": 0.05,
        "observation": "landing", "action": "landing", "action_repeat": 2,
    }  # fmt: skip
    batched: Any = gym.make_vec("JackInBox-v0", num_envs=3, autoreset_mode=mode, with_infos=True, **arguments)
    single: Any = SyncVectorEnv([lambda: gym.make("JackInBox-v0", **arguments)] * 3, autoreset_mode=mode)
    assert batched.observation_space == single.observation_space
    assert batched.action_space == single.action_space
    impacts, mask = 0, np.array([True, False, True])
    for options in ({"seed": 11}, {"seed": [5, None, 7]}, {"options": {"reset_mask": mask}}):
        assert_same(*(env.reset(**copy.deepcopy(options)) for env in (batched, single)))
        for actions in np.random.default_rng(0).uniform(-1.2, 1.2, (90, 3, 2)).astype(np.float32):
            actual, expected = batched.step(actions), single.step(actions)
            assert_same(actual, expected)
            impacts += int(actual[4]["impacts"].sum())
    assert impacts > 6


# -- a row of a rollout -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("task", ["juggle", "rattle", FALL])
def test_rows_of_a_rollout_are_environments_from_any_number_of_threads(task: str | Task) -> None:
    kinds = [*SCENES, Scene(jack_arm=6.5), Scene(drive=Drive(torque=lambda t: 1e9, force_y=lambda t: 2e4 * t))]
    scenes = [scene.changed(torque_limit=90000.0) for scene in kinds for _ in range(3)]
    rng = np.random.default_rng(1)
    states = np.array([inside(scene, rng) for scene in scenes])
    states[15:18, 5] = states[15:18, 2] + math.pi / 4.0  # a long arm fits along the diagonals only
    states[15:18, 3:5] = states[15:18, :2]
    shares = rng.uniform(-1.0, 1.0, (len(scenes), 40))
    torques = shares * 90000.0
    asked: Any = {"time": 3.0, "energy": True, "impacts": True, "rewards": task, "repeat": 2}
    rollouts: Any = rollout(scenes, states, torques, 0.02, **asked)
    for number, scene in enumerate(scenes):
        env = JackInBoxEnv(contact="exact", scene=scene, task=task)
        info = env.reset(options={"state": states[number], "time": 3.0})[1]
        steps = [env.step(share) for share in np.repeat(shares[number], 2)]
        ended = next((step for step, outcome in enumerate(steps, 1) if outcome[2]), len(steps))
        path = [info["state"], *(step[4]["state"] for step in steps)]
        energies = [energy(scene, state) for state in path]
        hits, impulses = ([step[4][name] for step in steps] for name in ("impacts", "impulse"))
        earned = [outcome[1] if step < ended else 0.0 for step, outcome in enumerate(steps)]
        expected = path, energies, hits, impulses, earned, ended
        assert_same([values[number] for values in rollouts], [np.array(values) for values in expected])
    assert rollouts.impacts.sum() > 100
    for threads in (1, 2, 3):
        assert_same(rollout(scenes, states, torques, 0.02, num_threads=threads, **asked), rollouts)
