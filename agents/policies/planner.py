"""Planners: at each tenth of a second they play many sequences of torques by the exact model and keep the best."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.policies.playing import Manner, Playable, Playing, decide_now_and_then
from agents.policies.scripted import Actions
from agents.policies.value import Value, ValuedSearch
from agents.settings import EnvSettings
from jackbox_env import Scene, Task
from jackbox_env import checks as check
from jackbox_env.observation import state_of
from jackbox_env.planning.features import Features, LookaheadOptions
from jackbox_env.planning.icem import Plans, Search

DECISION = 0.1  # [s] between decisions, as the settings here were tried
VALUED_KNOTS = 20  # of a plan whose end has a value


def decision_steps(settings: EnvSettings) -> int:
    """Control steps between decisions."""
    return max(1, round(DECISION / settings.control_dt))


class Planner:
    """A policy with Stable-Baselines3's ``predict`` that carries on plans by :mod:`jackbox_env.planning.icem`.

    It reads the state off the ten numbers of the observation, so it plays on both contact models; on pymunk its model
    is not the environment's. Side forces of the scene's drive are not foreseen.

    Args:
        scene: that it plans in.
        task: whose rewards it sums, a name or a :class:`jackbox_env.Task`.
        control_dt: the environment's control step [s].
        repeat: control steps that each torque of a plan is repeated for; a decision is made as often.
        knots: torques of a plan, 2 or more.
        samples: candidates in each iteration, 2 or more.
        elites: best candidates that make the next mean, 1 to ``samples``.
        iterations: of each decision.
        seed: of the candidates. An environment's plan does not depend on those beside it.
        num_threads: that play them; the plans do not depend on it.
        value: what the last state of a plan is worth, added to its rewards; None: nothing.

    Raises:
        TypeError, ValueError: an argument out of its range.
    """

    def __init__(
        self, scene: Scene, task: str | Task = "juggle", control_dt: float = 0.02, *, repeat: int = 5, knots: int = 32,
        samples: int = 256, elites: int = 20, iterations: int = 3, seed: int = 0, num_threads: int | None = 1,
        value: Value | None = None,
    ) -> None:  # fmt: skip
        self._scene = scene.changed(drive=None)
        settings: dict[str, Any] = {
            "repeat": repeat, "knots": knots, "samples": samples, "elites": elites, "iterations": iterations,
            "seed": seed, "num_threads": num_threads,
        }  # fmt: skip
        if value is not None and not isinstance(value, Value):
            raise TypeError(f"value must be a Value or None, got {check.shown(value)}")
        self._search = (
            ValuedSearch(value, task, control_dt, **settings) if value else Search(task, control_dt, **settings)
        )

    def predict(
        self, observation: Any, state: Playing | None = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Actions, Playing]:
        """Return the actions, shape (n, 1) or (1,), and what the next call takes as ``state``.

        Without ``state`` each call plans from nothing. Where ``episode_start`` is set, a plan is begun anew.

        Raises:
            ValueError: a state of another number of environments.
        """
        return decide_now_and_then(
            self._decide, self._search.begin, self._search.repeat, observation, state, episode_start
        )

    def _decide(self, seen: NDArray[Any], plans: Plans) -> tuple[NDArray[Any], Plans]:
        """The first torques of the best plans, shape (k, 1), and the plans of the next decision."""
        states = np.array([state_of(self._scene, row) for row in seen.tolist()])
        found, next_plans = self._search.decide(self._scene, states, plans)
        return found.plans[:, :1], next_plans


class PlanAlone(Playable):
    """A policy that follows the plan of 32 samples that ``Lookahead`` shows, and corrects nothing.

    Args:
        settings: of the environment that it plays in.
    """

    def __init__(self, settings: EnvSettings) -> None:
        repeat = decision_steps(settings)
        options = LookaheadOptions(repeat, samples=32, follow=True, num_threads=1)
        features = Features(settings.task, settings.control_dt, options)
        self.manner = Manner(repeat, features, Scene.of(settings.scene_fields))

    def act(self, seen: NDArray[Any]) -> Actions:
        """No correction, see :class:`Playable`."""
        return np.zeros((len(seen), 1), np.float32)
