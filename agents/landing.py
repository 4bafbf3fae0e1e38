"""A policy that chooses how the box shall meet the jack: at which angle and rate, at the landing that it foresees.

A network rates every pair of an angle and a rate from two lists. The best pair, averaged with its neighbours by their
ratings, is what the box is moved to until the landing. The torque is that of the cubic in time which ends there. No
future is played.

A folder of such a policy holds

landing.json    what it was made by
weights.npz     as in :mod:`agents.network`; between the layers stands max(0, x)
"""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass, fields
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.network import WEIGHTS, Layer, read_layers, write_layers
from agents.playing import Manner, Playing, play
from agents.policies import Actions
from agents.preview import FEATURES, Flight, columns, flight_of
from agents.settings import EPISODE_STEPS, MOST_LAYERS, EnvSettings
from agents.storage import write_json
from jackbox_env import Scene
from jackbox_env import _validation as check
from jackbox_env.states import Array

LANDING = "landing.json"
INPUTS = 12  # numbers that the network sees
_LARGEST = 1_000_000  # [bytes] of landing.json
_TEMPERATURE = 0.5  # of the mean over a pair and its neighbours
Floats = NDArray[np.float32]


@dataclass(frozen=True)
class LandingSettings(EnvSettings):
    """What a policy was made for, and what it chooses from."""

    contact: str | None = "exact"
    """Contact model that it was made on."""
    hold: int = 5
    """Control steps that each torque is held for."""
    angles: tuple[float, ...] = (0.0,)
    """Angles of the box at the landing that are rated, rising [rad]."""
    rates: tuple[float, ...] = (0.0,)
    """Rates of the box there that are rated, rising [rad/s]."""
    hidden_units: tuple[int, ...] = (128, 128)
    """Width of each hidden layer."""

    def __post_init__(self) -> None:
        """Raises TypeError or ValueError for settings that make no policy."""
        super().__post_init__()
        check.whole("hold", self.hold, at_least=1, at_most=EPISODE_STEPS)
        for name in ("angles", "rates", "hidden_units"):
            given = getattr(self, name)
            if not isinstance(given, list | tuple) or not 0 < len(given) <= 1000:
                raise ValueError(f"{name} must be a list of 1 to 1000 numbers, got {check.shown(given)}")
            object.__setattr__(self, name, tuple(given))
        for name in ("angles", "rates"):
            for number in getattr(self, name):
                check.real(name, number, at_least=-100.0, at_most=100.0)
        for width in self.hidden_units:
            check.whole("hidden_units", width, at_least=1, at_most=10_000)
        if len(self.hidden_units) > MOST_LAYERS:
            raise ValueError(f"hidden_units must be at most {MOST_LAYERS} layers, got {len(self.hidden_units)}")

    @property
    def pairs(self) -> Array:
        """All pairs of an angle and a rate, shape (angles * rates, 2), the rates running fastest."""
        angles, rates = np.meshgrid(self.angles, self.rates, indexing="ij")
        return np.stack([angles.ravel(), rates.ravel()], axis=1)


def inputs(flight: Flight, observations: Floats) -> tuple[Floats, NDArray[np.float64]]:
    """What the network sees of observations, float32, shape (n, 10): (n, ``INPUTS``); the times to the landing, (n,).

    Speeds and places are along the world's axes, scaled to order one; times are in units of L / v0.
    """
    _, y, vx, vy, cosine, sine, omega, _, _, omega_jack = observations.T
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # cut or not taken, see ``columns``
        told = dict(zip(FEATURES, columns(flight, observations.T, np), strict=True))
    time, cosine_4, sine_4 = 2.0 * told["time"], told["cosine_world"], told["sine_world"]
    seen = [
        time - 1.0, cosine_4, sine_4, 2.0 * cosine_4 * sine_4, cosine_4 * cosine_4 - sine_4 * sine_4,
        3.0 * told["place"], 3.0 * (told["speed"] - 1.0), 4.0 * (cosine * vx - sine * vy), 3.0 * omega_jack,
        3.0 * np.arctan2(sine, cosine), 2.0 * omega, 3.0 * y,
    ]  # fmt: skip
    return np.stack(seen, axis=1).astype(np.float32), time.astype(np.float64)


def torques(scene: Scene, observations: Floats, times: Array, targets: Array, held: float) -> Array:
    """Torques, in units of the limit, that move boxes to targets in the times to the landing, shape (n,).

    Args:
        scene: its torque limit, its box's inertia and its units.
        observations: shape (n, 10).
        times: to the landing, shape (n,) [L / v0]; at least ``held`` is taken.
        targets: angle [rad] and rate [rad/s] there, shape (n, 2).
        held: how long each torque is held [s]; it is the cubic's mean over that time.
    """
    unit = scene.box_half_width / scene.speed_scale  # [s]
    angle = np.arctan2(observations[:, 5], observations[:, 4]).astype(np.float64)
    rate, left = observations[:, 6] / unit, np.maximum(times * unit, held)
    missing, wanted = targets[:, 0] - angle, targets[:, 1]
    first = 6.0 * missing / left**2 - (4.0 * rate + 2.0 * wanted) / left  # [rad/s^2]
    growth = -12.0 * missing / left**3 + 6.0 * (rate + wanted) / left**2  # [rad/s^3]
    found: Array = (first + 0.5 * held * growth) * scene.box_inertia / scene.torque_limit
    return np.clip(found, -1.0, 1.0)


class LandingPolicy:
    """A policy with Stable-Baselines3's ``predict``.

    Args:
        settings: what it was made by.
        layers: weight, shape (outputs, inputs), and bias, shape (outputs,), of each layer; the last one's outputs rate
            ``settings.pairs``.

    Raises:
        ValueError: the layers do not fit the settings.
    """

    def __init__(self, settings: LandingSettings, layers: list[Layer]) -> None:
        self.settings, self._layers, self._scene = settings, layers, Scene.of(settings.scene_fields)
        self._flight, self._manner = flight_of(self._scene), Manner(settings.hold)
        self._angles, self._rates = np.array(settings.angles), np.array(settings.rates)
        sizes = [INPUTS, *settings.hidden_units, len(self._angles) * len(self._rates)]
        wanted = [((after, before), (after,)) for before, after in pairwise(sizes)]
        found = [(weight.shape, bias.shape) for weight, bias in layers]
        if found != wanted:
            raise ValueError(f"the layers of these settings have shapes {wanted}, got {found}")
        if not all(np.isfinite(part).all() for layer in layers for part in layer):
            raise ValueError("weights must be finite")

    def predict(
        self, observation: Any, state: Playing | None = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Actions, Playing]:
        """Return actions and the state for the next call, see :func:`agents.playing.play`."""
        return play(self._manner, self.act, observation, state, episode_start)

    def act(self, observations: NDArray[Any]) -> Actions:
        """Actions, shape (n, 1), for observations, shape (n, 10)."""
        rows = np.asarray(observations, dtype=np.float32)
        seen, times = inputs(self._flight, rows)
        held = self.settings.hold * self.settings.control_dt
        return torques(self._scene, rows, times, self.targets(seen), held).astype(np.float32)[:, None]

    def ratings(self, seen: Floats) -> Floats:
        """Ratings of all pairs, shape (n, pairs), for what the network sees."""
        values = seen
        for number, (weight, bias) in enumerate(self._layers):
            values = np.maximum(values, 0.0) if number else values
            values = values @ weight.T + bias
        return values

    def targets(self, seen: Floats) -> Array:
        """Angle [rad] and rate [rad/s] chosen, shape (n, 2), for what the network sees."""
        ratings, rows = self.ratings(seen), np.arange(len(seen))
        best = ratings.argmax(axis=1)
        top, (one, other) = ratings[rows, best], np.divmod(best, len(self._rates))
        total, angle, rate = np.zeros(len(seen)), np.zeros(len(seen)), np.zeros(len(seen))
        for beside in (-1, 0, 1):
            for after in (-1, 0, 1):
                place = np.clip(one + beside, 0, len(self._angles) - 1), np.clip(other + after, 0, len(self._rates) - 1)
                there = (place[0] == one + beside) & (place[1] == other + after)  # not beyond the lists' ends
                share = there * np.exp((ratings[rows, place[0] * len(self._rates) + place[1]] - top) / _TEMPERATURE)
                total, angle, rate = (
                    total + share, angle + share * self._angles[place[0]], rate + share * self._rates[place[1]],
                )  # fmt: skip
        return np.stack([angle / total, rate / total], axis=1)


def write_landing(folder: Path, settings: LandingSettings, layers: list[Layer]) -> None:
    """Write a policy's files into a folder."""
    write_layers(folder, layers)
    write_json(folder / LANDING, dataclasses.asdict(settings))


def read_landing(folder: Path) -> LandingPolicy:
    """Read a policy from its folder; nothing is unpickled.

    Raises:
        FileNotFoundError: it holds none.
        ValueError: its files are damaged, or do not fit each other.
    """
    path = folder / LANDING
    if not path.is_file() or not (folder / WEIGHTS).is_file():
        raise FileNotFoundError(f"{folder} holds no {LANDING if not path.is_file() else WEIGHTS}")
    try:
        if path.stat().st_size > _LARGEST:
            raise ValueError(f"they must be at most {_LARGEST:,} bytes, got {path.stat().st_size:,}")
        given = json.loads(path.read_bytes())
        if not isinstance(given, dict):
            raise ValueError(f"they must be a JSON object, got {check.shown(given)}")
        check.known_keys("settings", given, [part.name for part in fields(LandingSettings)])
        settings = LandingSettings(**given)
    except (RecursionError, TypeError, ValueError) as error:
        raise ValueError(f"{path} holds no settings of a policy: {error}") from error
    try:
        return LandingPolicy(settings, read_layers(folder))
    except Exception as error:
        raise ValueError(f"{folder / WEIGHTS} holds no weights of the settings beside it: {error}") from error
