"""Runs of millions of steps: nothing gets out, nothing drifts, no memory grows.

``python -m tests.extremes`` takes all their steps (``JACKBOX_EXTREMES=full``), an ordinary test run some hundredth.
"""

from __future__ import annotations

import gc
import math
import sys
from pathlib import Path

import numpy as np

from jackbox_env.compiled.compiler import compiled
from jackbox_env.mechanics import energy
from jackbox_env.scene import Scene
from jackbox_env.states import clearance
from jackbox_env.vector_env import JackInBoxVectorEnv
from tests.extremes.measures import (
    angular_momentum,
    deepest_allowed,
    least_clearance,
    momentum,
    momentum_scale,
    started,
)
from tests.extremes.page import FULL, Bound, Finding, part, within
from tests.states import inside

WEIGHTLESS = Scene(gravity=0.0, drive=None)
EPISODE_STEPS = {"pymunk": 10_000_000, "exact": 100_000_000} if FULL else {"pymunk": 100_000, "exact": 5_000_000}
ALONE_STEPS = 10_000_000 if FULL else 100_000
TOGETHER = {"pymunk": 16, "exact": 4096}  # environments in a batch
EPS = 2.0**-52
MORE_BLOCKS, MORE_BYTES = 2_000, 16 * 2**20  # of memory that are no growth, whatever the steps
MEMORY = f"; memory grows by less than {MORE_BLOCKS:,} Python objects and {MORE_BYTES // 2**20} MiB"
millions = part("Millions of steps")


class Memory:
    """What this process holds, from a moment on at which everything needed has been made."""

    def __init__(self) -> None:
        self.blocks, self.bytes = self.held()

    @staticmethod
    def held() -> tuple[int, int]:
        """Python's memory blocks, and bytes in memory where the system tells."""
        gc.collect()
        status = Path("/proc/self/status")
        lines = status.read_text().splitlines() if status.exists() else []
        resident = [1024 * int(line.split()[1]) for line in lines if line.startswith("VmRSS")]
        return sys.getallocatedblocks(), sum(resident)

    def check(self) -> None:
        blocks, held = self.held()
        assert blocks - self.blocks < MORE_BLOCKS
        assert held - self.bytes < MORE_BYTES


@millions("episodes of 500 steps under random torque", timeout=3600.0)
def nothing_gets_out_and_no_memory_grows_over_many_episodes(contact: str) -> Finding:
    count = TOGETHER[contact]
    env = JackInBoxVectorEnv(count, contact=contact, autoreset_mode="SAME_STEP")
    numbers, rng, look = np.array(env.scene.numbers), np.random.default_rng(0), compiled(least_clearance)
    env.reset(seed=0)
    rounds, deepest, ended, memory = math.ceil(EPISODE_STEPS[contact] / count), 0.0, 0, None
    for number in range(rounds):
        if number == rounds // 10:
            memory = Memory()
        _, _, _, truncations, _ = env.step(rng.uniform(-1.0, 1.0, (count, 1)))
        deepest = max(deepest, -look(numbers, env.states))
        ended += int(truncations.sum())
    assert ended == count * (rounds // 500)
    assert memory is not None
    memory.check()
    env.close()
    steps = rounds * count
    found = within(Bound("a foot outside", deepest, deepest_allowed(contact), "m"), note=MEMORY)
    return found._replace(seen=f"over {steps:,} steps: {found.seen}")


@millions("one weightless episode", timeout=3600.0)
def nothing_drifts_over_a_long_weightless_episode(contact: str) -> Finding:
    # Nothing acts from outside, so momentum, angular momentum and energy stay, and the common centre of mass, here at
    # 1 mm/s, keeps its line. Rates are rounded at each impact only, k times over: a random walk of sqrt(k impacts) eps.
    # Each model does so about k = 1000 times: pymunk in its 64 iterations, with some ten operations for each of its two
    # bodies. A bias would show: it grows with the impacts, and after 1e7 steps it would be 25 times as large.
    scene, state = WEIGHTLESS, inside(WEIGHTLESS, np.random.default_rng(14), speed=3.0)
    total = scene.box_mass + scene.jack_mass
    drift = momentum(scene, state) / total - np.array([1e-3, 0.0])
    state[6:8] -= drift
    state[9:11] -= drift
    simulator = started(scene, contact, state)
    rates_scale, hits, deepest = momentum_scale(scene, state), 0, 0.0
    step, memory = simulator.step, None
    for number in range(ALONE_STEPS):
        step(0.02, 0.0)
        hits += len(simulator.impacts)
        if number % 1000 == 0:
            deepest = max(deepest, -clearance(scene, simulator.state.tolist()))
            memory = memory or (Memory() if number >= ALONE_STEPS // 10 else None)
    assert memory is not None
    memory.check()
    end = simulator.state
    walk = 32.0 * math.sqrt(hits) * EPS
    pushed = float(np.abs(momentum(scene, end) - momentum(scene, state)).max()) / rates_scale
    turning = abs(scene.box_inertia * state[8]) + abs(scene.jack_inertia * state[11])
    turned = abs(angular_momentum(scene, end) - angular_momentum(scene, state)) / turning
    gained = abs(energy(scene, end) / energy(scene, state) - 1.0)
    centres = [(scene.box_mass * q[0:2] + scene.jack_mass * q[3:5]) / total for q in (state, end)]
    line = centres[1] - centres[0] - momentum(scene, state) / total * simulator.time
    # What the walk of the momentum moves it by, and half a unit in the last place of its way per step.
    strayed = walk * rates_scale / total * simulator.time + 0.5 * ALONE_STEPS * math.ulp(
        float(np.abs(end[[0, 1, 3, 4]]).max())
    )
    assert hits > ALONE_STEPS // 50
    found = within(
        Bound("momentum", pushed, walk),
        Bound("angular momentum", turned, walk),
        Bound("energy", gained, walk),
        Bound("centre of mass off its line", float(np.abs(line).max()), strayed, "m"),
        Bound("a foot outside", deepest, deepest_allowed(contact), "m"),
        note=MEMORY,
    )
    return found._replace(
        seen=f"over {ALONE_STEPS:,} steps, bounds of a random walk (32 sqrt(impacts) roundings): {found.seen}"
    )
