"""Feet that start on a wall or behind it, through the environment and the simulators."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import numpy as np

from jackbox_env.env import JackInBoxEnv
from jackbox_env.mechanics import energy, gap_jacobian
from jackbox_env.scene import Scene
from jackbox_env.states import clearance
from tests.extremes.measures import off_the_law, relative, replayed, started
from tests.extremes.page import REFUSED, Bound, Finding, part, refuses, within
from tests.states import Array, one_foot_on_wall

WEIGHTLESS = Scene(gravity=0.0, drive=None)
starts = part("Feet that start on a wall or behind it")


def with_a_foot_on_a_wall() -> Iterator[tuple[Array, int, int]]:
    """A state without any rounding, and random ones; each approaches."""
    straight = np.zeros(12)
    straight[[3, 9]] = 5.0, 2.0
    yield straight, 0, 0
    rng = np.random.default_rng(7)
    for _ in range(40):
        yield one_foot_on_wall(WEIGHTLESS, rng)


def environment(contact: str, control_dt: float, scene: Scene = WEIGHTLESS) -> JackInBoxEnv:
    return JackInBoxEnv(contact=contact, scene=scene, control_dt=control_dt)


@starts("a foot exactly on the wall at reset: approaching")
def a_foot_on_the_wall_that_approaches_bounces_at_once(contact: str) -> Finding:
    env, law, late = environment(contact, 1e-4), 0.0, 0.0
    for state, wall, foot in with_a_foot_on_a_wall():
        env.reset(options={"state": state})
        env.step(0.0)
        assert (wall, foot) in [hit[1:3] for hit in env.impacts]
        late = max(late, min(hit.time for hit in env.impacts))
        law = max(law, relative(env.state, replayed(WEIGHTLESS, state, 0.0, env.time, env.impacts)))
    substep = 2.5e-5 if contact == "pymunk" else 0.0
    return within(Bound("rates off the law", law, 1e-12), Bound("its moment after the reset", late, substep, "s"))


@starts("a foot exactly on the wall at reset: leaving")
def a_foot_on_the_wall_that_leaves_is_let_go(contact: str) -> Finding:
    env, error = environment(contact, 1e-5), 0.0
    for state, _, _ in with_a_foot_on_a_wall():
        state[6:] *= -1.0
        env.reset(options={"state": state})
        env.step(0.0)
        assert env.impacts == []
        state[:6] += 1e-5 * state[6:]
        error = max(error, float(np.abs(env.state - state).max()))
    return within(Bound("off free flight", error, 1e-14, "m, rad, m/s or rad/s"), note="; no impact")


@starts("a foot exactly on the wall at reset: at rest without gravity")
def a_foot_on_the_wall_at_rest_stays(contact: str) -> Finding:
    state = np.zeros(12)
    state[3] = 5.0
    env = environment(contact, 0.02)
    env.reset(options={"state": state})
    for _ in range(50):
        env.step(0.0)
        assert env.impacts == []
    return within(Bound("moved in 1 s", float(np.abs(env.state - state).max()), 0.0, "m"), note="; no impact")


@starts("two feet exactly on the floor at reset: at rest under gravity, 1 s")
def a_jack_at_rest_on_the_floor_stays_there(contact: str) -> Finding:
    scene = Scene(drive=None)
    state = np.zeros(12)
    state[4], state[5] = -(6.0 - math.sqrt(0.5)), math.pi / 4.0
    env = environment(contact, 0.02, scene)
    env.reset(options={"state": state})
    off, impulse = 0.0, 0.0
    for _ in range(50):
        _, _, _, _, info = env.step(0.0)
        impulse += info["impulse"]
        off = max(off, abs(clearance(scene, env.state.tolist())))
    # The floor carries the jack. The box gives way, so the impulse is m_r g t with the reduced mass m_r.
    carried = abs(impulse / (4.0 * 400.0 / 404.0 * 9.81) - 1.0)
    gained = abs(energy(scene, env.state) - energy(scene, state))
    return within(
        Bound("feet off the floor", off, 1e-8, "m"),
        Bound("the floor's impulse off the weight it carries", carried, 1e-4),
        Bound("energy", gained, 1e-9, "J"),
    )


@starts("a start with a foot outside")
def a_start_outside_is_refused(contact: str) -> Finding:
    env = environment(contact, 0.02)
    env.reset(seed=0)
    before = env.state
    for outside, taken in ((0.9e-9, True), (1e9, False), (1.0, False), (1e-3, False), (1.1e-9, False)):
        state = np.zeros(12)
        state[3] = 5.0 + outside
        finding = refuses(partial(env.reset, options={"state": state}), "a start must have every foot inside")
        assert (finding.verdict != REFUSED) == taken
        assert np.array_equal(env.state, state if taken else before)
        if taken:
            env.reset(options={"state": before})
    return finding._replace(seen=f"taken up to 1e-9 m outside, beyond it: {finding.seen}")


@starts("a state with a foot up to 1 m outside, put back")
def a_state_outside_is_put_back_up_to_1_m(contact: str) -> Finding:
    law, rng = 0.0, np.random.default_rng(8)
    for depth in (1e-12, 1e-9, 1e-3, 0.3, 0.99):
        for _ in range(10):
            state, wall, foot = one_foot_on_wall(WEIGHTLESS, rng)
            normal = gap_jacobian(WEIGHTLESS, state, wall, foot)[:2]
            state[3:5] += depth * normal
            state[9:11] += 30.0 * normal  # so that whichever foot is outside approaches
            simulator = started(WEIGHTLESS, contact, state)
            law = max(law, off_the_law(simulator, 1e-9))
            assert simulator.impacts
            state[6:] *= -1.0
            simulator.reset(state)
            simulator.step(1e-9)
            assert simulator.impacts == []
    state[3:5] += 0.02 * normal
    simulator = started(WEIGHTLESS, contact, np.zeros(12))
    assert refuses(lambda: simulator.reset(state), "state must have every foot at most 1 m outside").verdict == REFUSED
    return within(Bound("rates off the law after it bounced at once", law, 1e-12), note="; free if it leaves")
