"""A planner: at each tenth of a second it plays many sequences of torques by the exact model and keeps the best."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.policies import Actions
from jackbox_env import Scene, Task
from jackbox_env.observation import state_of
from jackbox_env.plans import Plans, Search
from jackbox_env.states import Array

DECISION = 0.1  # [s] between decisions, as the settings here were tried


class Planning(NamedTuple):
    """What the planner carries on, of N environments."""

    steps: NDArray[np.int64]  # (N,) control steps since the episode's start
    plans: Plans
    actions: Array  # (N,) held until the next decision


class Planner:
    """A policy with Stable-Baselines3's ``predict`` that carries on plans by :mod:`jackbox_env.plans`.

    It reads the state off the ten numbers of the observation, so it plays on both contact models; on pymunk its model
    is not the environment's. Side forces of the scene's drive are not foreseen.

    Args:
        scene: that it plans in.
        task: whose rewards it sums, a name or a :class:`jackbox_env.Task`.
        control_dt: the environment's control step [s].
        piece: control steps that each torque of a plan is held for; a decision is made as often.
        pieces: of a plan, 2 or more.
        samples: candidates in each iteration, 2 or more.
        elites: best candidates that make the next mean, 1 to ``samples``.
        iterations: of each decision.
        seed: of the candidates. An environment's plan does not depend on those beside it.
        num_threads: that play them; the plans do not depend on it.

    Raises:
        TypeError, ValueError: an argument out of its range.
    """

    def __init__(
        self, scene: Scene, task: str | Task = "juggle", control_dt: float = 0.02, *, piece: int = 5, pieces: int = 32,
        samples: int = 256, elites: int = 20, iterations: int = 3, seed: int = 0, num_threads: int | None = 1,
    ) -> None:  # fmt: skip
        self._scene = scene.changed(drive=None)
        self._search = Search(
            task, control_dt, piece=piece, pieces=pieces, samples=samples, elites=elites, iterations=iterations,
            seed=seed, num_threads=num_threads,
        )  # fmt: skip

    def predict(
        self, observation: Any, state: Planning | None = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Actions, Planning]:
        """Return the actions, shape (n, 1) or (1,), and what the next call takes as ``state``.

        Without ``state`` each call plans from nothing. Where ``episode_start`` is set, a plan is begun anew.

        Raises:
            ValueError: a state of another number of environments.
        """
        rows = np.atleast_2d(np.asarray(observation, dtype=np.float64))
        count = len(rows)
        if state is not None and len(state.steps) != count:
            raise ValueError(f"state must be that of {count} environments, as observation is, got {len(state.steps)}")
        fresh = Planning(np.zeros(count, dtype=np.int64), self._search.begin(count), np.zeros(count))
        if state is None:
            state = fresh
        elif episode_start is not None:
            state = _where(np.broadcast_to(np.asarray(episode_start, dtype=np.bool_), count), fresh, state)
        due = np.flatnonzero(state.steps % self._search.piece == 0)
        actions, plans = state.actions.copy(), Plans(*(part.copy() for part in state.plans))
        if len(due):
            states = np.array([state_of(self._scene, rows[number].tolist()) for number in due.tolist()])
            found, carried_on = self._search.decide(self._scene, states, Plans(*(part[due] for part in plans)))
            actions[due] = found.plans[:, 0]
            for part, new in zip(plans, carried_on, strict=True):
                part[due] = new
        held = actions.astype(np.float32)[:, None]
        return (held if np.ndim(observation) == 2 else held[0]), Planning(state.steps + 1, plans, actions)


def _where(chosen: NDArray[np.bool_], fresh: Planning, old: Planning) -> Planning:
    """The fresh plans where ``chosen``, the old ones elsewhere."""
    steps, actions = np.where(chosen, fresh.steps, old.steps), np.where(chosen, fresh.actions, old.actions)
    plans = (
        np.where(chosen.reshape(-1, *[1] * (new.ndim - 1)), new, kept)
        for new, kept in zip(fresh.plans, old.plans, strict=True)
    )
    return Planning(steps, Plans(*plans), actions)
