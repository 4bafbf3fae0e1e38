"""Warm-started plans of torques, improved in each decision by simulating many variations of them.

iCEM, the improved cross-entropy method (Pinneri et al. 2020, arXiv:2008.06389): coloured noise around the last plan,
the best candidates make the next mean, and some of them are tried again. All candidates of an iteration are simulated
in one compiled call, which raises JackLostError if one of them cannot be followed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jackbox_env.model.scene import Scene
from jackbox_env.model.states import Array
from jackbox_env.model.tasks import Task, task_of
from jackbox_env.planning import card
from jackbox_env.planning.rollouts import RolloutOptions, run_rollouts
from jackbox_env.simulators.exact import ensure_compiled
from jackbox_env.tools import checks as check

_COLOUR = 2.0  # the noise's power falls with this power of the frequency
_SPREAD = 0.5  # standard deviation of the first candidates, in torque limits
_REUSED = 0.3  # share of the elites that are tried again
_SMOOTHING = 0.1  # share of the old mean and deviation in the new ones


class Plans(NamedTuple):
    """The warm-started plans of N jacks."""

    means: Array  # (N, knots) torques in units of the limit
    elites: Array  # (N, reused, knots) the best candidates, tried again
    decisions: NDArray[np.int64]  # (N,) made since the plan began

    def replaced(self, numbers: NDArray[np.int64], plans: Plans) -> Plans:
        """All plans, with those of some jacks replaced."""
        parts = self.means.copy(), self.elites.copy(), self.decisions.copy()
        for part, new in zip(parts, plans, strict=True):
            part[numbers] = new
        return Plans(*parts)


class PlanSearch:
    """Improves plans by iCEM.

    Args:
        task: whose rewards are summed, a name or a :class:`jackbox_env.Task`.
        control_dt: control step [s].
        repeat: control steps of each torque of a plan, and between decisions.
        knots: torques of a plan, 2 or more.
        samples: candidates in each iteration, 2 or more.
        elites: best candidates that make the next mean, 1 to ``samples``.
        iterations: of each decision.
        seed: of the candidates. A plan depends on it and on its own states, not on other plans.
        num_threads: that simulate them; the plans do not depend on it.
        device: that simulates them, as of ``rollout``; the plans do not depend on it.

    Raises:
        TypeError, ValueError: an argument out of its range.
    """

    def __init__(
        self, task: str | Task, control_dt: float, *, repeat: int, knots: int, samples: int, elites: int,
        iterations: int, seed: int = 0, num_threads: int | None = None, device: str | None = None,
    ) -> None:  # fmt: skip
        self.task, self.control_dt = task_of(task, "task"), check.real("control_dt", control_dt, above=0.0)
        self.repeat = check.whole("repeat", repeat, at_least=1)
        self.knots = check.whole("knots", knots, at_least=2)
        self.samples = check.whole("samples", samples, at_least=2)
        self.elites = check.whole("elites", elites, at_least=1, at_most=samples)
        self.iterations = check.whole("iterations", iterations, at_least=1)
        self.seed = check.whole("seed", seed, at_least=0)
        self.num_threads = None if num_threads is None else check.whole("num_threads", num_threads, at_least=1)
        self.device = card.checked(device)
        self.reused = min(max(1, round(_REUSED * elites)), samples - 1)
        ensure_compiled()

    def begin(self, count: int) -> Plans:
        """Plans of no torque, for ``count`` jacks."""
        elites = np.zeros((count, self.reused, self.knots))
        return Plans(np.zeros((count, self.knots)), elites, np.zeros(count, dtype=np.int64))

    def decide(self, scene: Scene, states: Array, plans: Plans) -> tuple[Array, Array, Plans]:
        """Improve plans from states.

        Args:
            scene: of all.
            states: shape (n, 12).
            plans: the last ones, of n jacks.

        Returns:
            The best torques over the limit, (n, knots), their sums of rewards, (n,), and the plans one knot later.
        """
        count = len(states)
        means, elites, spreads = plans.means, plans.elites, np.full((count, self.knots), _SPREAD)
        for iteration in range(self.iterations):
            candidates = means[:, None] + self._noise(plans.decisions, iteration) * spreads[:, None]
            candidates[:, 0], candidates[:, 1 : 1 + self.reused] = means, elites
            candidates = np.clip(candidates, -1.0, 1.0)
            returns, _ = self.evaluate(scene, states, candidates)
            order = np.argsort(-returns, axis=1, kind="stable")[:, : self.elites]
            best = np.take_along_axis(candidates, order[:, :, None], axis=1)
            elites = best[:, : self.reused]
            means = (1.0 - _SMOOTHING) * best.mean(axis=1) + _SMOOTHING * means
            spreads = (1.0 - _SMOOTHING) * best.std(axis=1) + _SMOOTHING * spreads
        last = np.zeros((count, 1))
        new = self._noise(plans.decisions, self.iterations)[:, : self.reused, :1] * 0.5 * _SPREAD
        next_plans = Plans(
            np.concatenate([means[:, 1:], last], axis=1),
            np.clip(np.concatenate([elites[:, :, 1:], new], axis=2), -1.0, 1.0),
            plans.decisions + 1,
        )
        return best[:, 0], returns.max(axis=1), next_plans

    def _noise(self, decisions: NDArray[np.int64], iteration: int) -> Array:
        """Noise of the candidates, shape (n, samples, knots): the same after the same number of decisions."""
        numbers, inverse = np.unique(decisions, return_inverse=True)
        drawn = [
            coloured_noise(np.random.default_rng([self.seed, number, iteration]), self.samples, self.knots, _COLOUR)
            for number in numbers.tolist()
        ]
        noise: Array = np.array(drawn).reshape(-1, self.samples, self.knots)[inverse]
        return noise

    def evaluate(self, scene: Scene, states: Array, candidates: Array) -> tuple[Array, Array]:
        """Play candidates, shape (n, k, knots), from states, (n, 12): sums of rewards (n, k), and ends (n, k, 12).

        No drive acts.
        """
        count, many = candidates.shape[:2]
        starts, torques = np.repeat(states, many, axis=0), candidates.reshape(count * many, -1) * scene.torque_limit
        options = RolloutOptions(
            side_forces=False, task=self.task, repeat=self.repeat, num_threads=self.num_threads, device=self.device
        )
        played = run_rollouts([scene], starts, torques, self.control_dt, options=options)
        return played.rewards.sum(axis=1).reshape(count, many), played.trajectories[:, 1].reshape(count, many, 12)


def coloured_noise(rng: np.random.Generator, count: int, length: int, colour: float) -> Array:
    """Noise of mean 0 and variance 1 whose power falls with frequency^-colour, shape (count, length)."""
    frequencies = np.fft.rfftfreq(length)
    frequencies[0] = frequencies[1]
    scale = frequencies ** (-0.5 * colour)
    waves = scale * (rng.normal(size=(count, len(scale))) + 1j * rng.normal(size=(count, len(scale))))
    power = 4.0 * scale**2
    power[0] *= 0.25
    if length % 2 == 0:
        power[-1] *= 0.25
    noise: Array = np.fft.irfft(waves, length, axis=1) * (length / np.sqrt(power.sum()))
    return noise
