"""Scripted policies with Stable-Baselines3's ``predict``, so that ``evaluate_policy`` runs them like PPO."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from agents.policies.playing import Actions
from jackbox_env import Scene


class Policy(Protocol):
    """A scripted policy, or a model of Stable-Baselines3."""

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Return actions, shape (n, 1) for observations (n, 10) or (1,) for (10,), and the next recurrent state."""


class ScriptedPolicy:
    """A policy without memory; subclasses define the torques."""

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Actions, Any]:
        """The torques of :meth:`act`, clipped; see :class:`Policy`."""
        rows = np.atleast_2d(np.asarray(observation, dtype=np.float64))
        actions = np.clip(self.act(rows), -1.0, 1.0).astype(np.float32)[:, None]
        return (actions if np.ndim(observation) == 2 else actions[0]), state

    def act(self, observations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Torques in units of the limit, shape (n,), for observations of shape (n, 10)."""
        raise NotImplementedError


class ZeroPolicy(ScriptedPolicy):
    """No torque. In an environment made with ``torque="chirp"`` this is the chirp baseline, as any policy is."""

    def act(self, observations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Zeros."""
        return np.zeros(len(observations))


class RandomPolicy(ScriptedPolicy):
    """Uniform torques in [-1, 1], drawn from ``seed``."""

    def __init__(self, seed: int = 0) -> None:
        self._rng = np.random.default_rng(seed)

    def act(self, observations: NDArray[np.float64]) -> NDArray[np.float64]:
        """The next draws."""
        return self._rng.uniform(-1.0, 1.0, len(observations))


class LevelPolicy(ScriptedPolicy):
    """PD control of the box's angle: torque = -J_b (stiffness theta + damping omega), theta within half a turn."""

    def __init__(self, scene: Scene, stiffness: float = 10.0, damping: float = 5.0) -> None:
        """Gains in 1/s^2 and 1/s."""
        self._scene, self._stiffness, self._damping = scene, stiffness, damping

    def act(self, observations: NDArray[np.float64]) -> NDArray[np.float64]:
        """The PD controller's torques."""
        scene = self._scene
        angle = np.arctan2(observations[:, 5], observations[:, 4])  # [rad]
        rate = observations[:, 6] * scene.speed_scale / scene.box_half_width  # [rad/s]
        return -scene.box_inertia * (self._stiffness * angle + self._damping * rate) / scene.torque_limit


class Baseline(NamedTuple):
    """A policy and the settings that it needs of the environment."""

    policy: Policy
    env_settings: dict[str, Any]
