"""A scene for each environment: it equals the single environment of that scene, chosen or drawn."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from jackbox_env import Chirp, JackInBoxEnv, JackInBoxVectorEnv, Scene
from jackbox_env.sb3 import make_sb3_vec_env
from tests.batches.several import EVERY_MODEL, RANGES, SCENES, SHAKEN, actions_at, assert_same, choosy, play, play_alone

EVERY_DRAW = pytest.mark.parametrize("randomize", [RANGES, choosy], ids=["ranges", "a function"])


# -- a list of scenes -------------------------------------------------------------------------------------------------


def test_equal_scenes_are_one() -> None:
    batch = JackInBoxVectorEnv(3, scene=[Scene(gravity=3.0)] * 3, contact="exact")
    assert batch.scene == Scene(gravity=3.0)
    mixed = JackInBoxVectorEnv(2, scene=[{"gravity": 3.0}, None], contact="exact")
    assert mixed.scenes == [Scene(gravity=3.0), Scene()]


def test_scenes_through_make_vec_and_stable_baselines() -> None:
    made: Any = gym.make_vec("JackInBox-v0", 2, scene=list(SCENES[:2]))
    assert made.unwrapped.scenes == list(SCENES[:2])
    listed = make_sb3_vec_env(2, scene=list(SCENES[:2]), contact="exact")
    assert listed.get_attr("scene") == list(SCENES[:2])
    listed.set_options([{"scene": {"gravity": 1.0}}, {}])
    listed.reset()
    assert listed.get_attr("scene") == [Scene(gravity=1.0), SCENES[1]]


# -- drawn at each reset ----------------------------------------------------------------------------------------------


@EVERY_MODEL
@pytest.mark.parametrize("count", [1, 3])
@EVERY_DRAW
def test_drawn_scenes_are_those_of_single_environments(contact: str, count: int, randomize: Any) -> None:
    batch = JackInBoxVectorEnv(count, 20, contact=contact, randomize=randomize, with_infos=True)
    singles = [JackInBoxEnv(contact=contact, randomize=randomize) for _ in range(count)]
    seen, _ = batch.reset(seed=7)
    np.testing.assert_array_equal(seen, [env.reset(seed=7 + i)[0] for i, env in enumerate(singles)])
    drawn = []
    for stretch in range(3):
        assert_same(play(batch, 21, stretch), play_alone(singles, 21, stretch, 20))
        assert batch.scenes == [env.scene for env in singles]
        drawn.append(batch.scenes)
    assert drawn[0] != drawn[1] != drawn[2]


@EVERY_MODEL
def test_infos_have_the_drawn_scenes_of_the_ended_episode_and_of_the_next(contact: str) -> None:
    ranges = {name: RANGES[name] for name in ("gravity", "jack_mass")}
    env = JackInBoxEnv(contact=contact, randomize=ranges)
    drawn = [env.reset(seed=4)[1]["scene"]]
    assert drawn[0] == {"jack_mass": env.scene.jack_mass, "gravity": env.scene.gravity} == env.step(None)[4]["scene"]
    drawn.append(env.reset()[1]["scene"])
    assert drawn[0] != drawn[1]
    batch = JackInBoxVectorEnv(2, 3, "SAME_STEP", contact=contact, randomize=ranges, with_infos=True)
    listed = make_sb3_vec_env(2, max_episode_steps=3, contact=contact, randomize=ranges, with_infos=True)
    listed.seed(4)
    listed.reset()
    _, infos = batch.reset(seed=4)
    assert listed.reset_infos[0]["scene"] == drawn[0] == {name: infos["scene"][name][0] for name in drawn[0]}
    for _ in range(3):
        infos = batch.step(None)[4]
        rows = listed.step(np.zeros((2, 1)))[3]
    for scenes, expected in ((infos["final_info"]["scene"], drawn[0]), (infos["scene"], drawn[1])):
        assert {name: scenes[name][0] for name in ranges} == expected
    assert (rows[0]["scene"], listed.reset_infos[0]["scene"]) == tuple(drawn)
    turned = make_sb3_vec_env(2, contact=contact, randomize=lambda rng: {"drive": SHAKEN}, with_infos=True)
    turned.reset()
    assert "scene" not in turned.step(np.zeros((2, 1)))[3][0]  # no number is drawn


@EVERY_MODEL
def test_a_curriculum_reads_its_variable_at_each_reset(contact: str) -> None:
    heaviest = [4.5]
    settings: dict[str, Any] = {"contact": contact, "randomize": lambda rng: {"jack_mass": rng.uniform(4.0, *heaviest)}}
    env, batch = JackInBoxEnv(**settings), JackInBoxVectorEnv(3, max_episode_steps=2, **settings)
    listed = make_sb3_vec_env(3, max_episode_steps=2, **settings)
    for most in (4.5, 400.0):
        heaviest[0] = most
        env.reset(seed=1)
        if most == 4.5:
            batch.reset(seed=1)
            listed.seed(1)
            listed.reset()
        for _ in range(3):  # also the restart of an episode
            batch.step(None)
            listed.step(np.zeros((3, 1)))
        masses = [env.scene.jack_mass, *batch.field("jack_mass"), *(one.jack_mass for one in listed.get_attr("scene"))]
        assert (np.array(masses) > 4.5).any() == (most == 400.0)


@EVERY_MODEL
def test_impacts_of_each_environment_are_those_of_the_single_one(contact: str) -> None:
    scenes = [Scene(restitution=0.3), Scene(drive=SHAKEN), Scene(restitution=0.0, gravity=30.0)]  # two come to rest
    batch = JackInBoxVectorEnv(3, 150, "SAME_STEP", contact=contact, scene=scenes)
    singles = [JackInBoxEnv(contact=contact, scene=scene) for scene in scenes]
    batch.reset(seed=0)
    for number, env in enumerate(singles):
        env.reset(seed=number)
        assert batch.impacts(number) == []
    most = [0, 0, 0]
    for step in range(149):
        actions = actions_at(step, 3) * (step < 60)
        batch.step(actions if step % 5 else None)
        for number, env in enumerate(singles):
            env.step(actions[number] if step % 5 else None)
            assert batch.impacts(number) == env.impacts
            most[number] = max(most[number], len(env.impacts))
    assert 1 <= min(most) < 3 <= max(most)
    batch.step(None)
    assert [batch.impacts(number) for number in range(3)] == [[], [], []]  # a new episode has begun


def test_numbers_are_drawn_before_the_start_in_the_order_of_the_fields() -> None:
    env = JackInBoxEnv(randomize={"restitution": (0.8, 1.0), "jack_mass": (2.0, 6.0)})
    env.reset(seed=3)
    rng = np.random.default_rng(3)
    assert env.scene.jack_mass == 2.0 + 4.0 * rng.random() == env.scene.jack_inertia
    assert env.scene.restitution == 0.8 + (1.0 - 0.8) * rng.random()
    assert env.scene.box_mass == Scene().box_mass
    x = rng.uniform(-1.0, 1.0, 3)
    assert (env.state[3], env.state[5]) == (x[0], 0.5 * x[2])


def test_an_inertia_that_is_fixed_or_drawn_does_not_follow_the_mass() -> None:
    batch = JackInBoxVectorEnv(2, contact="exact", randomize={"jack_inertia": (1.0, 2.0), "jack_mass": (50.0, 60.0)})
    batch.reset(seed=0)
    assert all(1.0 <= scene.jack_inertia <= 2.0 < 50.0 <= scene.jack_mass for scene in batch.scenes)
    fixed = JackInBoxVectorEnv(2, contact="exact", scene={"jack_inertia": 3.0}, randomize={"jack_mass": (50.0, 60.0)})
    fixed.reset(seed=0)
    assert all(scene.jack_inertia == 3.0 for scene in fixed.scenes)


# -- options["scene"] -------------------------------------------------------------------------------------------------


@EVERY_MODEL
def test_the_option_changes_the_scene_until_the_next_such_option(contact: str) -> None:
    env = JackInBoxEnv(contact=contact, scene={"gravity": 5.0})
    batch = JackInBoxVectorEnv(2, 10, contact=contact, scene={"gravity": 5.0}, with_infos=True)
    changed = {"jack_mass": 9.0, "box_half_width": 4.0}
    expected = [changed, None, {"gravity": 1.0}, {}]
    scenes = [{"gravity": 5.0, **changed}, {"gravity": 5.0, **changed}, {"gravity": 1.0}, {"gravity": 5.0}]
    for option, scene in zip(expected, scenes, strict=True):
        options: Any = None if option is None else {"scene": option}
        seen, _ = env.reset(seed=0, options=options)
        all_seen, _ = batch.reset(seed=0, options=options)
        np.testing.assert_array_equal(seen, all_seen[0])
        assert env.scene == Scene(**scene) == batch.scene  # type: ignore[arg-type]
        for _ in range(12):
            batch.step(None)  # past a restart
        assert batch.scene == env.scene


@EVERY_MODEL
def test_the_option_wins_over_what_is_drawn_for_one_episode(contact: str) -> None:
    env, plain = (JackInBoxEnv(contact=contact, randomize=RANGES) for _ in range(2))
    batch = JackInBoxVectorEnv(2, contact=contact, randomize=RANGES)
    options: dict[str, Any] = {"scene": {"jack_mass": 77.0, "jack_arm": 2.0}}
    env.reset(seed=5, options=options)
    batch.reset(seed=5, options=options)
    plain.reset(seed=5)  # what is drawn does not depend on the option
    assert env.scene == batch.scenes[0] == plain.scene.changed(jack_mass=77.0, jack_arm=2.0)
    assert env.scene.jack_inertia == 77.0 * 4.0
    for one in (env, batch, plain):
        one.reset()
    assert env.scene == batch.scenes[0] == plain.scene


@EVERY_MODEL
@pytest.mark.parametrize("drive", [None, Chirp(2e4, 1.0, 0.0), SHAKEN], ids=["none", "chirp", "functions"])
@EVERY_DRAW
def test_a_drive_of_the_option_ends_with_the_episode_where_scenes_are_drawn(
    contact: str, drive: Any, randomize: Any
) -> None:
    batch = JackInBoxVectorEnv(3, 9, contact=contact, randomize=randomize, with_infos=True)
    singles = [JackInBoxEnv(contact=contact, randomize=randomize) for _ in range(3)]
    batch.reset(seed=0)
    mask = np.array([True, False, True])
    batch.reset(options={"scene": {"drive": drive}, "reset_mask": mask})
    for number, env in enumerate(singles):
        env.reset(seed=number)
        if mask[number]:
            env.reset(options={"scene": {"drive": drive}})
    assert [scene.drive is drive for scene in batch.scenes] == mask.tolist() or randomize is choosy
    assert_same(play(batch, 35, 0), play_alone(singles, 35, 0, 9))
    assert batch.scenes == [env.scene for env in singles]


@EVERY_MODEL
def test_some_environments_get_other_scenes(contact: str) -> None:
    batch = JackInBoxVectorEnv(3, contact=contact, with_infos=True)
    batch.reset(seed=0)
    mask = np.array([False, True, True])
    batch.reset(options={"scene": [None, {"gravity": 2.0}, {"restitution": 0.5, "drive": None}], "reset_mask": mask})
    assert batch.scenes == [Scene(), Scene(gravity=2.0), Scene(restitution=0.5, drive=None)]
    singles = [JackInBoxEnv(contact=contact, scene=scene) for scene in batch.scenes]
    for number, env in enumerate(singles):
        env.set_state(batch.states[number])
    assert_same(play(batch, 60, 0), play_alone(singles, 60, 0))
