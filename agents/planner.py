"""A planner: at each tenth of a second it plays many sequences of torques by the exact model and keeps the best.

iCEM, the improved cross-entropy method (Pinneri et al. 2020, arXiv:2008.06389): coloured noise around the last plan,
the best candidates make the next mean, some of them are kept, and the plan is carried on from decision to decision.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.policies import Actions
from jackbox_env import Scene, Task, rollout
from jackbox_env import _validation as check
from jackbox_env.observation import state_of

Array = NDArray[np.float64]

DECISION = 0.1  # [s] between decisions, as the settings here were tried
_COLOUR = 2.0  # the noise's power falls with this power of the frequency
_SPREAD = 0.5  # standard deviation of the first candidates, in torque limits
_KEPT = 0.3  # share of the best that are tried again
_SMOOTHING = 0.1  # share of the old mean and deviation in the new ones


class Plan(NamedTuple):
    """What one environment's planning carries on."""

    step: int  # control steps since the episode's start
    mean: Array  # (pieces,) torques in units of the limit
    kept: Array  # (kept, pieces) good candidates
    action: float  # held until the next decision


class Planner:
    """A policy with Stable-Baselines3's ``predict`` that plans by ``jackbox_env.rollout``.

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
        seed: of the candidates.
        num_threads: that play them; the plans do not depend on it.

    Raises:
        TypeError, ValueError: an argument out of its range.
    """

    def __init__(
        self, scene: Scene, task: str | Task = "juggle", control_dt: float = 0.02, *, piece: int = 5, pieces: int = 32,
        samples: int = 256, elites: int = 20, iterations: int = 3, seed: int = 0, num_threads: int | None = 1,
    ) -> None:  # fmt: skip
        self._scene, self._task = scene.changed(drive=None), task
        self._control_dt = check.real("control_dt", control_dt, above=0.0)
        self._piece = check.whole("piece", piece, at_least=1)
        self._pieces = check.whole("pieces", pieces, at_least=2)
        self._samples = check.whole("samples", samples, at_least=2)
        self._elites = check.whole("elites", elites, at_least=1, at_most=samples)
        self._iterations = check.whole("iterations", iterations, at_least=1)
        self._seed = check.whole("seed", seed, at_least=0)
        self._num_threads = num_threads
        self._again = min(max(1, round(_KEPT * elites)), samples - 1)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Actions, Any]:
        """Return the actions, shape (n, 1) or (1,), and the plans, which the next call takes as ``state``.

        Without ``state`` each call plans from nothing. Where ``episode_start`` is set, a plan is begun anew.

        Raises:
            ValueError: a state of another number of environments.
        """
        rows = np.atleast_2d(np.asarray(observation, dtype=np.float64))
        if state is not None and len(state) != len(rows):
            raise ValueError(f"state must be that of {len(rows)} environments, as observation is, got {len(state)}")
        starts = [True] * len(rows) if state is None else np.broadcast_to(episode_start, len(rows)).tolist()
        plans = []
        for number, start in enumerate(starts):
            plan = self._fresh() if start else state[number]
            if plan.step % self._piece == 0:
                plan = self._decide(state_of(self._scene, rows[number].tolist()), plan)
            plans.append(plan._replace(step=plan.step + 1))
        actions = np.array([[plan.action] for plan in plans], dtype=np.float32)
        return (actions if np.ndim(observation) == 2 else actions[0]), plans

    def _fresh(self) -> Plan:
        return Plan(0, np.zeros(self._pieces), np.zeros((0, self._pieces)), 0.0)

    def _decide(self, state: Array, plan: Plan) -> Plan:
        """Improve a plan from a state, shape (12,); take its first torque and move on by one piece."""
        rng = np.random.default_rng([self._seed, plan.step])
        mean, kept, spread = plan.mean, plan.kept, np.full(self._pieces, _SPREAD)
        for _ in range(self._iterations):
            candidates = mean + coloured_noise(rng, self._samples, self._pieces, _COLOUR) * spread
            candidates[0] = mean
            candidates[1 : 1 + len(kept)] = kept
            candidates = np.clip(candidates, -1.0, 1.0)
            order = np.argsort(-self.returns(state, candidates), kind="stable")[: self._elites]
            best = candidates[order]
            kept = best[: self._again]
            mean = (1.0 - _SMOOTHING) * best.mean(axis=0) + _SMOOTHING * mean
            spread = (1.0 - _SMOOTHING) * best.std(axis=0) + _SMOOTHING * spread
        new = rng.uniform(-0.6 * _SPREAD, 0.6 * _SPREAD, (len(kept), 1))
        carried_on = np.concatenate([kept[:, 1:], new], axis=1)
        return Plan(plan.step, np.append(mean[1:], 0.0), carried_on, float(best[0, 0]))

    def returns(self, state: Array, plans: Array) -> Array:
        """What plans from a state, shape (12,), bring: sums of rewards, shape (n,); plans of shape (n, pieces)."""
        found = rollout(
            self._scene, state, plans * self._scene.torque_limit, self._control_dt, rewards=self._task,
            repeat=self._piece, trajectories=False, num_threads=self._num_threads,
        )  # fmt: skip
        assert found.rewards is not None
        earned: Array = found.rewards.sum(axis=1)
        return earned


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
