"""The steps that ``speed.py`` times: single environments, batches and rollouts, and others that do the same.

Actions are random and drawn beforehand. Episodes have 500 steps from the environment's own starts; a batch too large
for whole episodes starts from states at random moments of them.
"""

from __future__ import annotations

import importlib
import itertools
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar
from unittest.mock import patch

import gymnasium as gym
import numpy as np
import pymunk
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from jackbox_env import Scene, Task, linearize
from jackbox_env.exact.flight import Flight, gap_at, view_at
from jackbox_env.exact.geometry import View, foot_gap, outside, towards
from jackbox_env.exact.search import IMPACT, NO_IMPACT, Event, Limits
from jackbox_env.exact.workspace import Workspace
from jackbox_env.jit.compiler import compiled, compiled_with
from jackbox_env.model.scene import SceneNumbers
from jackbox_env.model.tasks import sample_start
from jackbox_env.planning import rollouts
from scripts.studies.timing import Timed, repeat

BARE = "bare pymunk loop, 4 substeps"
PYMUNK, CHIRP, EXACT = "JackInBox-v0", "JackInBox-v0, chirp", "JackInBox-v0, exact"
LANDER, POLE = "LunarLander-v3", "CartPole-v1"
FRAMES, LANDER_FRAMES = "JackInBox-v0, frames", "LunarLander-v3, frames"

ROLLOUT, UNGUARDED = "`rollout`: physics alone", "the same, unguarded search"
MATRICES, PULLED = "`linearize`, all A and B read", "`linearize` and `vjp`, without A"
BATCH, BATCH_CHIRP = "JackInBox-v0, exact, 1,024", "the same under the chirp"
BATCH_SCENES, BATCH_DRAWN = "the same, a scene for each", "the same, jacks drawn at each reset"
BATCH_TASK = "the same, a task of one's own"
POLES, POOL = "CartPole-v1, 1,024, Gymnasium's own", "CartPole-v1, 1,024, EnvPool"
FEW = "JackInBox-v0, pymunk, 16"
SB3, DUMMY = "`make_sb3_vec_env`, exact, 16", "`DummyVecEnv`, exact, 16"
PICTURES, BY_PYGAME = "the same, pictures of 84 x 84", "frames of 84 x 84 of one environment by pygame"
BATCH_256, SB3_256 = "JackInBox-v0, exact, 256", "`make_sb3_vec_env`, exact, 256"
TOGETHER = 1024  # environments in a batch

LONG = "`rollout` of 4,096 states, 100 steps"
SIZES = (256, 4096, 16384, 65536, 262144)
THREADED = (4096, 16384, 65536)  # the sizes that two threads are tried on

Array = NDArray[np.float64]
T = TypeVar("T")

DT = 0.02  # [s]
EPISODE = 500  # steps
SHORT = 50  # steps of a large batch or a rollout from random moments
_MOST_ITERATIONS = 50  # of Newton's method
_OFFSETS = 65536  # into the actions drawn beforehand, where a step's actions may start
_WRONG = 1e-6  # least difference, or depth outside the box [m], that is no rounding


def of_size(count: int) -> str:
    """Name of a batch's measurement."""
    return f"{count:,} environments"


def by_two(name: str) -> str:
    """Name of the same measurement with two threads."""
    return f"{name}, two threads"


# -- one environment ---------------------------------------------------------------------------------------------------


def one(env_id: str, seconds: float, **settings: Any) -> Timed:
    """Steps per second of an environment, resets included."""
    env = gym.make(env_id, **settings)
    env.action_space.seed(0)
    actions = itertools.cycle([env.action_space.sample() for _ in range(4096)])
    env.reset(seed=0)

    def block() -> int:
        for action in itertools.islice(actions, 256):
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()
        return 256

    return repeat(block, seconds, clock=time.process_time)


def frames(env_id: str, seconds: float, **settings: Any) -> Timed:
    """Frames per second of ``rgb_array`` in the middle of an episode."""
    env = gym.make(env_id, render_mode="rgb_array", **settings)
    env.reset(seed=0)
    for _ in range(40):
        env.step(env.action_space.sample())
    return repeat(lambda: len([env.render() for _ in range(10)]), seconds, clock=time.process_time)


def bare_pymunk(seconds: float, substeps: int = 4) -> Timed:
    """Control steps per second of a plain pymunk loop: same shapes, torque and weight set in each substep."""
    space = pymunk.Space()
    space.iterations, space.collision_bias = 64, 1.0
    box, jack = pymunk.Body(400.0, 14400.0), pymunk.Body(4.0, 4.0)
    space.add(box, jack)
    for quarter in range(4):
        normal = pymunk.Vec2d.from_polar(1.0, quarter * math.pi / 2.0)
        middle, end = normal * 106.0, normal.perpendicular() * 206.0
        for shape in (pymunk.Segment(box, middle - end, middle + end, 100.0), pymunk.Circle(jack, 0.0, normal)):
            shape.elasticity = 1.0
            space.add(shape)
    torques = np.random.default_rng(0).uniform(-90000.0, 90000.0, EPISODE).tolist()

    def block() -> int:
        box.position = jack.position = box.velocity = jack.velocity = 0.0, 0.0
        box.angular_velocity = jack.angular_velocity = 0.0
        for torque in torques:
            for _ in range(substeps):
                box.torque, jack.force = torque, (0.0, -4.0 * 9.81)
                space.step(DT / substeps)
        return EPISODE

    return repeat(block, seconds, clock=time.process_time)


def alone(seconds: float) -> dict[str, Timed]:
    """Single environments and their peers."""
    return {
        PYMUNK: one("JackInBox-v0", seconds),
        CHIRP: one("JackInBox-v0", seconds, torque="chirp"),
        EXACT: one("JackInBox-v0", seconds, contact="exact"),
        LANDER: one("LunarLander-v3", seconds),
        POLE: one("CartPole-v1", seconds),
        BARE: bare_pymunk(seconds),
        FRAMES: frames("JackInBox-v0", seconds),
        LANDER_FRAMES: frames("LunarLander-v3", seconds),
    }


# -- batches -----------------------------------------------------------------------------------------------------------


def vector_env(env_id: str, count: int, **settings: Any) -> Any:
    """An environment's own vector environment, seeded."""
    env = gym.make_vec(env_id, count, vectorization_mode="vector_entry_point", **settings)
    env.reset(seed=0)
    return env


def jacks(count: int) -> list[Scene]:
    """Scenes that differ in the jack's mass."""
    return [Scene(jack_mass=2.0 + 4.0 * number / count) for number in range(count)]


def lift(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float]:
    """A task of one's own: the jack's height in the box, over L."""
    return ((state.y_jack - state.y_box) / scene.box_half_width,)


def envpool() -> dict[str, Any]:
    """EnvPool's CartPole-v1 in the one thread that it needs, where EnvPool is installed."""
    try:
        package = importlib.import_module("envpool")
    except ImportError:
        return {}
    return {POOL: package.make("CartPole-v1", env_type="gymnasium", num_envs=TOGETHER, num_threads=1, seed=0)}


def many(
    env: Any, seconds: float, steps: int = EPISODE, prepare: Callable[[], None] | None = None,
    clock: Callable[[], float] = time.process_time,
) -> Timed:  # fmt: skip
    """Environment steps per second of a batch, restarts included, in blocks of ``steps``.

    Each step uses another part of one long array of actions. A few actions in turn would spin a box up by their mean.
    """
    count = getattr(env, "num_envs", TOGETHER)  # EnvPool's lacks it
    env.reset()
    actions = batch_space(getattr(env, "single_action_space", env.action_space), count + _OFFSETS)
    actions.seed(0)
    pool = actions.sample()
    order = itertools.cycle(np.random.default_rng(0).integers(_OFFSETS, size=4099).tolist())

    def block() -> int:
        for first in itertools.islice(order, steps):
            env.step(pool[first : first + count])
        return steps * count

    return repeat(block, seconds, prepare, clock)


def together(seconds: float) -> dict[str, Timed]:
    """Batches and rollouts on one core, and their peers."""
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv

    from jackbox_env.sb3 import make_sb3_vec_env

    exact: dict[str, Any] = {"contact": "exact", "num_threads": 1}
    batches: dict[str, Any] = {
        BATCH: vector_env("JackInBox-v0", TOGETHER, **exact),
        BATCH_CHIRP: vector_env("JackInBox-v0", TOGETHER, torque="chirp", **exact),
        BATCH_SCENES: vector_env("JackInBox-v0", TOGETHER, scene=jacks(TOGETHER), **exact),
        BATCH_DRAWN: vector_env("JackInBox-v0", TOGETHER, randomize={"jack_mass": (2.0, 6.0)}, **exact),
        BATCH_TASK: vector_env("JackInBox-v0", TOGETHER, task=Task(("lift",), lift), **exact),
        PICTURES: vector_env("JackInBox-v0", TOGETHER, observation="pixels", **exact),
        BATCH_256: vector_env("JackInBox-v0", 256, **exact),
        SB3_256: make_sb3_vec_env(256, contact="exact"),
        POLES: vector_env("CartPole-v1", TOGETHER),
        **envpool(),
        FEW: vector_env("JackInBox-v0", 16, contact="pymunk"),
        SB3: make_sb3_vec_env(16, contact="exact"),
        DUMMY: DummyVecEnv([lambda: Monitor(gym.make("JackInBox-v0", contact="exact"))] * 16),
    }
    for name in (SB3, SB3_256, DUMMY):
        batches[name].seed(0)
    physics = rolled(TOGETHER, SHORT, seconds)
    return {
        BARE: bare_pymunk(seconds),
        ROLLOUT: physics,
        UNGUARDED: unguarded(physics),
        MATRICES: rolled(TOGETHER, SHORT, seconds, run=matrices),
        PULLED: rolled(TOGETHER, SHORT, seconds, run=pulled),
        **{name: many(env, seconds, 5 if name == PICTURES else EPISODE) for name, env in batches.items()},
        BY_PYGAME: frames("JackInBox-v0", seconds, render_size=(84, 84)),
    }


def threads(cores: int, seconds: float) -> dict[str, Timed]:
    """Batches of any size and a rollout, timed by the wall clock: two threads should need half the time."""

    def of(size: int, threads: int) -> Timed:
        settings: dict[str, Any] = {"contact": "exact", "num_threads": threads, "episode_steps": None}
        env, states = vector_env("JackInBox-v0", size, **settings), moments(size)
        steps = max(5, min(SHORT, 2**22 // size))
        return many(env, seconds, steps, lambda: env.unwrapped.set_states(states, 0.0), time.perf_counter)

    timed = {of_size(size): of(size, 1) for size in SIZES}
    timed[LONG] = rolled(4096, 100, seconds, 1, time.perf_counter)
    if cores > 1:
        timed |= {by_two(of_size(size)): of(size, 2) for size in THREADED}
        timed[by_two(LONG)] = rolled(4096, 100, seconds, 2, time.perf_counter)
    return timed


# -- the exact model alone ---------------------------------------------------------------------------------------------


def play(count: int = 1024, of: Scene | None = None) -> tuple[Array, NDArray[np.int64], Array]:
    """Trajectories of whole episodes, shape (count, EPISODE + 1, 12), impacts in each step, and random torques."""
    scene, rng = of or Scene(), np.random.default_rng(0)
    starts = np.array([sample_start(scene, rng) for _ in range(count)])
    torques = rng.uniform(-scene.torque_limit, scene.torque_limit, (count, EPISODE))
    played: Any = rollouts.rollout(scene, starts, torques, DT, impacts=True, num_threads=1)
    return played.trajectories, played.impacts, torques


def moments(count: int) -> Array:
    """States at random moments of episodes, shape (count, 12), at least ``SHORT`` steps before the end."""
    rng, (trajectories, *_) = np.random.default_rng(0), play()
    states: Array = trajectories[rng.integers(1024, size=count), rng.integers(EPISODE - SHORT + 1, size=count)]
    return states


def matrices(*arguments: Any, **settings: Any) -> object:
    """``jackbox_env.linearize`` with the derivatives of all steps."""
    return linearize(*arguments, **settings).A


def pulled(*arguments: Any, **settings: Any) -> object:
    """``jackbox_env.linearize`` with the gradient of a sum of all states."""
    lin = linearize(*arguments, **settings)
    return lin.vjp(np.ones_like(lin.trajectories))


def rolled(
    count: int, steps: int, seconds: float, threads: int = 1, clock: Callable[[], float] = time.process_time,
    run: Callable[..., object] = rollouts.rollout,
) -> Timed:  # fmt: skip
    """Control steps per second of ``jackbox_env.rollout``, or of another ``run``, from moments of episodes."""
    scene, states = Scene(), moments(count)
    torques = np.random.default_rng(0).uniform(-scene.torque_limit, scene.torque_limit, (count, steps))

    def block() -> int:
        run(scene, states, torques, DT, num_threads=threads)
        return torques.size

    return repeat(block, seconds, clock=clock)


def first_of_all(
    scene: SceneNumbers, memory: Workspace, flight: Flight, view: View, walls: int, likely: Event,
    limits: Limits, resolution: float,
) -> Event:  # fmt: skip
    """Unguarded search for impacts: gaps at the step's end, then Newton's method. It misses what happens in between.

    It replaces the certified search of ``jackbox_env.exact.search`` and returns values like it: the earliest root of
    the gaps that are closed at the end. The difference is the price of the guarantee.
    """
    first = Event(NO_IMPACT, limits.end, 0, 0)
    at_end, cosine, sine, spin, _ = view_at(flight, memory, limits.end)
    for wall in range(4):
        if not walls & (1 << wall):
            continue
        ahead, speed = towards(at_end, wall)
        for foot in range(4):
            gap, rate = foot_gap(scene, ahead, speed, cosine, sine, spin, foot - wall)
            if gap > 0.0 or rate >= 0.0:
                continue
            s = limits.end
            for _ in range(_MOST_ITERATIONS):
                s = min(max(s - gap / rate, 0.0), limits.end)
                gap, rate = gap_at(scene, flight, memory, wall, foot, s)
                if abs(gap) <= limits.half_tolerance or rate == 0.0:
                    break
            if s <= first.time and rate < 0.0:
                first = Event(IMPACT, s, wall, foot)
    return first


def unguarded(run: Callable[[], T]) -> Callable[[], T]:
    """``run`` with rollouts that detect impacts at a step's end only, in place of the certified search."""

    def wrapped() -> T:
        with patch.object(rollouts, "compiled", partial(compiled_with, first_of_all=first_of_all)):
            return run()

    return wrapped


def lost() -> dict[str, int]:
    """How many of the same episodes each search gets wrong. They are compared until chaos separates them."""
    (certified, hits, _), (other, other_hits, _) = play(), unguarded(play)()
    difference = np.abs(certified - other).max(axis=2)[:, :-1]  # before each step
    same = np.logical_and.accumulate(difference <= _WRONG, axis=1)
    first_outside, numbers, wrong = compiled(outside), np.array([Scene().numbers]), np.array([_WRONG])

    def escaped(trajectories: Array) -> int:
        return sum(int(first_outside(numbers, states, wrong)) >= 0 for states in trajectories)

    missed = int((same & (other_hits < hits)).any(axis=1).sum())
    return {"of": len(hits), "missed": missed, "escaped": escaped(other), "certified": escaped(certified)}


# -- processes of their own --------------------------------------------------------------------------------------------

_START = """
import resource, gymnasium as gym, numpy as np, jackbox_env
def stepped(make, *arguments, **settings):
    env = make('JackInBox-v0', *arguments, contact='exact', **settings)
    env.reset(seed=0)
    for _ in range(2):
        env.step(np.zeros(env.action_space.shape, np.float32))
    return env
def used():
    return resource.getrusage(resource.RUSAGE_SELF)
"""
_SECONDS = "stepped(gym.make); print(used().ru_utime + used().ru_stime)"
_BYTES = """
small = stepped(gym.make_vec, 1024, vectorization_mode='vector_entry_point')
before = int(open('/proc/self/statm').read().split()[1]) * resource.getpagesize()
large = stepped(gym.make_vec, {}, vectorization_mode='vector_entry_point')
print(1024 * used().ru_maxrss - before)
"""


def printed(code: str, cache: str | None = None) -> float:
    """The number that a separate process prints; its compiled code is cached in ``cache``.

    Raises:
        RuntimeError: it fails.
    """
    environment = {**os.environ, "NUMBA_CACHE_DIR": cache} if cache else None
    command = [sys.executable, "-c", _START + code]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    if done.returncode:
        raise RuntimeError(f"a process of its own failed:\n{done.stderr}")
    return float(done.stdout)


def start(times: int, count: int = 1_000_000) -> dict[str, Any]:
    """Seconds to a first step, with and without compilation; bytes for each of so many environments."""
    times_of: dict[str, list[float]] = {"cold": [], "warm": []}
    for _ in range(times):
        with tempfile.TemporaryDirectory() as cache:
            for seconds in times_of.values():
                seconds.append(printed(_SECONDS, cache))
    return {**times_of, "of": count, "bytes": printed(_BYTES.format(count)) / count}
