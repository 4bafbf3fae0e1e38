"""How trained policies act in the ordinary environment: as under the wrappers of :mod:`jackbox_env.sb3_wrappers`."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.policies.landing_features import struck
from agents.policies.playing import Actions, RepeatingPolicy
from jackbox_env import Scene
from jackbox_env.landing import ANGLE, RATE, torques
from jackbox_env.observation import state_of
from jackbox_env.planning.features import Features
from jackbox_env.planning.icem import Plans


class Acting(NamedTuple):
    """How a policy acts, and where."""

    scene: Scene
    control_dt: float  # [s]
    repeat: int = 1  # control steps of an action, at most
    resting: int = 0  # control steps after which an impact ends an action in any case; 0: impacts do not end it
    landing: bool = False  # actions are the box's angle and rate at the landing, not torques
    features: Features | None = None  # of a lookahead, which are observed too


class TrainedPolicy(RepeatingPolicy):
    """A policy with Stable-Baselines3's ``predict``; subclasses define the actions."""

    def __init__(self, acting: Acting) -> None:
        self._acting, self.action_size = acting, 2 if acting.landing else 1
        self.repeat, self.resting = acting.repeat, acting.resting

    def act(self, observations: NDArray[Any]) -> Actions:
        """Actions, shape (n, action_size), for observations as in training, shape (n, 10 or more)."""
        raise NotImplementedError

    def begin(self, count: int) -> Plans | None:
        """Plans of no torque with a lookahead, else None."""
        return self._acting.features.begin(count) if self._acting.features else None

    def decide(self, observations: NDArray[Any], plans: Any) -> tuple[NDArray[Any], Any]:
        """The actions; with a lookahead that is followed they correct its plans."""
        features = self._acting.features
        if features is None:
            return self.act(observations), None
        appended, next_plans = features.compute([self._acting.scene], observations, plans)
        extended = np.concatenate([observations, appended], axis=1)
        return features.torques(self.act(extended), extended), next_plans

    def torques(self, actions: Actions, observations: NDArray[Any]) -> Actions:
        """The actions; if they are landings of the box, the torques that steer to them now."""
        if not self._acting.landing:
            return actions
        states = np.array([state_of(self._acting.scene, row) for row in observations.tolist()])
        targets = actions.astype(np.float64) * (ANGLE, RATE)
        return torques(self._acting.scene, states, targets, self._acting.control_dt).astype(np.float32)[:, None]

    def struck(self, before: NDArray[Any], after: NDArray[Any]) -> NDArray[np.bool_]:
        """Whether the jack struck a wall between observations of successive control steps, shape (n,)."""
        return struck(self._acting.scene, self._acting.control_dt, before, after)
