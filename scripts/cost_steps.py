"""What ``scripts/costs.py`` times: the same control steps with a thing and without it.

What a thing costs must not be mixed up with where it leads: without gravity the jack hardly meets a wall. So all step
the same moments, states of episodes of the default scene, each put back before it is stepped. What can not be switched
off is taken out: a stand-in does as little as possible in its place. One thread does it all, and its own clock is read,
which stands still while other processes have the core.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from types import FunctionType, MethodType, SimpleNamespace
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from jackbox_env import Drive, Scene
from jackbox_env.env import JackInBoxEnv
from jackbox_env.planning import Rollout, rollout
from jackbox_env.simulators import exact, make_simulator, pymunk
from jackbox_env.tasks import sample_start
from scripts.timing import Timed, repeat

Array = NDArray[np.float64]

DT = 0.02  # [s]
EPISODE = 500  # steps
TOGETHER, FEW = 1024, 16  # environments in a batch of the exact model, and of single environments; or episodes
_EVERY, _EVERY_OF_MANY = 4, 40  # steps from a moment to the next
DRAWN = 50  # moments at which frames are drawn
_NEVER = 10**9  # steps to truncation


class Moments(NamedTuple):
    """States of episodes and what acts from there on."""

    states: Array  # (episodes, moments, 12)
    times: list[float]  # [s], of each moment
    actions: NDArray[np.float32]  # (episodes, moments, 1)
    hits: NDArray[np.int64]  # (episodes, moments), impacts in the step from there

    def part(self, episodes: int, moments: int | None = None, every: int = 1) -> Moments:
        """The first episodes and their first moments."""
        chosen = slice(0, moments, every)
        return Moments(
            self.states[:episodes, chosen].copy(), self.times[chosen],
            self.actions[:episodes, chosen].copy(), self.hits[:episodes, chosen],
        )  # fmt: skip


def moments(scene: Scene | None = None) -> tuple[Moments, Moments]:
    """Moments of episodes under random actions, played by the exact model: for one environment, and for a batch."""
    scene, rng = scene or Scene(), np.random.default_rng(0)
    starts = np.array([sample_start(scene, rng) for _ in range(TOGETHER)])
    actions = rng.uniform(-1.0, 1.0, (TOGETHER, EPISODE, 1)).astype(np.float32)
    torques = scene.torque_limit * actions[:, :, 0].astype(np.float64)
    played = rollout(scene, starts, torques, DT, impacts=True, num_threads=1)
    assert isinstance(played, Rollout)
    assert played.impacts is not None
    every = Moments(played.trajectories[:, :-1], [DT * k for k in range(EPISODE)], actions, played.impacts)
    return every.part(FEW, every=_EVERY), every.part(TOGETHER, every=_EVERY_OF_MANY)


def chirped(time: float) -> float:
    """The default chirp as a function of one's own [N m]."""
    return 90000.0 * math.sin(2.0 * math.pi * (0.5 + 0.45 * time) * time)


def shaken(time: float) -> float:
    """A side force [N]."""
    return 4000.0 * math.sin(3.0 * time)


WEIGHTLESS, LONG = Scene(gravity=0.0), Scene(jack_arm=8.0)
TURNED, SHAKEN = Scene(drive=Drive(torque=chirped)), Scene(drive=Drive(force_x=shaken, force_y=shaken))


# -- one environment --------------------------------------------------------------------------------------------------


def presents(contact: str, given: Moments) -> list[list[Any]]:
    """What a simulator holds at each moment: state, time, mean torque, impacts."""

    def held(state: Array) -> Any:
        return state.copy() if contact == "exact" else state.tolist()

    return [
        [(held(state), time, 0.0, []) for state, time in zip(episode, given.times, strict=True)]
        for episode in given.states
    ]


def replay(
    simulator: Any, step: Callable[[Any], object], contact: str, given: Moments, arguments: list[list[Any]],
    seconds: float, begin: Callable[[], object] = lambda: None,
) -> Timed:  # fmt: skip
    """Steps per second of ``step``, called with its argument at each moment; ``begin`` is called where one starts."""
    games = [list(zip(*pair, strict=True)) for pair in zip(presents(contact, given), arguments, strict=True)]
    count = sum(map(len, games))

    def block() -> int:
        for game in games:
            simulator._present = game[0][0]
            begin()
            for present, argument in game:
                simulator._present = present
                step(argument)
        return count

    return repeat(block, seconds, clock=time.thread_time)


def simulated(
    contact: str, given: Moments, seconds: float, scene: Scene | None = None, held: bool = True, checked: bool = True
) -> Timed:
    """Steps of the contact model alone, under held torques or under the scene's drive."""
    simulator = make_simulator(scene or Scene(), contact=contact)
    if not checked:
        trusting(simulator)
    limit = simulator.scene.torque_limit
    torques = [[limit * float(action[0]) if held else None for action in game] for game in given.actions]

    def step(torque: float | None) -> None:
        simulator.step(DT, torque)

    return replay(simulator, step, contact, given, torques, seconds)


def stepped(contact: str, given: Moments, seconds: float, kind: str = "", **settings: Any) -> Timed:
    """Steps of an environment.

    ``kind``: "" as ``gymnasium.make`` makes it, "bare" without wrappers, "read" with its impacts read, "drawn" with a
    frame drawn, or a method of the environment that a stand-in replaces.
    """
    env: Any = gym.make("JackInBox-v0", contact=contact, max_episode_steps=_NEVER, **settings)
    core: JackInBoxEnv = env.unwrapped
    env.reset(seed=0)
    for _ in range(2):
        env.step(given.actions[0, 0])  # Gymnasium's checker looks at the first ones closely
    observation, terms = core._score(core.state, 0.0, 0.0)
    if kind == "_info":
        setattr(core, kind, lambda *_: {})
    elif kind == "_score":
        setattr(core, kind, lambda *_: (observation, terms))
    elif kind == "_torque_of":
        setattr(core, kind, lambda action: max(-1.0, min(1.0, float(action[0]))) * 90000.0)
        trusting(core._simulator)

    def read(action: Any) -> None:
        env.step(action)
        _ = core.impacts

    def drawn(action: Any) -> None:
        env.step(action)
        env.render()

    step = {"bare": core.step, "read": read, "drawn": drawn}.get(kind, env.step)
    actions = [list(game) for game in given.actions]
    return replay(core._simulator, step, contact, given, actions, seconds, core._start_picture)


def trusting(simulator: Any) -> Any:
    """The simulator without its checks: methods with the same code, which finds stand-ins where it looks for them."""
    stand_ins = {
        "check": SimpleNamespace(real=lambda name, value, **_: value),
        "end_of_step": lambda time, dt: time + dt,
    }
    for name in ("step", "_step_engine"):
        method = getattr(type(simulator), name, None)
        if method is not None:
            code = method.__code__.replace()  # a copy, which the interpreter adapts on its own
            twin = FunctionType(code, {**method.__globals__, **stand_ins}, name, method.__defaults__)
            setattr(simulator, name, MethodType(twin, simulator))
    return simulator


def compiled_step(given: Moments, seconds: float) -> Timed:
    """Steps of the exact model's compiled code alone, called with what is ready."""
    simulator = exact.ExactSimulator(Scene())
    step, numbers, workspace, after = simulator._step, simulator._numbers, simulator._workspace, np.empty(12)
    drive = simulator._drives[True]
    calls = [
        (numbers, DT, drive, state.copy(), after, time, 90000.0 * float(action[0]), exact._NO_PIECES, workspace)
        for game, actions in zip(given.states, given.actions, strict=True)
        for state, action, time in zip(game, actions, given.times, strict=True)
    ]

    def block() -> int:
        for arguments in calls:
            step(*arguments)
        return len(calls)

    return repeat(block, seconds, clock=time.thread_time)


def without_engine(given: Moments, seconds: float) -> Timed:
    """Steps of the pymunk model without what it does where a foot may touch: there it stays where it is."""
    simulator = trusting(pymunk.PymunkSimulator(Scene()))
    simulator._step_engine = lambda dt, torque: (simulator._present[0], torque)
    torques = [[90000.0 * float(action[0]) for action in game] for game in given.actions]
    return replay(simulator, lambda torque: simulator.step(DT, torque), "pymunk", given, torques, seconds)


# -- batches ----------------------------------------------------------------------------------------------------------


def batched(contact: str, count: int, given: Moments, seconds: float, checked: bool = True, **settings: Any) -> Timed:
    """Environment steps per second of a batch that is put back to its moments before each step."""
    env: Any = gym.make_vec(
        "JackInBox-v0", count, vectorization_mode="vector_entry_point", contact=contact, num_threads=1,
        max_episode_steps=_NEVER, **settings,
    )  # fmt: skip
    env.reset(seed=0)
    core = env.unwrapped
    if not checked:
        core._actions = lambda actions: actions.reshape(count).astype(np.float64)
    everyone = np.ones(count, dtype=np.bool_)
    given = given.part(count)
    lap = [
        (given.states[:, k].copy(), np.full(count, moment), given.actions[:, k].copy())
        for k, moment in enumerate(given.times)
    ]

    def run() -> float:
        passed, steps = 0.0, 0
        while passed <= seconds:
            for states, times, actions in lap:
                core._place(everyone, states, times, anew=True)
                began = time.thread_time()
                env.step(actions)
                passed += time.thread_time() - began
            steps += count * len(lap)
        return steps / passed

    return run
