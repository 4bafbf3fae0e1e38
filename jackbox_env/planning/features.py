"""Look-ahead features: returns of rollouts on the exact model, appended to observations, and their warm-started plans.

``wrappers.py`` appends them to the observations of an environment; :class:`jackbox_env.Lookahead` lists them.
The rollouts start from the state that the ten numbers of an observation determine (:func:`observation.state_of`), so
they work for both contact models. For a pymunk environment they are an approximation. They ignore the scene's chirp and
the side forces of a ``Drive``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from jackbox_env import checks as check
from jackbox_env.observation import BOUNDS, observe, state_of
from jackbox_env.planning.icem import Plans, Search
from jackbox_env.planning.rollouts import RolloutOptions, run_rollouts
from jackbox_env.scene import Scene
from jackbox_env.states import OMEGA_BOX, Array, Floats
from jackbox_env.tasks import Task

_AHEAD = 3  # torques of the plan that are observed
_MOST_REWARD = 10.0  # bound of mean rewards, which are clipped
_MOST_DEVIATION = 5.0
_LEAST = 1e-9  # smaller deviations of returns count as 0
_HALF = 2  # knots of a manoeuvre that speed the box up, and as many that stop it
_RANGES = {  # of the options, with the names of their keyword arguments
    "repeat": ("hold", 1, 1000),
    "manoeuvres": ("turns", 0, 999),
    "samples": ("samples", 0, 100_000),
    "knots": ("pieces", 8, 10_000),
}


@dataclass(frozen=True)
class LookaheadOptions:
    """Number, length and kind of the rollouts.

    Errors name the keyword arguments of :class:`jackbox_env.Lookahead`. :class:`Search` checks the last two.

    Raises:
        TypeError, ValueError: an option out of its range.
    """

    repeat: int = 5  # control steps between decisions, and of each torque of a rollout (``hold``)
    manoeuvres: int = 9  # scripted rollouts (``turns``), an odd number, or 0
    samples: int = 32  # rollouts that improve the plan in each decision, 8 or more, or 0: no plan
    knots: int = 32  # torques of a rollout (``pieces``), so it lasts ``knots * repeat`` control steps
    follow: bool = False  # whether actions are added to the plan's next torque
    seed: int = 0  # of the plan's variations
    num_threads: int | None = None  # for the rollouts; results do not depend on it

    def __post_init__(self) -> None:
        for field, (name, least, most) in _RANGES.items():
            object.__setattr__(self, field, check.whole(name, getattr(self, field), at_least=least, at_most=most))
        if self.manoeuvres % 2 == 0 and self.manoeuvres:
            raise ValueError(f"turns must be odd or 0, got {self.manoeuvres}")
        if 0 < self.samples < 8:
            raise ValueError(f"samples must be at least 8, or 0 for no plan, got {self.samples}")
        if check.flag("follow", self.follow) and not self.samples:
            raise ValueError("follow needs a plan, so samples must be at least 8, got 0")


class Features:
    """Look-ahead features of N agents. It stores no plans: :meth:`compute` maps the last plans to the next.

    Args:
        task: whose rewards are summed, a name or a :class:`jackbox_env.Task`.
        control_dt: control step [s].
        options: of the rollouts.

    Raises:
        TypeError, ValueError: an argument out of its range.
    """

    def __init__(self, task: str | Task, control_dt: float, options: LookaheadOptions) -> None:
        self.options, manoeuvres, samples = options, options.manoeuvres, options.samples
        self._search = Search(
            task, control_dt, repeat=options.repeat, knots=options.knots, samples=max(2, samples + manoeuvres),
            elites=max(1, samples // 6), iterations=1, seed=options.seed, num_threads=options.num_threads,
        )  # fmt: skip
        self._steps = options.knots * options.repeat  # control steps of a rollout
        scripted = [_MOST_REWARD, _MOST_REWARD] + [_MOST_DEVIATION] * manoeuvres if manoeuvres else []
        planned = [_MOST_REWARD] + [1.0] * _AHEAD if samples else []
        self.high = np.array([1.0, *BOUNDS, *scripted, *planned], dtype=np.float32)  # (F,) bounds of what is appended
        self.low = np.append(np.float32(0.0), -self.high[1:])

    def begin(self, count: int) -> Plans:
        """Plans of no torque, for ``count`` jacks."""
        return self._search.begin(count)

    def torques(self, actions: Any, seen: Floats) -> Any:
        """The environment's actions for the actions of an agent whose last observation was ``seen``.

        Shapes (n, 1) and (n, 10 + F), or (1,) and (10 + F,).

        Raises:
            TypeError, ValueError: actions that are not numbers, or of another shape.
        """
        if not self.options.follow:
            return actions
        planned = seen[..., -_AHEAD : seen.shape[-1] - _AHEAD + 1]
        numbers = check.array("actions", actions, "be numbers (clipped to [-1, 1])")
        if numbers.shape not in (planned.shape, planned.shape[:-1]):
            raise ValueError(f"actions must have shape {planned.shape} or {planned.shape[:-1]}, got {numbers.shape}")
        corrections = np.clip(numbers.astype(np.float32).reshape(planned.shape), -1.0, 1.0)
        return np.clip(corrections + planned, -1.0, 1.0)

    def compute(self, scenes: list[Scene], observations: Floats, plans: Plans) -> tuple[Floats, Plans]:
        """Return the features to append to observations, shape (n, 10): float32, (n, F); and the next plans.

        Args:
            scenes: one for all, or n of them.
            observations: determine the states; the time counts as 0.
            plans: those of the last decision.
        """
        one_for_all = all(one is scenes[0] or one == scenes[0] for one in scenes)
        each, scene = (scenes[:1] * len(observations), scenes[0]) if one_for_all else (scenes, scenes)
        states = np.array([state_of(one, row) for one, row in zip(each, observations.tolist(), strict=True)])
        parts = [self._next_impact(scenes[:1] if one_for_all else scenes, each, states)]
        manoeuvres = self._manoeuvres(each, states)
        if self.options.samples:
            decision, plans = self._search.decide(scene, states, plans, manoeuvres)
            returns = decision.scripted
        elif self.options.manoeuvres:
            returns, _ = self._search.evaluate(scene, states, manoeuvres)
        if self.options.manoeuvres:
            mean = returns.mean(axis=1, keepdims=True) / self._steps
            deviation = returns.std(axis=1, keepdims=True) / self._steps
            parts += [mean, deviation, (returns / self._steps - mean) / np.maximum(deviation, _LEAST)]
        if self.options.samples:
            parts += [decision.returns[:, None] / self._steps, decision.plans[:, :_AHEAD]]
        appended = np.concatenate(parts, axis=1)
        return np.clip(appended, self.low, self.high).astype(np.float32), plans

    def _next_impact(self, scenes: list[Scene], each: list[Scene], states: Array) -> Array:
        """Time of the next impact without torque over a rollout's duration, 1: none; and the observation after it."""
        search = self._search
        options = RolloutOptions(
            side_forces=False, impacts=True, repeat=search.repeat, until_impact=True, num_threads=search.num_threads
        )
        played = run_rollouts(scenes, states, np.zeros((len(states), search.knots)), search.control_dt, options=options)
        assert played.impacts is not None
        struck = played.impacts > 0
        steps = np.where(struck.any(axis=1), struck.argmax(axis=1) + 1, self._steps)
        after = played.trajectories[:, 1].tolist()
        observed = [observe(one, state) for one, state in zip(each, after, strict=True)]
        return np.concatenate([steps[:, None] / self._steps, observed], axis=1)

    def _manoeuvres(self, each: list[Scene], states: Array) -> Array:
        """Torques that turn each box and stop it, in units of the limit, shape (n, manoeuvres, knots).

        The box is sped up for ``_HALF`` knots and stopped in as many. The widest turns are those that the torque limit
        allows from rest.
        """
        search, count = self._search, self.options.manoeuvres
        half = _HALF * search.repeat * search.control_dt  # [s]
        strongest = np.array([one.torque_limit / one.box_inertia for one in each])[:, None]  # [rad/s^2]
        share = np.linspace(-1.0, 1.0, count) if count > 1 else np.zeros(count)
        omega = states[:, OMEGA_BOX, None]
        first = share * strongest - 1.5 * omega / half  # so that the box has turned by share * strongest * half^2
        last = -omega / half - first
        torques = np.zeros((len(states), count, search.knots))
        torques[:, :, :_HALF] = (first / strongest)[:, :, None]
        torques[:, :, _HALF : 2 * _HALF] = (last / strongest)[:, :, None]
        return np.clip(torques, -1.0, 1.0)
