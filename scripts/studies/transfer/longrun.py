"""How a jack moves in the long run under each contact setting: one number per statistic and episode.

Episodes are the environment's: its starts, 500 control steps of 0.02 s. They are independent, between settings too.
Pairing would gain nothing, as chaos parts the trajectories after a few impacts.
"""

from __future__ import annotations

import io
import itertools
import math
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from agents.files import DamagedFileError, parsing, say_skipped
from agents.policies.scripted import Policy
from agents.sweeps.in_process import InTurn, Runner, Trial
from agents.training.models import derived_seed
from jackbox_env import FIDELITIES, Impact, Scene, make_simulator
from jackbox_env.observation import observe
from jackbox_env.recording.files import make_folder, write_bytes
from jackbox_env.states import clearance
from jackbox_env.tasks import sample_start

STEPS = 500
DT = 0.02  # [s]
_TOGETHER = 64  # simulators side by side, so that a network is evaluated for many at once

# Keywords of make_simulator. The last is the negative control: it differs from exact only in its seeds.
SETTINGS: dict[str, dict[str, Any]] = {
    **{name: FIDELITIES[name]._asdict() for name in ("exact", "coarse", "balanced", "fine")},
    "one iteration": {**FIDELITIES["coarse"]._asdict(), "iterations": 1},
    "exact again": FIDELITIES["exact"]._asdict(),
}

# Torques [N m], or None for the drive, from the states, each shape (12,).
Torques = Callable[[list[NDArray[np.float64]]], Sequence[float | None]]


def measure(impacts: list[Impact], speeds: NDArray[np.float64], rates: NDArray[np.float64]) -> dict[str, float]:
    """Statistics of an episode, from its impacts, the jack's speeds [m/s] and its rates [rad/s], one a step."""
    impulses, seconds = [hit.impulse for hit in impacts], len(speeds) * DT
    median, decile = np.quantile(impulses, [0.5, 0.9]).tolist() if impulses else (math.nan, math.nan)
    return {
        "impacts [1/s]": len(impacts) / seconds,
        "steps with two or more feet [1/s]": _joint(impacts) / seconds,
        "impulse [N s per s]": math.fsum(impulses) / seconds,
        "median impulse [N s]": median,
        "9th decile of impulse [N s]": decile,
        "mean speed of the jack [m/s]": float(speeds.mean()),
        "9th decile of its speed [m/s]": float(np.quantile(speeds, 0.9)),
        "mean spin of the jack [rad/s]": float(np.abs(rates).mean()),
    }


def _joint(impacts: list[Impact]) -> int:
    """Control steps in which at least two different feet hit; an impact at a step's very end belongs to that step."""
    hits = {(math.ceil(hit.time / DT - 1e-9), hit.foot) for hit in impacts}
    return sum(feet > 1 for feet in Counter(step for step, _ in hits).values())


STATISTICS = tuple(measure([], np.ones(1), np.ones(1)))  # their names with units


class Episodes(NamedTuple):
    """What was measured of some episodes."""

    values: dict[str, NDArray[np.float64]]  # statistic by episode, shape (episodes,) each; NaN where it needs an impact
    depth: float  # deepest that a foot was in a wall at the end of any step [m]
    lost: int  # episodes that ended because the jack would have left the box; they are not in ``values``


def chirp(states: list[NDArray[np.float64]]) -> list[None]:
    """The scene's own drive."""
    return [None] * len(states)


def random_torques(scene: Scene, rng: np.random.Generator) -> Torques:
    """Torques [N m] uniform within the limit, another in each step."""
    return lambda states: rng.uniform(-scene.torque_limit, scene.torque_limit, len(states)).tolist()


def acting(scene: Scene, policy: Policy) -> Torques:
    """Torques [N m] of a policy that sees what the environment shows."""

    def torques(states: list[NDArray[np.float64]]) -> list[float]:
        seen = np.stack([observe(scene, state.tolist()) for state in states])
        actions = np.clip(policy.predict(seen, deterministic=True)[0], -1.0, 1.0).astype(np.float64)
        return (actions[:, 0] * scene.torque_limit).tolist()  # type: ignore[no-any-return]

    return torques


def run_episodes(
    setting: dict[str, Any], torques: Torques, rng: np.random.Generator, episodes: int, scene: Scene | None = None
) -> Episodes:
    """Run episodes under ``torques``, a function of the states of those under way, and measure them."""
    scene, ended = scene or Scene(), []
    for begin in range(0, episodes, _TOGETHER):
        block = [_Episode(scene, setting, rng) for _ in range(min(_TOGETHER, episodes - begin))]
        for _ in range(STEPS):
            going = [episode for episode in block if not episode.lost]
            for episode, torque in zip(going, torques([one.states[-1] for one in going]), strict=True):
                episode.step(torque)
        ended += [(episode.measured(), episode.depth) for episode in block]
    kept = [measured for measured, _ in ended if measured]
    values = {name: np.array([measured[name] for measured in kept]) for name in STATISTICS}
    return Episodes(values, max(depth for _, depth in ended), episodes - len(kept))


class _Episode:
    """One simulator and the record of its episode."""

    def __init__(self, scene: Scene, setting: dict[str, Any], rng: np.random.Generator) -> None:
        self._scene, self._simulator = scene, make_simulator(scene, **setting)
        self._simulator.reset(sample_start(scene, rng))
        self.states = [self._simulator.state]
        self._impacts: list[Impact] = []
        self.lost = False
        self.depth = -math.inf

    def step(self, torque: float | None) -> None:
        try:
            self._simulator.step(DT, torque)
        except RuntimeError:  # the jack would leave the box: counted
            self.lost = True
            return
        state = self._simulator.state
        self.states.append(state)
        if self._simulator.impacts:
            self._impacts += self._simulator.impacts
            self.depth = max(self.depth, -clearance(self._scene, state))

    def measured(self) -> dict[str, float]:
        if self.lost:
            return {}
        states = np.array(self.states[1:])
        return measure(self._impacts, np.hypot(states[:, 9], states[:, 10]), states[:, 11])


def stored(path: Path, make: Callable[[], Episodes]) -> Episodes:
    """Return what ``make`` measures. Read it from the file if that exists and is whole."""
    if path.is_file():
        content = path.read_bytes()
        try:
            with parsing(path), np.load(io.BytesIO(content)) as kept:
                values = {name: kept[f"value_{number}"] for number, name in enumerate(STATISTICS)}
                return Episodes(values, float(kept["depth"]), int(kept["lost"]))
        except DamagedFileError as error:
            say_skipped(error)
    episodes = make()
    file = io.BytesIO()
    names = {f"value_{number}": column for number, column in enumerate(episodes.values.values())}
    np.savez(file, depth=episodes.depth, lost=episodes.lost, **names)  # type: ignore[arg-type]
    make_folder(path.parent)
    write_bytes(path, file.getvalue())
    return episodes


def run_long(
    folder: Path,
    policies: dict[str, Policy],
    episodes: int,
    progress: bool = True,
    scene: Scene | None = None,
    runner: Runner | None = None,
) -> dict[str, dict[str, Episodes]]:
    """Episodes under random torques, under the chirp and under each policy: condition -> setting -> episodes.

    They are kept in ``folder``. Episodes found there are not run again.

    Raises:
        RuntimeError: some could not be run.
        ValueError: ``folder`` holds another number of episodes.
    """
    conditions = ["random torques", "the chirp", *policies]
    pairs = list(itertools.product(conditions, SETTINGS))
    left = [pair for pair in pairs if not _place(folder, *pair).is_file()]
    trials = [Trial({"condition": condition, "setting": setting}) for condition, setting in left]
    work = partial(_run_pair, folder.resolve(), policies, episodes, scene or Scene())
    with tqdm(total=len(pairs), initial=len(pairs) - len(left), disable=not progress, desc="long run") as bar:
        for done in (runner or InTurn()).run(trials, work, bar.refresh):
            if done.error is not None:
                raise RuntimeError(done.error)
            bar.update()
    again = partial(_pair, folder, policies, episodes, scene or Scene())
    return {condition: {setting: again(condition, setting) for setting in SETTINGS} for condition in conditions}


def _place(folder: Path, condition: str, setting: str) -> Path:
    return folder / f"{condition}-{setting}.npz".replace(" ", "_")


def _run_pair(folder: Path, policies: dict[str, Policy], episodes: int, scene: Scene, asked: dict[str, Any]) -> None:
    _pair(folder, policies, episodes, scene, asked["condition"], asked["setting"])


def _pair(
    folder: Path, policies: dict[str, Policy], episodes: int, scene: Scene, condition: str, setting: str
) -> Episodes:
    """The episodes of a setting under a condition, run here or read."""
    number, place = ["random torques", "the chirp", *policies].index(condition), list(SETTINGS).index(setting)
    rng = np.random.default_rng(derived_seed("long run", number, place))
    named: dict[str, Torques] = {"random torques": random_torques(scene, rng), "the chirp": chirp}
    torques = named[condition] if condition in named else acting(scene, policies[condition])
    make = partial(run_episodes, SETTINGS[setting], torques, rng, episodes, scene)
    kept = stored(_place(folder, condition, setting), make)
    if len(next(iter(kept.values.values()))) + kept.lost != episodes:
        raise ValueError(f"{folder} holds other than {episodes} episodes for {setting} under {condition}")
    return kept
