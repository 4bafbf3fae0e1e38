"""Steps and frames per second of JackInBox-v0 beside its peers and the bare engine, as ratios within one run."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils.performance import benchmark_render
from tqdm import tqdm

from scripts.common import command_line

Timed = Callable[[], float]  # runs once and returns operations per second


@dataclass(frozen=True)
class Arguments:
    """Measure in interleaved rounds; every figure is the median over the rounds."""

    rounds: int = 9
    """Rounds; each measures everything once, so that a slow moment of the machine falls on all."""
    seconds: float = 0.4
    """Time per measurement [s]."""


def steps_of(env_id: str, seconds: float, **settings: Any) -> Timed:
    """Steps per second of an environment under random actions drawn beforehand, resets included."""
    env = gym.make(env_id, **settings)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(4096)]
    env.reset(seed=0)

    def run() -> float:
        count = 0
        began = time.perf_counter()
        while True:
            for action in actions[:256]:
                _, _, terminated, truncated, _ = env.step(action)
                if terminated or truncated:
                    env.reset()
            count += 256
            actions.append(actions.pop(0))
            passed = time.perf_counter() - began
            if passed > seconds:
                return count / passed

    return run


def steps_of_simulator(seconds: float) -> Timed:
    """Control steps per second of the pymunk contact model alone, from the environment's starts."""
    from jackbox_env import Scene, make_simulator
    from jackbox_env.tasks import sample_start

    rng = np.random.default_rng(0)
    scene = Scene()
    simulator = make_simulator(scene)
    torques = rng.uniform(-90000.0, 90000.0, 500).tolist()

    def run() -> float:
        count = 0
        began = time.perf_counter()
        while True:
            simulator.reset(sample_start(scene, rng))
            for torque in torques:
                simulator.step(0.02, torque)
            count += len(torques)
            passed = time.perf_counter() - began
            if passed > seconds:
                return count / passed

    return run


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

    def run() -> float:
        count = 0
        began = time.perf_counter()
        while True:
            box.position = jack.position = 0.0, 0.0
            box.velocity = jack.velocity = 0.0, 0.0
            box.angular_velocity = jack.angular_velocity = 0.0
            for torque in torques:
                for _ in range(substeps):
                    box.torque = torque
                    jack.force = weight
                    space.step(h)
            count += len(torques)
            passed = time.perf_counter() - began
            if passed > seconds:
                return count / passed

    return run


def frames_of(env_id: str, seconds: float) -> Timed:
    """Frames per second of ``rgb_array``, by Gymnasium's own ``benchmark_render``, in the middle of an episode."""
    env = gym.make(env_id, render_mode="rgb_array")
    env.reset(seed=0)
    for _ in range(40):
        env.step(env.action_space.sample())
    return lambda: benchmark_render(env, target_duration=seconds)  # type: ignore[arg-type]


JACK, CHIRP, SIMULATOR, BARE = "JackInBox-v0", "JackInBox-v0, chirp", "PymunkSimulator alone", "bare pymunk loop"
LANDER, POLE = "LunarLander-v3", "CartPole-v1"


def measure(timed: dict[str, Timed], rounds: int) -> dict[str, list[float]]:
    """Run all in turn, ``rounds`` times after a warm-up."""
    rates: dict[str, list[float]] = {name: [] for name in timed}
    for number in tqdm(range(rounds + 1), unit="round", leave=False):
        for name, run in timed.items():
            rate = run()
            if number:
                rates[name].append(rate)
    return rates


def ratio(rates: dict[str, list[float]], one: str, other: str) -> str:
    """Median over the rounds of one rate over another, with the extremes."""
    values = [a / b for a, b in zip(rates[one], rates[other], strict=True)]
    return f"{statistics.median(values):.2f} ({min(values):.2f} to {max(values):.2f})"


def report(steps: dict[str, list[float]], frames: dict[str, list[float]], rounds: int) -> str:
    """The table and the ratios that the project watches."""
    from agents.runs import machine, versions

    lines = ["| what | per second | microseconds |", "|------|-----------:|-------------:|"]
    for rates, unit in ((steps, "steps"), (frames, "frames")):
        for name, values in rates.items():
            rate = statistics.median(values)
            lines.append(f"| {name}, {unit} | {rate:,.0f} | {1e6 / rate:.1f} |")
    around = [
        (1.0 / env - 1.0 / simulator) * bare
        for env, simulator, bare in zip(steps[JACK], steps[SIMULATOR], steps[BARE], strict=True)
    ]
    lines += [
        "",
        f"Ratios, medians over interleaved rounds, {rounds} in all (smallest to largest):",
        "",
        f"- steps, {JACK} over {LANDER}: {ratio(steps, JACK, LANDER)}; under the chirp {ratio(steps, CHIRP, LANDER)}",
        f"- steps, {JACK} over {POLE}: {ratio(steps, JACK, POLE)}",
        f"- steps, {JACK} over the bare pymunk loop: {ratio(steps, JACK, BARE)}",
        f"- the environment around the simulator takes this many bare pymunk loops: {statistics.median(around):.2f}",
        f"- frames, {JACK} over {LANDER}: {ratio(frames, JACK, LANDER)}",
        "",
        f"{machine()}; " + ", ".join(f"{name} {version}" for name, version in versions().items()),
    ]
    return "\n".join(lines)


@command_line
def main() -> None:
    """Parse, measure, print."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__)
    import jackbox_env  # noqa: F401
    from jackbox_env import _validation as check

    check.whole("rounds", arguments.rounds, at_least=1)
    check.real("seconds", arguments.seconds, above=0.0)
    steps = {
        JACK: steps_of("JackInBox-v0", arguments.seconds),
        CHIRP: steps_of("JackInBox-v0", arguments.seconds, torque="chirp"),
        LANDER: steps_of("LunarLander-v3", arguments.seconds),
        POLE: steps_of("CartPole-v1", arguments.seconds),
        SIMULATOR: steps_of_simulator(arguments.seconds),
        BARE: steps_of_bare_pymunk(arguments.seconds),
    }
    frames = {name: frames_of(name, arguments.seconds) for name in (JACK, LANDER)}
    print(report(measure(steps, arguments.rounds), measure(frames, arguments.rounds), arguments.rounds))


if __name__ == "__main__":
    main()
