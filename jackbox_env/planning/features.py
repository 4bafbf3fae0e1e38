"""What rollouts from the present state return, by the exact contact model, and the warm-started plans behind them.

The rollouts start from the state that the ten numbers of an observation tell (:func:`observation.state_of`). So looking
ahead works on both contact models. Where pymunk is the environment's, the exact model is only near to what will happen.
Neither the scene's chirp nor the side forces of a ``Drive`` are foreseen. :class:`jackbox_env.Lookahead` says what is
appended.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from jackbox_env import checks as check
from jackbox_env.observation import BOUNDS, observe, state_of
from jackbox_env.planning.icem import Plans, Search
from jackbox_env.planning.rollouts import play
from jackbox_env.scene import Scene
from jackbox_env.states import Array
from jackbox_env.tasks import Task

Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]

_AHEAD = 3  # torques of the plan that are shown
_MOST_REWARD = 10.0  # mean rewards are clipped there
_MOST_DEVIATION = 5.0
_LEAST = 1e-9  # deviation of returns that counts as none
_MOST_HELD, _MOST_TURNS, _MOST_SAMPLES, _MOST_PIECES = 1000, 999, 100_000, 10_000
_HALF_TURN = 2  # pieces of a scripted turn that speed the box up, and as many that stop it


class Features:
    """What N jacks see when they look ahead. It holds no plans: a look takes the old ones and gives the next.

    Args:
        task: whose rewards are summed, a name or a :class:`jackbox_env.Task`.
        control_dt: control step [s].
        hold: control steps between looks, 1 or more; each torque of a rollout is held as long.
        turns: scripted rollouts, an odd number, or 0 for none.
        samples: rollouts that the plan is improved by in each look, or 0 for no plan.
        pieces: torques of a rollout, so it lasts ``pieces * hold`` control steps; 8 or more.
        follow: whether actions are added to the plan's next torque.
        seed: of the plan's variations.
        num_threads: that play the rollouts; nothing else depends on it.

    Raises:
        TypeError, ValueError: an argument out of its range.
    """

    def __init__(
        self, task: str | Task, control_dt: float, *, hold: int = 5, turns: int = 9, samples: int = 32,
        pieces: int = 32, follow: bool = False, seed: int = 0, num_threads: int | None = None,
    ) -> None:  # fmt: skip
        self.hold = check.whole("hold", hold, at_least=1, at_most=_MOST_HELD)
        self.turns = check.whole("turns", turns, at_least=0, at_most=_MOST_TURNS)
        if self.turns % 2 == 0 and self.turns:
            raise ValueError(f"turns must be odd, for the middle one is no turn, or 0, got {self.turns}")
        pieces = check.whole("pieces", pieces, at_least=8, at_most=_MOST_PIECES)
        self.planned = check.whole("samples", samples, at_least=0, at_most=_MOST_SAMPLES) > 0
        if self.planned and samples < 8:
            raise ValueError(f"samples must be at least 8, or 0 for no plan, got {samples}")
        self.follow = check.flag("follow", follow)
        if follow and not self.planned:
            raise ValueError("follow needs a plan to follow, got samples = 0")
        self._search = Search(
            task, control_dt, repeat=self.hold, knots=pieces, samples=max(2, samples + self.turns),
            elites=max(1, samples // 6), iterations=1, seed=seed, num_threads=num_threads,
        )  # fmt: skip
        self._steps = pieces * self.hold  # control steps of a rollout

    @property
    def high(self) -> Floats:
        """Upper bounds of what is appended, shape (F,)."""
        planned = [_MOST_REWARD] + [1.0] * _AHEAD if self.planned else []
        turned = [_MOST_REWARD, _MOST_REWARD] + [_MOST_DEVIATION] * self.turns if self.turns else []
        return np.array([1.0, *BOUNDS, *turned, *planned], dtype=np.float32)

    @property
    def low(self) -> Floats:
        """Lower bounds of it, shape (F,)."""
        low = -self.high
        low[0] = 0.0
        return low

    def space(self, seen: gym.Space[Any]) -> gym.spaces.Box:
        """The space of an observation with what is appended to it.

        Raises:
            TypeError: it is not the observation of ``JackInBox-v0``.
        """
        if not isinstance(seen, gym.spaces.Box) or seen != gym.spaces.Box(-BOUNDS, BOUNDS):
            raise TypeError(f"looking ahead needs the ten numbers of JackInBox-v0, got observations in {seen}")
        low, high = np.concatenate([seen.low, self.low]), np.concatenate([seen.high, self.high])
        return gym.spaces.Box(low, high, dtype=np.float32)

    def begin(self, count: int) -> Plans:
        """Plans of no torque, for ``count`` jacks."""
        return self._search.begin(count)

    def torques(self, actions: Any, seen: Floats) -> Any:
        """The actions that an environment is given, for those of an agent that has ``seen`` what was appended.

        Shapes (n, 1) and (n, 10 + F), or (1,) and (10 + F,).

        Raises:
            TypeError, ValueError: actions that are no numbers, or of another shape.
        """
        if not self.follow:
            return actions
        planned = seen[..., -_AHEAD : seen.shape[-1] - _AHEAD + 1]
        given = check.array("actions", actions, "hold numbers (clipped to [-1, 1])")
        if given.shape not in (planned.shape, planned.shape[:-1]):
            raise ValueError(f"actions must have shape {planned.shape} or {planned.shape[:-1]}, got {given.shape}")
        corrections = np.clip(given.astype(np.float32).reshape(planned.shape), -1.0, 1.0)
        return np.clip(corrections + planned, -1.0, 1.0)

    def look(self, scenes: list[Scene], observations: Floats, plans: Plans) -> tuple[Floats, Plans]:
        """Return what is appended to observations, shape (n, 10): float32, (n, F); and the plans of the next look.

        Args:
            scenes: one for all, or n of them.
            observations: that the states are read off; each as if its time were 0.
            plans: those of the last look.
        """
        one_for_all = all(one is scenes[0] or one == scenes[0] for one in scenes)
        each, scene = (scenes[:1] * len(observations), scenes[0]) if one_for_all else (scenes, scenes)
        states = np.array([state_of(one, row) for one, row in zip(each, observations.tolist(), strict=True)])
        parts = [self._next_impact(scenes[:1] if one_for_all else scenes, each, states)]
        turned, turns = None, self._turns(each, states)
        if self.planned:
            found, plans = self._search.decide(scene, states, plans, turns)
            turned = found.scripted
        elif self.turns:
            turned, _ = self._search.play(scene, states, turns)
        if turned is not None and self.turns:
            mean, deviation = turned.mean(axis=1) / self._steps, turned.std(axis=1) / self._steps
            apart = (turned / self._steps - mean[:, None]) / np.maximum(deviation, _LEAST)[:, None]
            parts += [mean[:, None], deviation[:, None], apart]
        if self.planned:
            parts += [found.returns[:, None] / self._steps, found.plans[:, :_AHEAD]]
        appended = np.concatenate(parts, axis=1)
        return np.clip(appended, self.low, self.high).astype(np.float32), plans

    def _next_impact(self, scenes: list[Scene], each: list[Scene], states: Array) -> Array:
        """When the next impact comes without torque, in shares of a rollout, 1 for none; what is seen after it."""
        search = self._search
        found = play(
            scenes, states, np.zeros((len(states), search.knots)), search.control_dt, driven=False, impacts=True,
            repeat=search.repeat, until_impact=True, num_threads=search.num_threads,
        )  # fmt: skip
        assert found.impacts is not None
        struck = found.impacts > 0
        first = np.where(struck.any(axis=1), struck.argmax(axis=1) + 1, self._steps)
        after = found.trajectories[:, 1].tolist()
        seen = [observe(one, state) for one, state in zip(each, after, strict=True)]
        return np.concatenate([first[:, None] / self._steps, seen], axis=1)

    def _turns(self, each: list[Scene], states: Array) -> Array:
        """Torques that turn each box by so much and stop it, in units of the limit, shape (n, turns, pieces).

        The box is sped up for ``_HALF_TURN`` pieces and stopped in as many. The furthest turns are those that the
        torque's limit can make of a box at rest.
        """
        search = self._search
        half = _HALF_TURN * search.repeat * search.control_dt  # [s]
        strongest = np.array([one.torque_limit / one.box_inertia for one in each])[:, None]  # [rad/s^2]
        share = np.linspace(-1.0, 1.0, self.turns) if self.turns > 1 else np.zeros(self.turns)
        omega = states[:, 8:9]
        first = share * strongest - 1.5 * omega / half  # so that the box has turned by share * strongest * half^2
        last = -omega / half - first
        torques = np.zeros((len(states), self.turns, search.knots))
        torques[:, :, :_HALF_TURN] = (first / strongest)[:, :, None]
        torques[:, :, _HALF_TURN : 2 * _HALF_TURN] = (last / strongest)[:, :, None]
        return np.clip(torques, -1.0, 1.0)


class WarmStart:
    """The warm-started plans of N environments side by side, and what their agents see.

    After :meth:`torques` the next call must be :meth:`seen`. If a step fails in between, only a reset leads on.
    """

    def __init__(self, features: Features, count: int) -> None:
        self.features = features
        self._plans, self._anew = features.begin(count), np.ones(count, dtype=np.bool_)
        self._last: Floats | None = None  # what was seen last, (N, 10 + F)

    def start(self, chosen: Flags) -> None:
        """The next observations of the ``chosen`` environments, shape (N,), are of an episode's start."""
        self._anew = self._anew | chosen

    def seen(self, scenes: list[Scene], observations: Floats, chosen: Flags | None = None) -> Floats:
        """Observations, shape (N, 10), with what is appended; the plans are warm-started.

        Only those of the ``chosen`` environments, shape (N,), if it is given; the others show what they showed.
        """
        count = len(observations)
        if chosen is None or self._last is None:
            chosen = np.ones(count, dtype=np.bool_)
            self._last = np.zeros((count, observations.shape[1] + len(self.features.high)), dtype=np.float32)
        new, numbers = np.flatnonzero(self._anew), np.flatnonzero(chosen)
        plans = self._plans.replaced(new, self.features.begin(len(new)))
        own = [scenes[number] for number in numbers.tolist()] if len(scenes) > 1 else scenes
        last, self._last = self._last, None
        appended, next_plans = self.features.look(own, observations[numbers], plans.of(numbers))
        self._plans, self._anew = plans.replaced(numbers, next_plans), np.zeros(count, dtype=np.bool_)
        last[numbers] = np.concatenate([observations[numbers], appended], axis=1)
        self._last = last
        return last.copy()

    def last_seen(self, scenes: list[Scene], observations: Floats, numbers: NDArray[np.int64]) -> Floats:
        """The last observations of some environments' episodes, shape (k, 10), with what is appended."""
        own = [scenes[number] for number in numbers.tolist()] if len(scenes) > 1 else scenes
        appended, _ = self.features.look(own, observations, self._plans.of(numbers))
        return np.concatenate([observations, appended], axis=1)

    def torques(self, actions: Any, alone: bool = False) -> Any:
        """What the environments are given for actions, shape (N, 1), or (1,) for one that is ``alone``.

        Raises:
            RuntimeError: there was no reset yet, or none since a step failed.
            TypeError, ValueError: unusable actions.
        """
        if self._last is None:
            raise RuntimeError("step must come after a reset, got none yet or none since a step failed")
        torques = self.features.torques(actions, self._last[0] if alone else self._last)
        self._last = None
        return torques
