"""Scenes of their own: each environment of a batch is the single one of its scene, whoever chose or drew it."""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from jackbox_env import Chirp, Drive, JackInBoxEnv, JackInBoxVectorEnv, Scene, rollout
from jackbox_env.sb3 import make_sb3_vec_env

EVERY_MODEL = pytest.mark.parametrize("contact", ["exact", "pymunk"])
SHAKEN = Drive(force_x=lambda time: 2e4 * math.cos(5.0 * time))
TURNED = Drive(torque=lambda time: 6e4 * math.sin(3.0 * time))
SCENES = (
    Scene(),
    Scene(gravity=1.62, restitution=0.6, drive=None),
    Scene(box_half_width=3.0, jack_mass=9.0, torque_limit=2e4, drive=Chirp(2e4, 1.0, 0.0)),
    Scene(jack_arm=4.0, drive=SHAKEN),
    Scene(gravity=0.0, box_mass=50.0, torque_limit=5000.0, drive=TURNED),
)
RANGES = {"jack_mass": (2.0, 6.0), "restitution": (0.5, 1.0), "box_half_width": (4.0, 8.0), "gravity": (0.0, 20.0)}


def choosy(rng: np.random.Generator) -> dict[str, Any]:
    """Fields that depend on draws of 32 bits, of which numpy keeps a half for the next one."""
    arm = float(rng.choice([0.5, 1.0, 1.5]))
    chirp = Chirp(1e4 * int(rng.integers(1, 9, dtype=np.int32)), 0.5, 0.0)
    return {"jack_arm": arm, "drive": chirp if rng.random() < 0.5 else None}


def play(env: Any, steps: int, seed: int) -> list[Any]:
    """What a batch returns: every seventh step under the drive, the others under random actions."""
    rng, found = np.random.default_rng(seed), []
    for step in range(steps):
        actions = rng.uniform(-1.0, 1.0, env.num_envs)
        seen, rewards, _, truncations, infos = env.step(None if step % 7 == 0 else actions)
        found.append((seen, rewards, truncations, infos["state"], infos["torque"], infos["impulse"]))
    return found


def play_singles(envs: list[JackInBoxEnv], steps: int, seed: int, limit: int) -> list[Any]:
    """The same by single environments, which restart in the step after their last."""
    rng, found = np.random.default_rng(seed), []
    for step in range(steps):
        actions = rng.uniform(-1.0, 1.0, len(envs))
        rows = []
        for env, action in zip(envs, actions, strict=True):
            if step % (limit + 1) == limit:
                seen, info = env.reset()
                rows.append((seen, 0.0, False, info["state"], 0.0, 0.0))
                continue
            seen, reward, _, _, info = env.step(None if step % 7 == 0 else action)
            ends = step % (limit + 1) == limit - 1
            rows.append((seen, reward, ends, info["state"], info["torque"], info["impulse"]))
        found.append(tuple(np.array(column) for column in zip(*rows, strict=True)))
    return found


def assert_same(one: list[Any], other: list[Any]) -> None:
    for step, (left, right) in enumerate(zip(one, other, strict=True)):
        for a, b in zip(left, right, strict=True):
            np.testing.assert_array_equal(a, b, err_msg=f"step {step}")


# -- a list of scenes -------------------------------------------------------------------------------------------------


@EVERY_MODEL
@pytest.mark.parametrize("count", [1, 2, 5])
def test_each_environment_is_the_single_one_of_its_scene(contact: str, count: int) -> None:
    scenes = list(SCENES[-count:])
    batch = JackInBoxVectorEnv(count, 60, scene=scenes, contact=contact, with_infos=True)
    singles = [JackInBoxEnv(scene=scene, contact=contact) for scene in scenes]
    seen, _ = batch.reset(seed=4)
    np.testing.assert_array_equal(seen, [env.reset(seed=4 + i)[0] for i, env in enumerate(singles)])
    assert_same(play(batch, 150, 0), play_singles(singles, 150, 0, 60))
    assert batch.scenes == scenes


def test_three_hundred_scenes_in_blocks_are_the_single_ones() -> None:
    scenes = [Scene(gravity=0.05 * i, jack_mass=1.0 + 0.01 * i) for i in range(300)]
    batch = JackInBoxVectorEnv(300, 40, scene=scenes, contact="exact", with_infos=True, num_threads=2)
    batch.reset(seed=0)
    found = play(batch, 60, 1)
    for number in (0, 127, 128, 299):
        single = JackInBoxEnv(scene=scenes[number], contact="exact")
        single.reset(seed=number)
        rng = np.random.default_rng(1)
        for step in range(40):
            action = rng.uniform(-1.0, 1.0, 300)[number]
            seen, reward, *_ = single.step(None if step % 7 == 0 else action)
            np.testing.assert_array_equal(found[step][0][number], seen)
            assert found[step][1][number] == reward


def test_equal_scenes_are_one() -> None:
    batch = JackInBoxVectorEnv(3, scene=[Scene(gravity=3.0)] * 3, contact="exact")
    assert batch.scene == Scene(gravity=3.0)
    mixed = JackInBoxVectorEnv(2, scene=[{"gravity": 3.0}, None], contact="exact")
    assert mixed.scenes == [Scene(gravity=3.0), Scene()]
    with pytest.raises(ValueError, match="different scenes: read scenes"):
        mixed.scene  # noqa: B018


def test_scenes_through_make_vec_and_stable_baselines() -> None:
    made = gym.make_vec("JackInBox-v0", 2, vectorization_mode="vector_entry_point", scene=list(SCENES[:2]))
    assert made.unwrapped.scenes == list(SCENES[:2])  # type: ignore[attr-defined]
    vec_env = make_sb3_vec_env(2, scene=list(SCENES[:2]), contact="exact")
    assert vec_env.get_attr("scene") == list(SCENES[:2])
    drawn = make_sb3_vec_env(3, randomize=RANGES, contact="exact")
    drawn.seed(0)
    drawn.reset()
    singles = [JackInBoxEnv(randomize=RANGES, contact="exact") for _ in range(3)]
    for i, env in enumerate(singles):
        env.reset(seed=i)
    assert drawn.get_attr("scene") == [env.scene for env in singles]


# -- drawn at each reset ----------------------------------------------------------------------------------------------


@EVERY_MODEL
@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("randomize", [RANGES, choosy], ids=["ranges", "a function"])
def test_drawn_scenes_are_those_of_single_environments(contact: str, count: int, randomize: Any) -> None:
    batch = JackInBoxVectorEnv(count, 20, contact=contact, randomize=randomize, with_infos=True)
    singles = [JackInBoxEnv(contact=contact, randomize=randomize) for _ in range(count)]
    seen, _ = batch.reset(seed=7)
    np.testing.assert_array_equal(seen, [env.reset(seed=7 + i)[0] for i, env in enumerate(singles)])
    drawn = []
    for stretch in range(3):
        assert_same(play(batch, 21, stretch), play_singles(singles, 21, stretch, 20))
        assert batch.scenes == [env.scene for env in singles]
        drawn.append(batch.scenes)
    assert drawn[0] != drawn[1] != drawn[2]


def test_drawn_numbers_are_uniform_and_come_before_the_start_in_the_order_of_the_fields() -> None:
    env, twin = JackInBoxEnv(randomize={"restitution": (0.8, 1.0), "jack_mass": (2.0, 6.0)}), JackInBoxEnv()
    env.reset(seed=3)
    rng = np.random.default_rng(3)
    assert env.scene.jack_mass == 2.0 + 4.0 * rng.random() == env.scene.jack_inertia
    assert env.scene.restitution == 0.8 + (1.0 - 0.8) * rng.random()
    assert env.scene.box_mass == twin.scene.box_mass
    x = rng.uniform(-1.0, 1.0, 3)
    assert env.state[3] == x[0]
    assert env.state[5] == 0.5 * x[2]
    masses = []
    for _ in range(2000):
        env.reset()
        masses.append(env.scene.jack_mass)
    assert np.abs(np.quantile(masses, [0.1, 0.5, 0.9]) - [2.4, 4.0, 5.6]).max() < 0.2


def test_a_range_of_an_inertia_wins_over_the_mass() -> None:
    batch = JackInBoxVectorEnv(2, contact="exact", randomize={"jack_inertia": (1.0, 2.0), "jack_mass": (50.0, 60.0)})
    batch.reset(seed=0)
    assert all(1.0 <= scene.jack_inertia <= 2.0 < 50.0 <= scene.jack_mass for scene in batch.scenes)
    given = JackInBoxVectorEnv(2, contact="exact", scene={"jack_inertia": 3.0}, randomize={"jack_mass": (50.0, 60.0)})
    given.reset(seed=0)
    assert all(scene.jack_inertia == 3.0 for scene in given.scenes)


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_every_way_to_restart_draws_the_same_scenes(mode: AutoresetMode) -> None:
    batch = JackInBoxVectorEnv(2, 5, mode, contact="exact", randomize=RANGES)
    batch.reset(seed=0)
    for _ in range(5):
        batch.step(None)
    if mode is AutoresetMode.DISABLED:
        batch.reset(options={"reset_mask": np.ones(2, dtype=bool)})
    elif mode is AutoresetMode.NEXT_STEP:
        batch.step(None)
    twin = JackInBoxVectorEnv(2, contact="exact", randomize=RANGES)
    twin.reset(seed=0)
    first = twin.scenes
    twin.reset()
    assert batch.scenes == twin.scenes != first
    np.testing.assert_array_equal(batch.states, twin.states)
    np.testing.assert_array_equal(batch.observations, twin.observations)


def test_a_step_that_fails_draws_no_scene() -> None:
    batch = JackInBoxVectorEnv(2, 3, contact="exact", randomize=RANGES)
    batch.reset(seed=0)
    for _ in range(3):
        batch.step(None)
    before = batch.scenes
    with pytest.raises(ValueError, match="actions must have shape"):
        batch.step(np.zeros(5))
    assert batch.scenes == before


# -- options["scene"] -------------------------------------------------------------------------------------------------


@EVERY_MODEL
def test_the_option_changes_the_scene_until_the_next_such_option(contact: str) -> None:
    env = JackInBoxEnv(contact=contact, scene={"gravity": 5.0})
    batch = JackInBoxVectorEnv(2, 10, contact=contact, scene={"gravity": 5.0}, with_infos=True)
    env.reset(seed=0)
    batch.reset(seed=0)
    options: dict[str, Any] = {"scene": {"jack_mass": 9.0, "box_half_width": 4.0}}
    seen, _ = env.reset(options=options)
    all_seen, _ = batch.reset(options=options)
    np.testing.assert_array_equal(seen, all_seen[0])
    assert env.scene == Scene(gravity=5.0, jack_mass=9.0, box_half_width=4.0) == batch.scene
    assert env.scene.jack_inertia == 9.0
    for _ in range(12):
        batch.step(None)  # past a restart
    env.reset()
    assert env.scene.jack_mass == batch.scenes[0].jack_mass == 9.0
    env.reset(options={"scene": {"gravity": 1.0}})  # of the scene it was made with
    batch.reset(options={"scene": {"gravity": 1.0}})
    assert env.scene == Scene(gravity=1.0) == batch.scene
    env.reset(options={"scene": {}})
    assert env.scene == Scene(gravity=5.0)


@EVERY_MODEL
def test_the_option_wins_over_what_is_drawn_for_one_episode(contact: str) -> None:
    env = JackInBoxEnv(contact=contact, randomize=RANGES)
    batch = JackInBoxVectorEnv(2, contact=contact, randomize=RANGES)
    options: dict[str, Any] = {"scene": {"jack_mass": 77.0, "jack_arm": 2.0}}
    env.reset(seed=5, options=options)
    batch.reset(seed=5, options=options)
    assert env.scene == batch.scenes[0]
    assert (env.scene.jack_mass, env.scene.jack_inertia, env.scene.jack_arm) == (77.0, 77.0 * 4.0, 2.0)
    plain = JackInBoxEnv(contact=contact, randomize=RANGES)
    plain.reset(seed=5)
    assert env.scene.gravity == plain.scene.gravity  # what is drawn does not depend on the option
    env.reset()
    batch.reset()
    plain.reset()
    assert env.scene == batch.scenes[0] == plain.scene
    assert env.scene.jack_arm == 1.0


@EVERY_MODEL
def test_some_environments_get_other_scenes(contact: str) -> None:
    batch = JackInBoxVectorEnv(3, contact=contact)
    batch.reset(seed=0)
    mask = np.array([False, True, True])
    batch.reset(options={"scene": [None, {"gravity": 2.0}, {"restitution": 0.5, "drive": None}], "reset_mask": mask})
    assert batch.scenes == [Scene(), Scene(gravity=2.0), Scene(restitution=0.5, drive=None)]
    singles = [JackInBoxEnv(contact=contact, scene=scene) for scene in batch.scenes]
    for env, state in zip(singles, batch.states, strict=True):
        env.set_state(state)
    for _ in range(60):
        seen, rewards, *_ = batch.step(None)
        steps = [env.step(None) for env in singles]
        np.testing.assert_array_equal(seen, [step[0] for step in steps])
        np.testing.assert_array_equal(rewards, [step[1] for step in steps])


def test_states_are_checked_against_the_scene_that_comes_with_them() -> None:
    state = np.zeros(12)
    state[3] = 6.0  # outside of the default box, inside of one of 9 m
    for env in (JackInBoxEnv(contact="exact"), JackInBoxVectorEnv(2, contact="exact")):
        env.reset(seed=0)
        before = getattr(env, "scenes", None) or env.scene
        with pytest.raises(ValueError, match="outside"):
            env.reset(options={"state": state})
        env.reset(options={"state": state, "scene": {"box_half_width": 9.0}})
        with pytest.raises(ValueError, match="outside"):
            env.reset(options={"state": state, "scene": {"box_half_width": 6.5}})
        after = getattr(env, "scenes", None) or env.scene
        assert after != before
        assert (after[0] if isinstance(after, list) else after).box_half_width == 9.0


def test_the_option_through_stable_baselines() -> None:
    vec_env = make_sb3_vec_env(2, contact="exact")
    vec_env.seed(0)
    vec_env.set_options([{"scene": {"gravity": 1.0}}, {}])
    vec_env.reset()
    assert vec_env.get_attr("scene") == [Scene(gravity=1.0), Scene()]


# -- refusals ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [JackInBoxEnv, JackInBoxVectorEnv])
@pytest.mark.parametrize(
    ("randomize", "message"),
    [
        ({"jack_arm": (1.0, 9.0)}, "could draw a scene with jack_arm=9, which is refused: jack_arm must be below"),
        ({"jack_arm": (1.0, 5.0), "box_half_width": (3.0, 9.0)}, "jack_arm=5, which is refused"),
        ({"restitution": (0.9, 1.1)}, "restitution must be"),
        ({"jack_mass": (6.0, 2.0)}, r"randomize\['jack_mass'\] must be \(least, largest\)"),
        ({"jack_mass": 6.0}, "must be \\(least, largest\\), got 6.0"),
        ({"jack_mass": (1.0, math.nan)}, "finite"),
        ({"drive": (1.0, 2.0)}, "randomize takes only"),
        ("jack_mass", "randomize must be a dict of the scene's fields with their ranges, or a function"),
    ],
)
def test_ranges_that_could_draw_a_misfit_are_refused(make: Any, randomize: Any, message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        make(randomize=randomize)


def test_a_contact_models_own_refusal_counts_for_ranges_too() -> None:
    ranges = {"jack_inertia": (1e-6, 4.0)}
    JackInBoxEnv(contact="exact", randomize=ranges)
    with pytest.raises(ValueError, match="could draw a scene with jack_inertia=1e-06, which is refused"):
        JackInBoxEnv(contact="pymunk", randomize=ranges)


@EVERY_MODEL
def test_a_function_that_draws_a_misfit_leaves_all_as_it_was(contact: str) -> None:
    bad: list[Any] = []

    def sometimes(rng: np.random.Generator) -> Any:
        return bad[0] if bad else {"gravity": float(rng.uniform(1.0, 2.0))}

    for env in (
        JackInBoxEnv(contact=contact, randomize=sometimes),
        JackInBoxVectorEnv(2, contact=contact, randomize=sometimes),
    ):
        bad.clear()
        env.reset(seed=0)
        before = env.scene if isinstance(env, JackInBoxEnv) else env.scenes
        for wrong in ({"jack_arm": 100.0}, {"nothing": 1.0}, 3.0):
            bad[:] = [wrong]
            with pytest.raises((TypeError, ValueError)):
                env.reset()
            assert (env.scene if isinstance(env, JackInBoxEnv) else env.scenes) == before
        bad.clear()
        env.step(None)
        env.reset()
        twin = JackInBoxEnv(contact=contact, randomize=sometimes)
        twin.reset(seed=0)
        twin.reset()
        assert (env.scene if isinstance(env, JackInBoxEnv) else env.scenes[0]) == twin.scene


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scene": 3.0}, r"options\['scene'\] must be a dict"),
        ({"scene": {"nothing": 1.0}}, "scene takes only"),
        ({"scene": {"jack_arm": 100.0}}, "jack_arm must be below"),
    ],
)
def test_options_that_are_refused_leave_all_as_it_was(options: Any, message: str) -> None:
    for env in (JackInBoxEnv(), JackInBoxVectorEnv(2), JackInBoxVectorEnv(2, contact="exact")):
        env.reset(seed=0)
        with pytest.raises((TypeError, ValueError), match=message):
            env.reset(options=options)
        assert env.scene == Scene()
        env.step(None)


def test_lists_of_another_length_are_refused() -> None:
    with pytest.raises(ValueError, match="scene must be one scene or a list of 3, got 2 of them"):
        JackInBoxVectorEnv(3, scene=[Scene(), Scene()])
    with pytest.raises(TypeError, match=r"scene\[1\]: scene must be a Scene"):
        JackInBoxVectorEnv(2, scene=[None, 3.0])  # type: ignore[list-item]
    batch = JackInBoxVectorEnv(3)
    with pytest.raises(TypeError, match="a list of 3"):
        batch.reset(options={"scene": [{}, {}]})
    with pytest.raises(ValueError, match="list of 2, as many as rows, got 3 of them"):
        rollout([Scene()] * 3, np.zeros((2, 12)), np.zeros(5), 0.02)


# -- rollouts ---------------------------------------------------------------------------------------------------------


def test_a_rollout_takes_a_scene_for_each_row() -> None:
    rng = np.random.default_rng(0)
    torques = rng.uniform(-5e3, 5e3, (len(SCENES), 80))
    states = np.zeros((len(SCENES), 12))
    states[:, 5] = math.pi / 4.0
    played = rollout(list(SCENES), states, torques, 0.05, energy=True, impacts=True, rewards="juggle")
    for row, scene in enumerate(SCENES):
        alone = rollout(scene, states[row], torques[row : row + 1], 0.05, energy=True, impacts=True, rewards="juggle")
        for found, wanted in zip(played, alone, strict=True):
            assert found is not None
            assert wanted is not None
            np.testing.assert_array_equal(found[row], wanted[0])
    assert rollout(list(SCENES), states[0], torques[0], 0.05).shape == (len(SCENES), 81, 12)
    shifted = states.copy()
    shifted[2, 3] = 4.0  # outside of a box of 3 m only
    with pytest.raises(ValueError, match=r"states\[2\]"):
        rollout(list(SCENES), shifted, torques, 0.05)
