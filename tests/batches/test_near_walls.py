"""A batch moves jacks together that stay off the walls: it must find every jack that does not."""

from __future__ import annotations

import numpy as np
import pytest

from jackbox_env import JackInBoxVectorEnv, JackLostError, Rollout, Scene, make_simulator, rollout
from tests.states import inside

COUNT = 2000
SCENES = [
    Scene(),
    Scene(jack_arm=5.0, gravity=0.0),
    Scene(box_half_width=0.02, jack_arm=0.001, torque_limit=1.0, restitution=0.8),
]


def moving(scene: Scene, fastest: float) -> np.ndarray:
    """Jacks on the circle that always fits, in boxes that turn at up to ``fastest`` rad/s, flying and spinning."""
    rng = np.random.default_rng(2)
    states = np.array([inside(scene, rng) for _ in range(COUNT)])
    states[:, 3:5] -= states[:, :2]
    states[:, 3:5] *= ((scene.box_half_width - scene.jack_arm) / np.hypot(states[:, 3], states[:, 4]))[:, None]
    states[:, 3:5] += states[:, :2]
    states[:, 6:8] = 0.0
    states[:, 8] = rng.uniform(-fastest, fastest, COUNT)
    states[:, 9:11] = rng.normal(size=(COUNT, 2)) * scene.speed_scale
    states[:, 11] = rng.uniform(-fastest, fastest, COUNT)
    return states


@pytest.mark.parametrize("fastest", [0.5, 20.0, 200.0])
@pytest.mark.parametrize("scene", SCENES, ids=["default", "long arm", "small"])
def test_the_first_step_is_that_of_a_rollout(scene: Scene, fastest: float) -> None:
    states = moving(scene, fastest)
    actions = np.random.default_rng(3).uniform(-1.0, 1.0, COUNT)
    env = JackInBoxVectorEnv(COUNT, contact="exact", scene=scene, control_dt=0.02)
    env.reset(seed=0)
    env.set_states(states, np.zeros(COUNT))
    env.step(actions)
    found = rollout(scene, states, actions[:, None] * scene.torque_limit, 0.02, impacts=True)

    assert isinstance(found, Rollout)
    assert found.impacts is not None
    np.testing.assert_array_equal(env.states, found.trajectories[:, 1])
    struck = int((found.impacts[:, 0] > 0).sum())
    assert 20 < struck < COUNT - 20  # both kinds are there


@pytest.mark.parametrize("place", [6, 9])
def test_where_float64_runs_out_of_places_it_says_what_a_single_one_says(place: int) -> None:
    scene = Scene()
    state = np.array([0, 0, 0, 4.0, 4.0, 0, 0, 0, 0, 0, 0, 0], dtype=float)
    state[[7, 10] if place == 6 else [6, 9]] = 1e14  # together, so that the jack stays in a corner, off the walls
    single = make_simulator(scene, "exact")
    single.reset(state)
    env = JackInBoxVectorEnv(3, contact="exact", scene=scene)
    env.reset(seed=0)
    env.set_states(np.repeat(state[None], 3, axis=0), np.zeros(3))
    with pytest.raises(JackLostError):
        single.step(0.02, 0.0)
    with pytest.raises(JackLostError):
        env.step(np.zeros(3))


def test_a_torque_that_is_too_steep_is_refused_as_by_a_single_one() -> None:
    scene = Scene(gravity=0.0, torque_limit=1e50)
    single = make_simulator(scene, "exact")
    single.reset(np.zeros(12))
    with pytest.raises(JackLostError):
        single.step(0.02, 1e50)
    env = JackInBoxVectorEnv(1, contact="exact", scene=scene)
    env.reset(seed=0)
    env.set_states(np.zeros(12), 0.0)
    with pytest.raises(JackLostError):
        env.step(np.ones(1))
