"""Steps and frames per second of JackInBox-v0 beside its peers and the bare engine, as ratios within one run."""

from __future__ import annotations

import statistics
from dataclasses import dataclass

import gymnasium as gym
import numpy as np
from gymnasium.utils.performance import benchmark_render

from scripts.common import command_line
from scripts.studies.timing import Timed, measure, ratio, repeat, steps_of, steps_of_bare_pymunk


@dataclass(frozen=True)
class Arguments:
    """Measure in interleaved rounds; every figure is the median over the rounds."""

    rounds: int = 9
    """Rounds; each measures everything once, so that a slow moment of the machine falls on all."""
    seconds: float = 0.4
    """Time per measurement [s]."""


def steps_of_simulator(seconds: float) -> Timed:
    """Control steps per second of the pymunk contact model alone, from the environment's starts."""
    from jackbox_env import Scene, make_simulator
    from jackbox_env.tasks import sample_start

    rng = np.random.default_rng(0)
    scene = Scene()
    simulator = make_simulator(scene)
    torques = rng.uniform(-90000.0, 90000.0, 500).tolist()

    def block() -> int:
        simulator.reset(sample_start(scene, rng))
        for torque in torques:
            simulator.step(0.02, torque)
        return len(torques)

    return repeat(block, seconds)


def frames_of(env_id: str, seconds: float) -> Timed:
    """Frames per second of ``rgb_array``, by Gymnasium's own ``benchmark_render``, in the middle of an episode."""
    env = gym.make(env_id, render_mode="rgb_array")
    env.reset(seed=0)
    for _ in range(40):
        env.step(env.action_space.sample())
    return lambda: benchmark_render(env, target_duration=seconds)  # type: ignore[arg-type]


JACK, CHIRP, SIMULATOR, BARE = "JackInBox-v0", "JackInBox-v0, chirp", "PymunkSimulator alone", "bare pymunk loop"
LANDER, POLE = "LunarLander-v3", "CartPole-v1"


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
