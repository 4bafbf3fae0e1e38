"""Timing in interleaved rounds, and what more than one benchmark times."""

from __future__ import annotations

import math
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from tqdm import tqdm

Timed = Callable[[], float]  # runs once and returns operations per second


def repeat(
    block: Callable[[], int],
    seconds: float,
    prepare: Callable[[], None] | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> Timed:
    """Operations per second of ``block``, which returns how many it did, over ``seconds`` [s] or the block under way.

    What ``prepare`` does before each block is not timed.
    """

    def run() -> float:
        count, passed = 0, 0.0
        while passed <= seconds:
            if prepare is not None:
                prepare()
            began = clock()
            count += block()
            passed += clock() - began
        return count / passed

    return run


def measure(timed: dict[str, Timed], rounds: int, progress: bool = True) -> dict[str, list[float]]:
    """Run all in turn, ``rounds`` times after a warm-up."""
    rates: dict[str, list[float]] = {name: [] for name in timed}
    with tqdm(total=(rounds + 1) * len(timed), unit="measurement", disable=not progress, leave=False) as bar:
        for number in range(rounds + 1):
            for name, run in timed.items():
                rate = run()
                if number:
                    rates[name].append(rate)
                bar.update()
    return rates


def ratios(rates: dict[str, list[float]], one: str, other: str) -> list[float]:
    """One rate over another in each round."""
    return [a / b for a, b in zip(rates[one], rates[other], strict=True)]


def spread(values: list[float]) -> str:
    """Median with the extremes."""
    return f"{statistics.median(values):.2f} ({min(values):.2f} to {max(values):.2f})"


def ratio(rates: dict[str, list[float]], one: str, other: str) -> str:
    """Median over the rounds of one rate over another, with the extremes."""
    return spread(ratios(rates, one, other))


def others() -> tuple[float, float]:
    """Core-seconds that other processes have used since the machine started, and that there were; zeros if untold."""
    if not Path("/proc/stat").exists():
        return 0.0, 0.0
    ticks = [int(number) for number in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
    idle = ticks[3] + ticks[4]  # and waiting for disks
    ours = sum(os.times()[:4])
    return (sum(ticks) - idle) / os.sysconf("SC_CLK_TCK") - ours, sum(ticks) / os.sysconf("SC_CLK_TCK")


def steps_of(env_id: str, seconds: float, **settings: Any) -> Timed:
    """Steps per second of an environment under random actions drawn beforehand, resets included."""
    env = gym.make(env_id, **settings)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(4096)]
    env.reset(seed=0)

    def block() -> int:
        for action in actions[:256]:
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()
        actions.append(actions.pop(0))
        return 256

    return repeat(block, seconds)


def steps_of_bare_pymunk(seconds: float, substeps: int = 4) -> Timed:
    """Control steps per second of a plain pymunk loop: same shapes, torque and weight set in each substep."""
    import pymunk

    space = pymunk.Space()
    space.iterations, space.collision_bias = 64, 1.0
    box, jack = pymunk.Body(400.0, 14400.0), pymunk.Body(4.0, 4.0)
    shapes: list[pymunk.Shape] = []
    for quarter in range(4):
        normal = pymunk.Vec2d.from_polar(1.0, quarter * math.pi / 2.0)
        middle, end = normal * 106.0, normal.perpendicular() * 206.0
        shapes += [pymunk.Segment(box, middle - end, middle + end, 100.0), pymunk.Circle(jack, 0.0, normal)]
    for shape in shapes:
        shape.elasticity = 1.0
    space.add(box, jack, *shapes)
    torques = np.random.default_rng(0).uniform(-90000.0, 90000.0, 500).tolist()
    weight, h = (0.0, -4.0 * 9.81), 0.02 / substeps

    def block() -> int:
        box.position = jack.position = 0.0, 0.0
        box.velocity = jack.velocity = 0.0, 0.0
        box.angular_velocity = jack.angular_velocity = 0.0
        for torque in torques:
            for _ in range(substeps):
                box.torque = torque
                jack.force = weight
                space.step(h)
        return len(torques)

    return repeat(block, seconds)
