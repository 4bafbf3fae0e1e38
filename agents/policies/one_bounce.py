"""The one-bounce policy: it chooses the box's angle and rate at the jack's next landing, without a planner.

The observation determines when the jack lands. For every pair of an angle and a rate from two lists, the policy
computes one bounce on such a floor in closed form, and a network evaluates the state after it. Then the box turns to
the best pair by a cubic in time that ends at the landing.

The network is a value like the planner's (:mod:`agents.policies.value`), improved on states that this policy visits
(``agents/training/distil.py``).

A folder of such a policy has

landing.json    the environment that it was made for, and the lists
weights.npz     as in :mod:`agents.policies.value`
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.policies.network import Layer, read_with_layers
from agents.policies.scripted import PLAIN, Actions, PolicyWithEnv, StatelessPolicy, state_of
from agents.policies.scripted import torques as as_actions
from agents.policies.value import Value
from agents.settings import EnvSettings
from jackbox_env import Scene
from jackbox_env.mechanics import contacts_of, impact_maps
from jackbox_env.model.action import EPISODE_STEPS
from jackbox_env.model.landing import QUARTER, aim, landing_time, upright
from jackbox_env.model.observation import BOUNDS
from jackbox_env.model.states import OMEGA_BOX, RATES, THETA_BOX, THETA_JACK, VY_JACK, Y_JACK, Array, State
from jackbox_env.tools import checks as check

LANDING = "landing.json"
FLOOR = 3  # the wall under the jack while the box is turned by less than an eighth of a turn
AFTER = 0.25  # [s] after the landing in a level box a bounce is evaluated
_MOST_PAIRS = 1000  # each needs about a kilobyte for each jack
_NEWTON_STEPS = 3  # to the moment of the contact
_LONGEST_STEP = 0.25  # [s]
_LEAST_CLOSING = 0.5  # [m/s] speed of a gap in these steps, at least


@dataclass(frozen=True)
class LandingSettings(EnvSettings):
    """The environment that a policy was made for, and the angles and rates that it chooses from."""

    contact: str | None = "exact"
    """Contact model that it was made on."""
    action_repeat: int = 5
    """Control steps between decisions."""
    angles: tuple[float, ...] = (0.0,)
    """Angles of the box at the landing [rad]."""
    rates: tuple[float, ...] = (0.0,)
    """Rates of the box at the landing [rad/s]."""

    def __post_init__(self) -> None:
        """Raises TypeError or ValueError for settings that make no policy."""
        super().__post_init__()
        check.whole("action_repeat", self.action_repeat, at_least=1, at_most=EPISODE_STEPS)
        for name, most in (("angles", QUARTER), ("rates", 100.0)):
            numbers = getattr(self, name)
            if not isinstance(numbers, list | tuple) or not 0 < len(numbers) <= _MOST_PAIRS:
                raise ValueError(f"{name} must be a list of 1 to {_MOST_PAIRS} numbers, got {check.shown(numbers)}")
            for number in numbers:
                check.real(name, number, at_least=-most, at_most=most)
            object.__setattr__(self, name, tuple(numbers))
        pairs = len(self.angles) * len(self.rates)
        if pairs > _MOST_PAIRS:
            raise ValueError(f"angles and rates must make at most {_MOST_PAIRS:,} pairs, got {pairs:,}")

    @property
    def pairs(self) -> Array:
        """All pairs of an angle and a rate, shape (angles * rates, 2)."""
        angles, rates = np.meshgrid(self.angles, self.rates, indexing="ij")
        return np.stack([angles.ravel(), rates.ravel()], axis=1)


def landing_torques(scene: Scene, states: Array, targets: Array, duration: float) -> Array:
    """:func:`jackbox_env.model.landing.aim` from states, (n, 12), at angles [rad] and rates [rad/s], (n, 2): (n,)."""
    rows = zip(states.tolist(), targets.tolist(), strict=True)
    return np.array([aim(scene, State(*row), angle, rate, duration) for row, (angle, rate) in rows])


def landing_times(scene: Scene, states: Array) -> Array:
    """:func:`landing_time` of states, shape (n, 12): shape (n,)."""
    return np.array([landing_time(scene, State(*row)) for row in states.tolist()])


def uprighted(states: Array) -> Array:
    """States, shape (n, 12), with the boxes turned back by whole quarter turns, to within an eighth."""
    turned = states.copy()
    turned[:, THETA_BOX] = [upright(angle) for angle in states[:, THETA_BOX].tolist()]
    return turned


def flown(scene: Scene, states: Array, times: Array) -> Array:
    """States, shape (n, 12), after times [s], shape (n,), of free flight without torque."""
    later = states.copy()
    later[:, :RATES] += later[:, RATES:] * times[:, None]
    later[:, Y_JACK] -= 0.5 * scene.gravity * times * times
    later[:, VY_JACK] -= scene.gravity * times
    return later


def bounced(scene: Scene, states: Array, times: Array, targets: Array) -> Array:
    """States ``AFTER`` the landings, predicted for target angles and rates: one contact of one foot with the floor.

    Newton's method on the gap locates the moment of the contact; :func:`impact_maps` evaluates the bounce.

    Args:
        scene: in which the jack flies; the box's angle is within an eighth of a turn.
        states: now, shape (n, 12).
        times: of the landings in a level box [s], shape (n,).
        targets: the box's angle [rad] and rate [rad/s] at those times, shape (n, 2).
    """
    at = flown(scene, states, times)
    at[:, THETA_BOX], at[:, OMEGA_BOX] = targets.T
    floors, since = np.full(len(at), FLOOR), np.zeros(len(at))
    for iteration in range(_NEWTON_STEPS + 1):
        moved = flown(scene, at, since)
        turns = np.round((moved[:, THETA_BOX] - QUARTER - moved[:, THETA_JACK]) / QUARTER)
        feet = turns.astype(np.int64) % 4  # nearest to the floor
        if iteration < _NEWTON_STEPS:
            gap, jacobians = contacts_of(scene, moved, floors, feet)
            closing = np.maximum(-(jacobians * moved[:, RATES:]).sum(axis=1), _LEAST_CLOSING)
            since = since + np.clip(gap / closing, -_LONGEST_STEP, _LONGEST_STEP)
    return flown(scene, impact_maps(scene, moved, floors, feet)[0], AFTER - since)


class LandingPolicy(StatelessPolicy):
    """A policy with Stable-Baselines3's ``predict``.

    Args:
        settings: the environment, and the angles and rates to choose from.
        layers: of the value, see :class:`agents.policies.value.Value`.

    Raises:
        ValueError: the layers make no value.
    """

    def __init__(self, settings: LandingSettings, layers: list[Layer]) -> None:
        super().__init__(self.chosen, len(BOUNDS))
        self.settings, self.value = settings, Value(settings, layers)
        self._scene, self._pairs = Scene.of(settings.scene_fields).changed(drive=None), settings.pairs
        self._duration = settings.action_repeat * settings.control_dt

    def chosen(self, observations: NDArray[Any]) -> Actions:
        """Torques towards the best pair of angle and rate, shape (n, 1)."""
        return as_actions(self.towards_best(np.array([state_of(self._scene, row) for row in observations.tolist()])))

    @property
    def in_env(self) -> PolicyWithEnv:
        """The policy, with what its environment observes and does."""
        return PolicyWithEnv(self, {**PLAIN, "action_repeat": self.settings.action_repeat})

    def towards_best(self, states: Array) -> Array:
        """Torques in units of the limit, shape (n,), for states, shape (n, 12)."""
        states = uprighted(states)
        chosen = self._pairs[self.worth(states, landing_times(self._scene, states)).argmax(axis=1)]
        return landing_torques(self._scene, states, chosen, self._duration)

    def worth(self, states: Array, times: Array) -> Array:
        """Value of each pair, shape (n, pairs), for states, shape (n, 12), and times to the landing, (n,)."""
        pairs, count = len(self._pairs), len(states)
        after = bounced(
            self._scene, np.repeat(states, pairs, axis=0), np.repeat(times, pairs), np.tile(self._pairs, (count, 1))
        )
        # each jack by itself, always as many rows: a product of matrices may depend on how many rows it has
        return np.array([self.value.of(of_jack) for of_jack in after.reshape(count, pairs, 12)]).reshape(count, pairs)


def read_landing(folder: Path) -> LandingPolicy:
    """Read a policy from its folder; nothing is unpickled.

    Raises:
        FileNotFoundError: it has none.
        ValueError: its files are damaged, or do not fit each other.
    """
    return read_with_layers(
        folder, LANDING, "policy of landings", lambda stored, layers: LandingPolicy(LandingSettings.of(stored), layers)
    )
