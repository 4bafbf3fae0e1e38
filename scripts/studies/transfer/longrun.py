"""How a jack moves in the long run under each contact setting: one number per statistic and episode.

Episodes are the environment's: its starts, 500 control steps of 0.02 s. They are independent, between settings too
(each has starts and torques of its own), so that tests of two independent samples hold; pairing would gain nothing
after the first few impacts, when chaos has parted the trajectories. What is tested is one number per episode: the
impacts within an episode follow from each other.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from agents.models import derived_seed
from agents.policies import Policy
from agents.storage import DamagedFileError, make_folder, parsing, say_skipped, write_bytes
from jackbox_env import FIDELITIES, Impact, Scene, make_simulator
from jackbox_env.observation import observe
from jackbox_env.states import clearance
from jackbox_env.tasks import sample_start

STEPS = 500
DT = 0.02  # [s]
_TOGETHER = 64  # simulators, so that a network is asked for many at once

# Keywords of make_simulator. The last is the negative control: what differs from exact in nothing but its seeds.
SETTINGS: dict[str, dict[str, Any]] = {
    "exact": FIDELITIES["exact"]._asdict(),
    "coarse": FIDELITIES["coarse"]._asdict(),
    "balanced": FIDELITIES["balanced"]._asdict(),
    "fine": FIDELITIES["fine"]._asdict(),
    "one iteration": {**FIDELITIES["coarse"]._asdict(), "iterations": 1},
    "exact again": FIDELITIES["exact"]._asdict(),
}

# Torques [N m], or None for the drive, from the states, each shape (12,).
Torques = Callable[[list[NDArray[np.float64]]], Sequence[float | None]]
# Names with units; each function takes (impacts, jack's speeds [m/s], its rates [rad/s]) of an episode.
Measure = Callable[[list[Impact], NDArray[np.float64], NDArray[np.float64]], float]
STATISTICS: dict[str, Measure] = {
    "impacts [1/s]": lambda impacts, speeds, rates: len(impacts) / (len(speeds) * DT),
    "steps with two or more feet [1/s]": lambda impacts, speeds, rates: _joint(impacts) / (len(speeds) * DT),
    "impulse [N s per s]": lambda impacts, speeds, rates: _total(impacts) / (len(speeds) * DT),
    "median impulse [N s]": lambda impacts, speeds, rates: _quantile([hit.impulse for hit in impacts], 0.5),
    "9th decile of impulse [N s]": lambda impacts, speeds, rates: _quantile([hit.impulse for hit in impacts], 0.9),
    "mean speed of the jack [m/s]": lambda impacts, speeds, rates: float(speeds.mean()),
    "9th decile of its speed [m/s]": lambda impacts, speeds, rates: _quantile(speeds, 0.9),
    "mean spin of the jack [rad/s]": lambda impacts, speeds, rates: float(np.abs(rates).mean()),
}


def _total(impacts: list[Impact]) -> float:
    return math.fsum(hit.impulse for hit in impacts)


def _joint(impacts: list[Impact]) -> int:
    """Control steps in which at least two different feet hit."""
    feet: dict[int, set[int]] = {}
    for hit in impacts:
        # an impact at a step's very end belongs to that step
        feet.setdefault(math.ceil(hit.time / DT - 1e-9), set()).add(hit.foot)
    return sum(len(together) > 1 for together in feet.values())


def _quantile(values: Any, at: float) -> float:
    return float(np.quantile(values, at)) if len(values) else math.nan


class Episodes(NamedTuple):
    """What was measured of some episodes.

    Attributes:
        values: statistic by episode, each shape (episodes,); NaN where an episode without an impact has no such number.
        depth: deepest that a foot was in a wall at the end of any step [m].
        lost: episodes that ended because the jack would have left the box; they are not in ``values``.
    """

    values: dict[str, NDArray[np.float64]]
    depth: float
    lost: int


def random_torques(scene: Scene, rng: np.random.Generator) -> Torques:
    """Torques [N m] uniform within the limit, another in each step."""
    return lambda states: rng.uniform(-scene.torque_limit, scene.torque_limit, len(states)).tolist()


def drive(states: list[NDArray[np.float64]]) -> list[None]:
    """The scene's own drive: the chirp."""
    return [None] * len(states)


def acting(scene: Scene, policy: Policy) -> Torques:
    """Torques [N m] of a policy that sees what the environment shows."""

    def torques(states: list[NDArray[np.float64]]) -> list[float]:
        seen = np.stack([observe(scene, state.tolist()) for state in states])
        actions = np.clip(policy.predict(seen, deterministic=True)[0], -1.0, 1.0).astype(np.float64)
        return (actions[:, 0] * scene.torque_limit).tolist()  # type: ignore[no-any-return]

    return torques


def run_episodes(
    setting: dict[str, Any],
    torques: Torques,
    rng: np.random.Generator,
    episodes: int,
    scene: Scene | None = None,
    progress: bool = False,
    label: str = "",
) -> Episodes:
    """Run episodes under ``torques``, a function of the states of those under way, and measure them."""
    scene = scene or Scene()
    values: dict[str, list[float]] = {name: [] for name in STATISTICS}
    depth, lost = -math.inf, 0
    with tqdm(total=episodes, unit="episodes", disable=not progress, desc=label, leave=False) as bar:
        for begin in range(0, episodes, _TOGETHER):
            block = [_Episode(scene, setting, rng) for _ in range(min(_TOGETHER, episodes - begin))]
            for _ in range(STEPS):
                going = [episode for episode in block if not episode.lost]
                for episode, torque in zip(going, torques([one.states[-1] for one in going]), strict=True):
                    episode.step(torque)
            for episode in block:
                depth = max(depth, episode.depth)
                lost += episode.lost
                for name, value in episode.measured().items():
                    values[name].append(value)
            bar.update(len(block))
    return Episodes({name: np.array(column) for name, column in values.items()}, depth, lost)


class _Episode:
    """One simulator and what it went through."""

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
        speeds, rates = np.hypot(states[:, 9], states[:, 10]), states[:, 11]
        return {name: measure(self._impacts, speeds, rates) for name, measure in STATISTICS.items()}


def stored(path: Path, make: Callable[[], Episodes]) -> Episodes:
    """What ``make`` measures, from the file if it is there and whole."""
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
    folder: Path, policies: dict[str, Policy], episodes: int, progress: bool = True
) -> dict[str, dict[str, Episodes]]:
    """Episodes under random torques, under the chirp and under each policy: condition -> setting -> episodes.

    They are kept in ``folder``: what is there is not run again.

    Raises:
        ValueError: ``folder`` holds another number of episodes.
    """
    scene = Scene()
    found: dict[str, dict[str, Episodes]] = {}
    for number, condition in enumerate(["random torques", "the chirp", *policies]):
        found[condition] = {}
        for place, (setting, keywords) in enumerate(SETTINGS.items()):
            rng = np.random.default_rng(derived_seed("long run", number, place))
            named: dict[str, Torques] = {"random torques": random_torques(scene, rng), "the chirp": drive}
            torques = named[condition] if condition in named else acting(scene, policies[condition])
            label = f"{setting}, {condition}"
            make = partial(run_episodes, keywords, torques, rng, episodes, scene, progress, label)
            kept = stored(folder / f"{condition}-{setting}.npz".replace(" ", "_"), make)
            if len(next(iter(kept.values.values()))) + kept.lost != episodes:
                raise ValueError(f"{folder} holds other than {episodes} episodes for {setting} under {condition}")
            found[condition][setting] = kept
    return found
