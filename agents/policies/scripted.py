"""Scripted policies with Stable-Baselines3's ``predict``, so that ``evaluate_policy`` runs them like PPO."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from jackbox_env import Scene
from jackbox_env.model.observation import BOUNDS
from jackbox_env.model.states import Array

Actions = NDArray[Any]
PLAIN = {"observation": "state", "action": "torque", "action_repeat": 1}  # keywords of the environment of policies here


class Policy(Protocol):
    """A policy, or a model of Stable-Baselines3."""

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Return actions for observations of n environments or of one, and the next recurrent state.

        Args:
            observation: shape (n, numbers) or (numbers,).
            state: as returned by the last call; None: all environments start.
            episode_start: shape (n,), True at the start of an episode.
            deterministic: draw no actions.
        """


class PolicyWithEnv(NamedTuple):
    """A policy, and the keywords of ``gymnasium.make("JackInBox-v0", ...)`` that make the environment it plays in."""

    policy: Policy
    keywords: dict[str, Any]

    @property
    def named(self) -> dict[str, Any]:
        """The keywords, with the names of a user's objects if the settings of the policy have them."""
        settings = getattr(self.policy, "settings", None)
        return {name: getattr(settings, name, value) for name, value in self.keywords.items()}


class StatelessPolicy:
    """A policy without memory; subclasses, or the function ``act``, choose the actions.

    Args:
        act: returns actions, shape (n,) or (n, size), for observations, shape (n, numbers).
        numbers: of an observation; None: any.
    """

    def __init__(self, act: Callable[[Any], Any], numbers: int | None = None) -> None:
        self.act, self._numbers = act, numbers

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Actions, Any]:
        """The actions of ``act``; see :class:`Policy`.

        Raises:
            ValueError: observations of another shape.
        """
        actions = np.asarray(self.act(as_rows(observation, self._numbers)))
        return (actions if np.ndim(observation) == 2 else actions[0]), state


def as_rows(observation: Any, numbers: int | None = None) -> NDArray[Any]:
    """Observations of one environment or of n, shape (n, numbers); raises ValueError for another shape."""
    rows = np.atleast_2d(np.asarray(observation))
    if rows.ndim != 2 or rows.shape[1] != (numbers or rows.shape[1]):
        raise ValueError(f"observation must have shape (n, {numbers}) or ({numbers},), got {np.shape(observation)}")
    return rows


def state_of(scene: Scene, observation: Sequence[float]) -> Array:
    """Return a state, shape (12,), with this observation: the box at the origin, its centre at rest.

    Only the motion relative to the box's centre is observed, which without side forces depends on nothing else.
    """
    x, y, vx, vy, cosine, sine, omega, cosine_4, sine_4, jack_omega = observation
    length, speed, angle = scene.box_half_width, scene.speed_scale, math.atan2(sine, cosine)
    c, s = math.cos(angle), math.sin(angle)
    return np.array([
        0.0, 0.0, angle,
        length * (c * x - s * y), length * (s * x + c * y), angle + 0.25 * math.atan2(sine_4, cosine_4),
        0.0, 0.0, omega * speed / length,
        speed * (c * vx - s * vy), speed * (s * vx + c * vy), jack_omega * speed / scene.jack_arm,
    ])  # fmt: skip


def torques(values: NDArray[Any]) -> Actions:
    """Torques in units of the limit, shape (n,), as actions: clipped, float32, shape (n, 1)."""
    actions: Actions = np.clip(values, -1.0, 1.0).astype(np.float32)[:, None]
    return actions


class ZeroPolicy(StatelessPolicy):
    """No torque. In an environment made with ``torque="chirp"`` this is the chirp baseline, as any policy is."""

    def __init__(self) -> None:
        super().__init__(lambda observations: torques(np.zeros(len(observations))))


class RandomPolicy(StatelessPolicy):
    """Uniform torques in [-1, 1], drawn from ``seed``."""

    def __init__(self, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        super().__init__(lambda observations: torques(rng.uniform(-1.0, 1.0, len(observations))))


class LevelPolicy(StatelessPolicy):
    """PD control of the box's angle: torque = -J_b (stiffness theta + damping omega), theta within half a turn."""

    def __init__(self, scene: Scene, stiffness: float = 10.0, damping: float = 5.0) -> None:
        """Gains in 1/s^2 and 1/s."""
        super().__init__(self.towards_level, len(BOUNDS))
        self._scene, self._stiffness, self._damping = scene, stiffness, damping

    def towards_level(self, observations: NDArray[Any]) -> Actions:
        """The PD controller's torques, for observations of shape (n, 10)."""
        scene, seen = self._scene, observations.astype(np.float64)
        angle = np.arctan2(seen[:, 5], seen[:, 4])  # [rad]
        rate = seen[:, 6] * scene.speed_scale / scene.box_half_width  # [rad/s]
        return torques(-scene.box_inertia * (self._stiffness * angle + self._damping * rate) / scene.torque_limit)
