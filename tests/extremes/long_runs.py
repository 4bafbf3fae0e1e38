"""Runs of millions of steps: no jack escapes, nothing drifts, no memory grows.

``python -m tests.extremes`` takes all their steps (``JACKBOX_EXTREMES=full``), an ordinary test run some hundredth.
"""

from __future__ import annotations

import gc
import math
import sys
from pathlib import Path

import numpy as np

from jackbox_env.envs.vector import JackInBoxVectorEnv
from jackbox_env.mechanics import energy
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import clearance
from tests.extremes.measures import DEEPEST, angular_momentum, momentum, momentum_scale, started, steps
from tests.extremes.page import Bound, Finding, case, within
from tests.states import WEIGHTLESS, Array, inside

MORE_BLOCKS, MORE_BYTES = 2_000, 16 * 2**20  # of memory that are no growth, whatever the steps
MEMORY = f"; memory grows by less than {MORE_BLOCKS:,} Python objects and {MORE_BYTES // 2**20} MiB"


def outside(scene: Scene, states: Array) -> float:
    """How far a foot is outside [m] in any of the states, shape (N, 12)."""
    (x, y), cosine, sine = (states[:, 3:5] - states[:, 0:2]).T, np.cos(states[:, 2]), np.sin(states[:, 2])
    turned = states[:, 5] - states[:, 2]
    reach = scene.jack_arm * np.maximum(np.abs(np.cos(turned)), np.abs(np.sin(turned)))
    furthest = np.maximum(np.abs(cosine * x + sine * y), np.abs(cosine * y - sine * x))
    return float((furthest + reach).max()) - scene.box_half_width


def memory() -> tuple[int, int]:
    """This process's blocks of memory of Python, and its bytes in memory on Linux."""
    gc.collect()
    pages = Path("/proc/self/statm")
    return sys.getallocatedblocks(), 4096 * int(pages.read_text().split()[1]) if pages.exists() else 0


def grown(before: tuple[int, int]) -> bool:
    """Whether more memory is used than before."""
    return any(now - then >= more for now, then, more in zip(memory(), before, (MORE_BLOCKS, MORE_BYTES), strict=True))


@case("episodes of 500 steps under random torque")
def nothing_gets_out_and_no_memory_grows_over_many_episodes(contact: str) -> Finding:
    count = steps(8, 16) if contact == "pymunk" else steps(256, 4096)  # environments in a batch
    rng, deepest, ended, before = np.random.default_rng(0), 0.0, 0, (0, 0)
    env = JackInBoxVectorEnv(count, contact=contact, autoreset_mode="SAME_STEP")
    env.reset(seed=0)
    total = steps(4_000, 10_000_000) if contact == "pymunk" else steps(128_000, 100_000_000)
    rounds = math.ceil(total / count)
    for number in range(rounds):
        if number == rounds // 10:
            before = memory()
        truncations = env.step(rng.uniform(-1.0, 1.0, (count, 1)))[3]
        deepest = max(deepest, outside(env.scene, env.states))
        ended += int(truncations.sum())
    assert ended == count * (rounds // 500)
    assert not grown(before)
    finding = within(Bound("a foot outside", deepest, DEEPEST[contact], "m"), note=MEMORY)
    return finding._replace(seen=f"over {rounds * count:,} steps: {finding.seen}")


@case("one weightless episode")
def nothing_drifts_over_a_long_weightless_episode(contact: str) -> Finding:
    # Nothing acts from outside, so momentum, angular momentum and energy stay, and the common centre of mass, here at
    # 1 mm/s, keeps its line. Rates are rounded at each impact only, k times over: a random walk of sqrt(k impacts) eps.
    # Each model does so about k = 1000 times: pymunk in its 64 iterations, with some ten operations for each of its two
    # bodies. A bias would show: it grows with the impacts, and after 1e7 steps it would be 25 times as large.
    scene, state = WEIGHTLESS, inside(WEIGHTLESS, np.random.default_rng(14), speed=3.0)
    total, count = scene.box_mass + scene.jack_mass, steps(10_000, 10_000_000)
    drift = momentum(scene, state) / total - np.array([1e-3, 0.0])
    state[6:8] -= drift
    state[9:11] -= drift
    simulator = started(scene, contact, state)
    hits, deepest, before = 0, 0.0, (0, 0)
    for number in range(count):
        simulator.step(0.02, 0.0)
        hits += len(simulator.impacts)
        if number == count // 10:
            before = memory()
        if number % 1000 == 0:
            deepest = max(deepest, -clearance(scene, simulator.state.tolist()))
    assert not grown(before)
    end = simulator.state
    walk, rates_scale = 32.0 * math.sqrt(hits) * 2.0**-52, momentum_scale(scene, state)
    pushed = float(np.abs(momentum(scene, end) - momentum(scene, state)).max()) / rates_scale
    turning = abs(scene.box_inertia * state[8]) + abs(scene.jack_inertia * state[11])
    turned = abs(angular_momentum(scene, end) - angular_momentum(scene, state)) / turning
    gained = abs(energy(scene, end) / energy(scene, state) - 1.0)
    centres = [(scene.box_mass * q[0:2] + scene.jack_mass * q[3:5]) / total for q in (state, end)]
    line = centres[1] - centres[0] - momentum(scene, state) / total * simulator.time
    # The random walk of the momentum moves it so far, and each step rounds its path by half an ulp.
    rounded = 0.5 * count * math.ulp(float(np.abs(end[[0, 1, 3, 4]]).max()))
    strayed = walk * rates_scale / total * simulator.time + rounded
    assert hits > count // 50
    finding = within(
        Bound("momentum", pushed, walk),
        Bound("angular momentum", turned, walk),
        Bound("energy", gained, walk),
        Bound("centre of mass off its line", float(np.abs(line).max()), strayed, "m"),
        Bound("a foot outside", deepest, DEEPEST[contact], "m"),
        note=MEMORY,
    )
    return finding._replace(
        seen=f"over {count:,} steps, bounds of a random walk (32 sqrt(impacts) roundings): {finding.seen}"
    )
