"""Write docs/speed.md: how fast the exact contact model is, as ratios within one run."""

from __future__ import annotations

import importlib
import os
import statistics
import tempfile
import time
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from scripts.common import command_line

if TYPE_CHECKING:
    from scripts.studies.speed.exact_speed import Lost

BARE, KERNEL, UNGUARDED = "bare pymunk loop, 4 substeps", "the compiled loop alone", "the same, unguarded search"
BATCH, CHIRP = "JackInBox-v0, exact, batch", "JackInBox-v0, exact, batch, under the chirp"
PYMUNK = "JackInBox-v0, pymunk, batch of 16"
POLES = "CartPole-v1, Gymnasium's own batch"
POOL_POLES, POOL_PENDULUMS = "CartPole-v1, EnvPool", "Pendulum-v1, EnvPool"
ONE, ONE_POLE = "JackInBox-v0, exact, one", "CartPole-v1, one"
ROLLOUT = "rollout, 1024 states, 50 steps"
SB3, DUMMY = "make_sb3_vec_env, 16 exact", "DummyVecEnv, 16 of Monitor over gym.make, exact"
MISSING = "not installed (pip install -e '.[peers]')"
SIZES = (256, 1024, 4096, 16384, 65536, 262144, 1000000)
TOGETHER = 1024  # environments in a batch
MANY = 1_000_000  # environments of which memory is measured
NAMES = (
    BARE,
    KERNEL,
    UNGUARDED,
    BATCH,
    CHIRP,
    POLES,
    POOL_POLES,
    POOL_PENDULUMS,
    PYMUNK,
    ROLLOUT,
    SB3,
    DUMMY,
    ONE,
    ONE_POLE,
)
PINNED = hasattr(os, "sched_setaffinity")
MIXED = "Exact batches that start from a mixture of the moments of such episodes, so that a few steps tell."
STARTED = "First steps are counted from the start of their process, imports from within it."
STARTS = 3  # cold starts of each kind at most: each compiles everything

Rates = dict[str, list[float]]


@dataclass(frozen=True)
class Arguments:
    """Measure in interleaved rounds; every figure is the median over the rounds."""

    rounds: int = 5
    """Rounds; each measures everything once, so that a slow moment of the machine falls on all."""
    seconds: float = 0.4
    """Time per measurement [s]."""
    out: Path = Path("docs/speed.md")
    """The page to write."""


class Goal(NamedTuple):
    """A ratio of two rates that the page shows, and what it should be at least."""

    what: str
    one: str
    other: str
    least: float | None = None


ALONE = (
    Goal("the compiled loop over the bare pymunk loop", KERNEL, BARE, 200.0),
    Goal("what certifying costs: the unguarded search over the certified one", UNGUARDED, KERNEL),
    Goal("batch over the compiled loop", BATCH, KERNEL, 0.7),
    Goal("batch over Gymnasium's own CartPole-v1 batch", BATCH, POLES, 1.0),
    Goal("batch over EnvPool's CartPole-v1", BATCH, POOL_POLES, 5.0),
    Goal("batch over EnvPool's Pendulum-v1", BATCH, POOL_PENDULUMS, 5.0),
    Goal("batch under the chirp over the same under actions", CHIRP, BATCH),
    Goal("batch over the pymunk model's, per environment", BATCH, PYMUNK),
    Goal("one environment over CartPole-v1, resets included", ONE, ONE_POLE, 1.0),
    Goal("rollout over the compiled loop", ROLLOUT, KERNEL),
    Goal("make_sb3_vec_env over DummyVecEnv", SB3, DUMMY),
)


def on_cores(cores: Iterable[int]) -> None:
    """Keep all threads of this process, and those to come, on these cores."""
    for thread in os.listdir("/proc/self/task"):
        os.sched_setaffinity(int(thread), cores)


def of_size(count: int, threads: int = 1) -> str:
    """Name of a batch's measurement."""
    return f"{count:,} environments, {threads} thread{'s' if threads > 1 else ''}"


def of_rollout(threads: int) -> str:
    """Name of a rollout's measurement."""
    return f"rollout of 4,096 for 100 steps, {threads} thread{'s' if threads > 1 else ''}"


# -- what is measured -------------------------------------------------------------------------------------------------


def envpool_rates(seconds: float) -> dict[str, Any]:
    """EnvPool's environments, in the thread it needs, if it is installed."""
    from scripts.studies.speed.exact_speed import steps_of_batch

    try:
        envpool = importlib.import_module("envpool")
    except ImportError:
        return {}
    timed: dict[str, Any] = {}
    for name, env_id in ((POOL_POLES, "CartPole-v1"), (POOL_PENDULUMS, "Pendulum-v1")):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the precision of its spaces' bounds
            env = envpool.make(env_id, env_type="gymnasium", num_envs=TOGETHER, num_threads=1, seed=0)
            space = env.action_space
        env.reset()
        timed[name] = steps_of_batch(env.step, space, TOGETHER, seconds)
    return timed


def sb3_rates(seconds: float) -> dict[str, Any]:
    """Stable-Baselines3's interface, natively and over single environments."""
    import gymnasium as gym
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

    from jackbox_env.sb3 import make_sb3_vec_env
    from scripts.studies.speed.exact_speed import steps_of_batch

    made: dict[str, VecEnv] = {
        SB3: make_sb3_vec_env(16, contact="exact"),
        DUMMY: DummyVecEnv([lambda: Monitor(gym.make("JackInBox-v0", contact="exact"))] * 16),
    }
    for env in made.values():
        env.seed(0)
        env.reset()
    return {name: steps_of_batch(env.step, env.action_space, 16, seconds) for name, env in made.items()}


def one_core(rounds: int, seconds: float) -> tuple[Rates, Lost]:
    """Rates on one core, and what the unguarded search gets wrong."""
    from scripts.studies.speed import exact_speed as exact
    from scripts.studies.timing import measure, steps_of, steps_of_bare_pymunk

    certified, unguarded = exact.Kernel(), exact.Kernel(unguarded=True)
    wrong = exact.lost(certified, unguarded)
    settings: dict[str, Any] = {"contact": "exact", "num_threads": 1}
    timed = {
        BARE: steps_of_bare_pymunk(seconds),
        KERNEL: exact.steps_of_kernel(certified, seconds),
        UNGUARDED: exact.steps_of_kernel(unguarded, seconds),
        BATCH: exact.steps_of_make_vec("JackInBox-v0", TOGETHER, seconds, **settings),
        CHIRP: exact.steps_of_make_vec("JackInBox-v0", TOGETHER, seconds, torque="chirp", **settings),
        POLES: exact.steps_of_make_vec("CartPole-v1", TOGETHER, seconds),
        **envpool_rates(seconds),
        PYMUNK: exact.steps_of_make_vec("JackInBox-v0", 16, seconds, contact="pymunk"),
        ONE: steps_of("JackInBox-v0", seconds, contact="exact"),
        ONE_POLE: steps_of("CartPole-v1", seconds),
        ROLLOUT: exact.steps_of_rollout(certified, 1024, 50, 1, seconds),
        **sb3_rates(seconds),
        **{of_size(size): exact.steps_of_mixed(certified, size, 1, seconds) for size in SIZES},
    }
    return measure(timed, rounds), wrong


def two_cores(rounds: int, seconds: float) -> Rates:
    """Rates with one thread and with two, where there are two cores."""
    from scripts.studies.speed import exact_speed as exact
    from scripts.studies.timing import measure

    kernel, timed = exact.Kernel(), {}
    for threads in (1, 2):
        for size in (16384, 65536):
            timed[of_size(size, threads)] = exact.steps_of_mixed(kernel, size, threads, seconds)
        timed[of_rollout(threads)] = exact.steps_of_rollout(kernel, 4096, 100, threads, seconds)
    return measure(timed, rounds)


def start_up(rounds: int) -> dict[str, list[float]]:
    """Seconds from the start of a process to its first exact step, and of imports."""
    from scripts.studies.speed import fresh

    found: dict[str, list[float]] = {}
    for _ in range(min(rounds, STARTS)):
        for kind, name in (("one", "first step of one"), ("batch", "first step of a batch")):
            with tempfile.TemporaryDirectory() as cache:
                for filled in ("nothing compiled before", "compiled before"):
                    began = time.monotonic()
                    (done,) = fresh.run("first_step", kind, cache=cache)
                    found.setdefault(f"{name}, {filled}", []).append(done - began)
    for _ in range(rounds):
        for package in ("gymnasium", "jackbox_env"):
            found.setdefault(f"import {package}", []).extend(fresh.run("importing", package))
    return found


# -- the page ---------------------------------------------------------------------------------------------------------


def figure(value: float) -> str:
    """A number with three digits, or all before the point."""
    return f"{value:,.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def cells(values: Sequence[float]) -> str:
    """Median, smallest and largest, as two cells of a table."""
    return f"{figure(statistics.median(values))} | {figure(min(values))} to {figure(max(values))}"


def verdict(values: Sequence[float], least: float) -> str:
    """The goal, and whether the median meets it."""
    met = statistics.median(values) >= least
    return f"at least {least:g}: {'met' if met else 'missed'}"


def rate_table(rates: Rates, names: Iterable[str]) -> list[str]:
    """Rates with their extremes and the time of one."""
    lines = ["| what | steps per second | smallest to largest | ns per step |", "|---|---:|---:|---:|"]
    for name in names:
        if name in rates:
            lines.append(f"| {name} | {cells(rates[name])} | {figure(1e9 / statistics.median(rates[name]))} |")
        else:
            lines.append(f"| {name} | {MISSING} | | |")
    return lines


def ratio_table(rates: Rates, goals: Iterable[Goal]) -> list[str]:
    """Ratios with their extremes and goals."""
    from scripts.studies.timing import ratios

    lines = ["| ratio | median | smallest to largest | goal |", "|---|---:|---:|---|"]
    for goal in goals:
        if goal.one in rates and goal.other in rates:
            values = ratios(rates, goal.one, goal.other)
            aim = verdict(values, goal.least) if goal.least is not None else ""
            lines.append(f"| {goal.what} | {cells(values)} | {aim} |")
        else:
            lines.append(f"| {goal.what} | {MISSING} | | |")
    return lines


def meanwhile(before: tuple[float, float]) -> str:
    """How much of the machine others had since ``before``: what makes figures unsteady."""
    from scripts.studies.timing import others

    taken, there = others()
    share = (taken - before[0]) / max(there - before[1], 1e-9)
    return f"Other processes took {max(0.0, share):.0%} of the machine's time meanwhile." if there else ""


def size_table(rates: Rates) -> list[str]:
    """Cost of a step against the size of the batch."""
    medians = [1e9 / statistics.median(rates[of_size(size)]) for size in SIZES]
    lines = ["| environments | ns per step | smallest to largest |", "|---:|---:|---:|"]
    lines += [f"| {size:,} | {cells([1e9 / rate for rate in rates[of_size(size)]])} |" for size in SIZES]
    return [*lines, "", f"The dearest size costs {max(medians) / min(medians):.2f} times the cheapest."]


def start_table(found: dict[str, list[float]]) -> list[str]:
    """Seconds of start-up with their goals."""
    lines = ["| what | seconds | smallest to largest | goal |", "|---|---:|---:|---|"]
    for name, values in found.items():
        most = 1.0 if name.endswith(", compiled before") else 20.0 if "nothing" in name else None
        met = "met" if most and statistics.median(values) < most else "missed"
        lines.append(f"| {name} | {cells(values)} | {f'below {most:g}: {met}' if most else ''} |")
    return lines


def memory_lines() -> list[str]:
    """What an environment takes."""
    from scripts.studies.speed import fresh
    from scripts.studies.speed.exact_speed import bytes_held

    lines = [f"- {bytes_held():.0f} bytes per environment in the arrays that a batch of {TOGETHER:,} holds."]
    if Path("/proc/self/status").exists():
        rest, most = fresh.run("memory", MANY)
        lines.append(
            f"- A process that makes, resets and steps {MANY:,} of them grows by {rest:.0f} bytes for each, the "
            f"bounds of its spaces and its seeds among them, and by {most:.0f} at most on the way."
        )
    return lines


def guarantee_line(wrong: Lost) -> str:
    """What the guarantee is worth, beside its price in the table above."""
    from scripts.studies.speed.exact_speed import TRAJECTORIES

    return (
        f"What that buys: of {TRAJECTORIES:,} trajectories of 500 steps the unguarded search misses an impact in "
        f"{wrong.missed} while they are level with the certified ones (to 1e-6), in {wrong.at_first} of them in the "
        f"first step with an impact, and {wrong.escaped} have a foot outside the box (by more than 1e-6 m) at the end "
        "of a step. Of the certified ones none has."
    )


def head(arguments: Arguments) -> str:
    """What all figures have in common, and what they were measured with."""
    from agents.runs import PACKAGES, machine, versions

    known = versions((*(name for name in PACKAGES if name != "torch"), "numba", "envpool"))
    where = "Everything but the table of two threads ran on one core." if PINNED else "Nothing was kept on one core."
    return (
        f"Written by `make speed`: medians over {arguments.rounds} interleaved rounds after one to warm up, at least "
        f"{arguments.seconds:g} s per measurement; ratios are taken within a round. {where}\n\n"
        "A step is a control step of 0.02 s. Torques are random, drawn beforehand, another in each step. Episodes have "
        f"500 steps from the environment's own starts. A batch holds {TOGETHER:,} environments where nothing else is "
        "said.\n\n"
        f"{machine()}; " + ", ".join(f"{name} {version}" for name, version in known.items())
    )


def two_threads(rates: Rates) -> list[str]:
    """Two threads over one."""
    if not rates:
        return ["Not measured: this process may use one core only."]
    pairs = [(name, name.replace("2 threads", "1 thread")) for name in rates if name.endswith("2 threads")]
    goals = [Goal(f"{two.removesuffix(', 2 threads')}, two threads over one", two, one, 1.7) for two, one in pairs]
    return [MIXED, "", *rate_table(rates, rates), "", *ratio_table(rates, goals)]


def joined(parts: dict[str, list[str]]) -> str:
    """A page of titled parts."""
    return "\n".join("\n".join([title, "", *lines, ""]) for title, lines in parts.items())


@command_line
def main() -> None:
    """Parse, measure, write, print."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__)
    cores = os.sched_getaffinity(0) if PINNED else set()
    if PINNED:
        on_cores({max(cores)})
    from jackbox_env import _validation as check
    from scripts.studies.timing import others

    rounds = check.whole("rounds", arguments.rounds, at_least=1)
    seconds = check.real("seconds", arguments.seconds, above=0.0)
    if not arguments.out.parent.is_dir():
        raise FileNotFoundError(f"{arguments.out.parent} is no folder to write a page in")
    top, before = head(arguments), others()
    alone, wrong = one_core(rounds, seconds)
    started, memory = start_up(rounds), memory_lines()
    if PINNED:
        on_cores(cores)
    both = two_cores(rounds, seconds) if len(cores) != 1 else {}
    text = joined(
        {
            "# How fast the exact contact model is": [top, "", meanwhile(before)],
            "## Rates": rate_table(alone, NAMES),
            "## Ratios": [*ratio_table(alone, ALONE), "", guarantee_line(wrong)],
            "## Cost against the size of the batch": [MIXED, "", *size_table(alone)],
            "## Two threads": two_threads(both),
            "## Memory": memory,
            "## Start-up": [STARTED, "", *start_table(started)],
        }
    )
    arguments.out.write_text(text)
    print(text)


if __name__ == "__main__":
    main()
