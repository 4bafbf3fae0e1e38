"""A jack never escapes silently: starts outside are refused, and so is motion that no contact model can follow."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from jackbox_env import JackInBoxEnv, JackInBoxVectorEnv, JackLostError, Scene, make_simulator, rollout
from jackbox_env.mechanics import energy, simultaneous_impact_map
from jackbox_env.model.states import as_restored, as_start, clearance
from jackbox_env.simulators import CONTACT_MODELS
from jackbox_env.simulators.pymunk import PymunkSimulator
from tests.guarantees.poses import velocity_error
from tests.simulators.engine import impact_in_an_instant
from tests.states import Array, several_contacts

EVERY_MODEL = pytest.mark.parametrize("contact", CONTACT_MODELS)


def with_foot(outside: float, width: float = 6.0) -> Array:
    """A jack at rest with a foot so far outside a box of this half width [m]."""
    state = np.zeros(12)
    state[3] = width - 1.0 + outside
    return state


@EVERY_MODEL
def test_a_start_has_every_foot_inside_and_a_state_that_is_put_back_at_most_a_metre_outside(contact: str) -> None:
    env, several = JackInBoxEnv(contact=contact), JackInBoxVectorEnv(2, contact=contact)
    for one in (env, several):
        one.reset(seed=1)
        for outside in (2e-9, 1e-3, 45.0):
            with pytest.raises(ValueError, match=rf"at most 1e-09 m outside\), got a foot {outside:g} m outside"):
                one.reset(options={"state": with_foot(outside)})
        one.reset(options={"state": with_foot(9e-10)})
    put = [lambda state: env.set_state(state), lambda state: several.set_states(state, 0.0)]
    for call in [*put, lambda state: rollout(None, state, np.zeros(1), 0.02)]:
        call(with_foot(0.999))
        with pytest.raises(ValueError, match=r"at most 1 m outside, got 1.001 m"):
            call(with_foot(1.001))
    np.testing.assert_array_equal(env.state, with_foot(0.999))


def test_the_tolerance_grows_far_from_the_origin_and_shrinks_with_the_box() -> None:
    far = np.array([1e9, -1e9, 0.0, 1e9 + 5.0 + 2.4e-7, -1e9, *[0.0] * 7])  # 2 ulp outside
    np.testing.assert_array_equal(as_start(Scene(), far), far)
    far[3] += 1e-3
    with pytest.raises(ValueError, match="at most 4.76837e-07 m outside"):
        as_start(Scene(), far)
    with pytest.raises(ValueError, match=r"at most 0.9 m outside, got 0.91 m"):
        as_restored(Scene(box_half_width=0.9, jack_arm=0.5), with_foot(1.41, 0.9))


# Motion that cannot be followed: scene fields, columns of the state, their value, and the action.
RUNAWAYS: dict[str, tuple[dict[str, Any], list[int], float, float]] = {
    "speed of the jack": ({}, [9], 1e90, 0.0),
    "speed of the box": ({}, [6], 1e90, 0.0),
    "spin": ({}, [11], 1e90, 0.0),
    "torque in a corner": ({"torque_limit": 1e60}, [8], 0.0, 1.0),
    "torque in mid-air": ({"torque_limit": 1e60}, [3, 4], 0.0, 1.0),
}


@EVERY_MODEL
@pytest.mark.parametrize("runaway", RUNAWAYS)
def test_motion_that_cannot_be_followed_raises_and_changes_nothing(runaway: str, contact: str) -> None:
    fields, columns, value, action = RUNAWAYS[runaway]
    scene, state, actions = Scene(**fields, drive=None), np.zeros(12), np.zeros(3)
    state[3:6], actions[1] = (5.2, 5.2, math.pi / 4.0), action  # in a corner
    env, several = JackInBoxEnv(contact, scene=scene), JackInBoxVectorEnv(3, contact=contact, scene=scene)
    env.reset(seed=0)
    several.reset(seed=0)
    rows = several.states
    rows[1] = state
    rows[1, columns] = value
    env.set_state(rows[1], 1.0)
    several.set_states(rows, 1.0)
    sentence = "too fast to be followed|gap evaluations|would leave the box"
    for _ in range(2):
        with pytest.raises(JackLostError, match=sentence):
            env.step(action)
        with pytest.raises(JackLostError, match=sentence if contact == "pymunk" else "environment 1"):
            several.step(actions)
    np.testing.assert_array_equal(env.state, rows[1])
    np.testing.assert_array_equal(several.states, rows)
    assert (env.time, several.times.tolist()) == (1.0, [1.0] * 3)
    with pytest.raises(JackLostError, match=r"states\[1\]"):
        rollout(scene, rows, actions[:, None] * scene.torque_limit, 0.02)
    env.set_state(state)
    several.set_states(state, 0.0)
    env.step(0.0)
    several.step(np.zeros(3))


@EVERY_MODEL
def test_a_chirp_too_fast_to_follow_and_a_spin_that_wants_too_much_work_are_refused(contact: str) -> None:
    simulator = make_simulator(None, contact)
    simulator.reset(np.zeros(12), 1e6)
    with pytest.raises(ValueError, match=r"the chirp turns .* times in the .* s after t = 1e\+06 s, at most 83333"):
        simulator.step(1.0)
    fast = np.where(np.arange(12) == 11, 1e9, with_foot(-1e-3))
    simulator.reset(fast, 1e6)
    with pytest.raises(JackLostError, match=r"more than 1,000,000 gap evaluations|a foot moves"):
        simulator.step(1e5 if contact == "exact" else 0.02, 0.0)
    np.testing.assert_array_equal(simulator.state, fast)
    assert simulator.time == 1e6


def test_without_the_refusal_the_jack_would_be_out_of_the_box(monkeypatch: pytest.MonkeyPatch) -> None:
    state = with_foot(-1.0)
    state[9] = 1e5
    simulator = PymunkSimulator(Scene(drive=None))
    simulator.reset(state)
    with pytest.raises(JackLostError, match="would leave the box.*use more substeps, a smaller time step or"):
        simulator.step(0.02)
    np.testing.assert_array_equal(simulator.state, state)
    monkeypatch.setattr(PymunkSimulator, "_deepest", math.inf)
    simulator.step(0.02)
    assert clearance(simulator.scene, simulator.state.tolist()) < -1.0


def test_pymunk_refuses_inertias_that_couple_the_feet_too_strongly_and_the_exact_model_takes_them() -> None:
    for share in (1e-6, 1e-9, 1e-16, 1e-25):
        scene = Scene(jack_inertia=4.0 * share)
        with pytest.raises(ValueError, match=r"couple the feet so strongly .* needs .* iterations, at most 100,000"):
            make_simulator(scene, "pymunk")
        make_simulator(scene, "exact").step(0.02)
    with pytest.raises(ValueError, match="jack_arm = 1.000001 box_half_width couple the feet so strongly"):
        JackInBoxEnv("pymunk", scene={"jack_arm": 6.0 + 6e-6})


def test_with_too_few_iterations_the_feet_would_not_obey_the_law(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(gravity=0.0, drive=None, jack_inertia=0.004)
    state, contacts = several_contacts(scene, np.random.default_rng(3), "corner")
    expected, _ = simultaneous_impact_map(scene, state, contacts)
    assert velocity_error(scene, impact_in_an_instant(scene, state, iterations=None).state[6:], expected[6:]) < 1e-8
    with pytest.raises(JackLostError, match="is wedged between walls"):  # and the step is refused
        impact_in_an_instant(scene, state, iterations=64)
    monkeypatch.setattr(PymunkSimulator, "_resolved", lambda *_: True)
    assert velocity_error(scene, impact_in_an_instant(scene, state, iterations=64).state[6:], expected[6:]) > 1e-3


def test_a_step_that_is_too_long_for_pymunk_names_its_length() -> None:
    simulator = make_simulator(fidelity="balanced")
    simulator.reset([0.0] * 12)
    with pytest.raises(JackLostError, match="in the step of dt = 10 s after t = 0 s the contacts gain or lose energy"):
        simulator.step(10.0)


def wedged(scenes: int = 15) -> tuple[list[str], float]:
    """Errors of courses with feet in opposite walls, and the largest share of energy lost in the others."""
    rng, refused, loss = np.random.default_rng(0), list[str](), 0.0
    for _ in range(scenes):
        scene = Scene(jack_arm=6.0 * (1.0 + 10.0 ** rng.uniform(-2.0, -1.0)), gravity=0.0, drive=None)
        simulator, state = PymunkSimulator(scene, substeps=1), np.zeros(12)
        state[5], state[6:] = math.pi / 4.0, 3.0 * rng.standard_normal(6)
        state[11] = rng.uniform(1.0, 20.0)
        simulator.reset(state)
        try:
            for _ in range(20):
                simulator.step(0.02, 0.0)
                loss = max(loss, abs(1.0 - energy(scene, simulator.state) / energy(scene, state)))
        except JackLostError as error:
            refused.append(str(error))
    return refused, loss


def test_a_wedged_jack_keeps_its_energy_or_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    refused, loss = wedged()
    assert refused
    assert all("the jack is wedged between walls" in sentence and "s after t = " in sentence for sentence in refused)
    assert loss < 1e-5
    monkeypatch.setattr(PymunkSimulator, "_resolved", lambda *_: True)
    refused, loss = wedged()
    assert not refused
    assert loss > 1e-4
