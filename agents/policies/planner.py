"""Planners: every 0.1 s they simulate many torque sequences by the exact model and follow the best."""

from __future__ import annotations

from typing import Any

import numpy as np

from agents.policies.icem import Plans, PlanSearch
from agents.policies.network import SHIPPED
from agents.policies.scripted import PLAIN, Actions, PolicyWithEnv, as_rows, state_of, torques
from agents.policies.value import Value, ValuedSearch, read_value
from jackbox_env import Scene, Task
from jackbox_env.model.observation import BOUNDS
from jackbox_env.tools import checks as check

DECISION_INTERVAL = 0.1  # [s] that the settings here were tuned for

# What earned most on each task in trials, within 10 ms and within 1 ms of a decision; other tasks: as rattle.
SEARCHES: dict[str, dict[str, Any]] = {
    "juggle": {"knots": 20, "samples": 256, "elites": 20, "iterations": 3},
    "spin": {"knots": 12, "samples": 256, "elites": 20, "iterations": 4},
    "rattle": {"knots": 32, "samples": 128, "elites": 6, "iterations": 3},
}
FAST_SEARCHES: dict[str, dict[str, Any]] = {
    "juggle": {"knots": 20, "samples": 64, "elites": 6, "iterations": 1},
    "spin": {"knots": 8, "samples": 64, "elites": 8, "iterations": 2},
    "rattle": {"knots": 20, "samples": 48, "elites": 5, "iterations": 1},
}
_KNOTS_WITHOUT_VALUE = 32  # if a task's value was trained for another scene or control step


def decision_steps(control_dt: float) -> int:
    """Control steps between decisions."""
    return max(1, round(DECISION_INTERVAL / control_dt))


class Planner:
    """A policy with Stable-Baselines3's ``predict`` that warm-starts its plans, by :mod:`agents.policies.icem`.

    It computes the state from the observation, so it plays on both contact models; on pymunk its model is not the
    environment's. It ignores side forces of the scene's drive. Its environment observes the ten numbers, and repeats a
    torque for ``repeat`` control steps.

    Args:
        scene: that it plans in.
        task: whose rewards are summed, a name or a :class:`jackbox_env.Task`.
        control_dt: the environment's control step [s].
        repeat: control steps of each torque of a plan, and between decisions.
        knots: torques of a plan, 2 or more.
        samples: candidates in each iteration, 2 or more.
        elites: best candidates that make the next mean, 1 to ``samples``.
        iterations: of each decision.
        seed: of the candidates. An environment's plan does not depend on other environments.
        num_threads: that simulate them; the plans do not depend on it.
        value: of the last state of a plan, added to its rewards; None: none.

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
        self.search = (
            ValuedSearch(value, task, control_dt, **settings) if value else PlanSearch(task, control_dt, **settings)
        )
        self.repeat = self.search.repeat

    def predict(
        self, observation: Any, state: Plans | None = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Actions, Plans]:
        """The first torques of the best plans, and the plans one decision later; see :class:`.scripted.Policy`.

        Raises:
            ValueError: another shape, or a state or ``episode_start`` of another number of environments.
        """
        rows = as_rows(observation, len(BOUNDS))
        count = len(rows)
        plans = self.search.begin(count) if state is None else state
        if len(plans.means) != count:
            raise ValueError(f"state must be that of {count} environments, as observation is, got {len(plans.means)}")
        starts = np.asarray(False if episode_start is None else episode_start, dtype=np.bool_)
        if starts.shape not in ((), (1,), (count,)):
            raise ValueError(f"episode_start must have shape ({count},), as there are observations, got {starts.shape}")
        new = np.flatnonzero(np.broadcast_to(starts, count))
        plans = plans.replaced(new, self.search.begin(len(new)))
        states = np.array([state_of(self._scene, row) for row in rows.tolist()])
        best, _, plans = self.search.decide(self._scene, states, plans)
        actions = torques(best[:, 0])
        return actions if np.ndim(observation) == 2 else actions[0], plans

    @property
    def in_env(self) -> PolicyWithEnv:
        """The planner, with what its environment observes and does."""
        return PolicyWithEnv(self, {**PLAIN, "action_repeat": self.repeat})


def planner_for(keywords: dict[str, Any], seed: int = 0, searches: dict[str, dict[str, Any]] = SEARCHES) -> Planner:
    """The planner of an environment of these keywords, with the shipped value if there is one for its scene and task.

    Raises:
        FileNotFoundError, ValueError: that value is damaged.
    """
    task, control_dt, scene = keywords["task"], keywords["control_dt"], Scene.of(keywords["scene"])
    search = {"seed": seed, **searches.get(str(task), searches["rattle"])}
    if isinstance(task, str) and (folder := SHIPPED / f"{task}-value").is_dir():
        value = read_value(folder)
        stored = value.settings
        made_for = stored.task, stored.control_dt, Scene.of(stored.scene_fields).changed(drive=None)
        suits = made_for == (task, control_dt, scene.changed(drive=None))
        search |= {"value": value} if suits else {"knots": _KNOTS_WITHOUT_VALUE}
    return Planner(scene, task, control_dt, repeat=decision_steps(control_dt), **search)
