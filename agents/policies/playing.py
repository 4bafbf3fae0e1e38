"""How a policy plays in the ordinary environment: it holds its actions, and looks ahead or aims if it was trained so.

A policy that decides every control step can hardly tell what one of its actions did. One that holds each action for a
few steps explores further and looks further ahead. The environment that it plays in still asks it at every control
step, and shows it ten numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.settings import TrainSettings
from jackbox_env import Scene
from jackbox_env.observation import BOUNDS, state_of
from jackbox_env.planning.features import Features, LookaheadOptions
from jackbox_env.planning.icem import Plans
from jackbox_env.planning.landing_control import aim


class Playing(NamedTuple):
    """What a policy carries from call to call, for n environments."""

    actions: NDArray[np.float32]  # (n, 1), or (n, 2) of a policy that aims
    left: NDArray[np.int64]  # (n,) for how many more calls each action holds
    plans: Plans | None  # of a policy that looks ahead


class Manner(NamedTuple):
    """How a policy plays."""

    hold: int = 1  # calls that each action is held for
    features: Features | None = None  # by which it looks ahead
    scene: Scene = Scene()  # that the rollouts are played in, or that it aims in
    aims: float | None = None  # control step [s] of a policy whose actions say how the box meets the jack


def manner_of(settings: TrainSettings) -> Manner:
    """How a policy plays that was trained by these settings."""
    features = None
    if settings.lookahead:
        options = LookaheadOptions(settings.hold, samples=settings.lookahead, follow=True, num_threads=1)
        features = Features(settings.task, settings.control_dt, options)
    aims = settings.control_dt if settings.landing else None
    return Manner(settings.hold, features, Scene.of(settings.scene_fields), aims)


class Playable:
    """Stable-Baselines3's ``predict`` for a policy that plays in a manner; it always does the same."""

    manner: Manner

    def act(self, seen: NDArray[Any]) -> NDArray[np.float32]:
        """Actions, shape (n, 1), for observations as in training, shape (n, k)."""
        raise NotImplementedError

    def predict(
        self, observation: Any, state: Playing | None = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[NDArray[Any], Playing]:
        """Return actions and the state for the next call, see :func:`play`."""
        return play(self.manner, self.act, observation, state, episode_start)


def ten_numbers(observation: Any) -> NDArray[Any]:
    """Observations of JackInBox-v0 as rows, shape (n, 10).

    Raises:
        ValueError: another shape.
    """
    rows = np.atleast_2d(np.asarray(observation))
    if rows.ndim != 2 or rows.shape[1:] != BOUNDS.shape:
        raise ValueError(f"observation must have shape (n, 10) or (10,), got {np.shape(observation)}")
    return rows


def starting(episode_start: Any, count: int) -> NDArray[np.int64]:
    """Where an episode starts, as numbers of environments.

    Raises:
        ValueError: ``episode_start`` is not of so many environments.
    """
    starts = np.asarray(episode_start, dtype=np.bool_)
    if starts.shape not in ((), (1,), (count,)):
        raise ValueError(f"episode_start must have shape ({count},), as there are observations, got {starts.shape}")
    return np.flatnonzero(np.broadcast_to(starts, count))


def play(
    manner: Manner, choose: Callable[[NDArray[Any]], NDArray[Any]], observation: Any, state: Playing | None,
    episode_start: Any,
) -> tuple[NDArray[Any], Playing]:  # fmt: skip
    """Actions of a policy that plays in a ``manner``, and the state for the next call: see :func:`decide_now_and_then`.

    ``choose`` gives its actions, shape (k, 1), for k observations as in training; (k, 2) where the policy aims.
    """
    features, width = manner.features, 1 if manner.aims is None else 2

    def decide(seen: NDArray[Any], plans: Plans | None) -> tuple[NDArray[Any], Plans | None]:
        if features is None or plans is None:
            return choose(seen), plans
        appended, next_plans = features.look([manner.scene], seen, plans)
        seen = np.concatenate([seen, appended], axis=1)
        return features.torques(choose(seen), seen), next_plans

    begin = features.begin if features else None
    actions, state = decide_now_and_then(decide, begin, manner.hold, observation, state, episode_start, width)
    if manner.aims is not None:
        states = np.array([state_of(manner.scene, row) for row in ten_numbers(observation).tolist()])
        torques = aim(manner.scene, manner.aims, actions, len(states))(states).astype(np.float32)
        actions = torques[:, None] if np.ndim(observation) == 2 else torques
    return actions, state


def decide_now_and_then(
    decide: Callable[[NDArray[Any], Any], tuple[NDArray[Any], Any]], begin: Callable[[int], Plans] | None, repeat: int,
    observation: Any, state: Playing | None, episode_start: Any, width: int = 1,
) -> tuple[NDArray[Any], Playing]:  # fmt: skip
    """Return actions, shape (n, 1) for observations (n, 10) or (1,) for (10,), and the state for the next call.

    Args:
        decide: actions, shape (k, 1), and the next plans, for k observations and their plans.
        begin: plans for so many new episodes; None: there are none.
        repeat: calls that an action is repeated for.
        observation: of one environment or of several; it counts where an action is chosen.
        state: what the last call returned; None: every environment chooses.
        episode_start: shape (n,), where an episode starts; an action is chosen there, with a plan begun anew; None:
            nowhere.
        width: numbers of an action.

    Raises:
        ValueError: a state of another number of environments.
    """
    rows = ten_numbers(observation)
    count = len(rows)
    if state is None:
        plans = begin(count) if begin else None
        state = Playing(np.zeros((count, width), np.float32), np.zeros(count, np.int64), plans)
    if len(state.left) != count:
        raise ValueError(f"state must be that of {count} environments, as observation is, got {len(state.left)}")
    actions, left, plans = state.actions.copy(), state.left.copy(), state.plans
    if episode_start is not None:
        new = starting(episode_start, count)
        left[new] = 0
        if begin and plans:
            plans = plans.replaced(new, begin(len(new)))
    due = np.flatnonzero(left == 0)
    if len(due):
        actions[due], next_plans = decide(rows[due], plans and plans.of(due))
        plans, left[due] = plans and plans.replaced(due, next_plans), repeat
    return (actions.copy() if np.ndim(observation) == 2 else actions[0].copy()), Playing(actions, left - 1, plans)
