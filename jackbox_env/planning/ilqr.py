"""iLQR: torques improved by derivatives through impacts.

iLQR (Tassa et al. 2012, doi:10.1109/IROS.2012.6386025) with bounded torques (Tassa et al. 2014,
doi:10.1109/ICRA.2014.6907001): a backward pass over the linearised motion, then a line search by exact rollouts. A
step without a derivative, or an overflow, interrupts the backward pass: earlier torques are chosen as if nothing
followed. A line search in which a jack is lost counts as one that gains nothing.

Within this file torques are in units of the limit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from jackbox_env.model.scene import Scene
from jackbox_env.model.states import THETA_BOX, THETA_JACK, X_BOX, X_JACK, Array, as_restored
from jackbox_env.model.tasks import SLOPES
from jackbox_env.planning.linearization import linearize
from jackbox_env.planning.rollouts import rollout
from jackbox_env.simulators import JackLostError
from jackbox_env.tools import checks as check

Cost = Callable[[Array], tuple[ArrayLike, ArrayLike, ArrayLike]]
_LENGTHS = 0.5 ** np.arange(12)  # of the line search
MOST_ITERATIONS = 200
_LEAST_GAIN, _MOST_DAMPING = 1e-3, 1e6  # of an iteration; [value / limit^2]
_CLOSEST = 1.0 / 60.0  # [L] from the middle, where the kink of juggle's reward is smoothed
_overflowing = np.errstate(over="ignore", invalid="ignore")  # products of derivatives of many impacts


class Improved(NamedTuple):
    """The result of :func:`ilqr`.

    Attributes:
        torques: on the box [N m], shape (K,).
        states: at the start and after each step, shape (K * repeat + 1, 12).
        value: the sum of rewards, or minus the sum of costs.
        before: the same of the plan that was passed.
        iterations: number of line searches.
        nonsmooth: number of steps without a derivative on the way.
    """

    torques: Array
    states: Array
    value: float
    before: float
    iterations: int
    nonsmooth: int


def ilqr(
    scene: Scene | Mapping[str, Any] | None,
    state: ArrayLike,
    torques: ArrayLike,
    dt: float,
    *,
    task: str = "juggle",
    cost: Cost | None = None,
    repeat: int = 1,
) -> Improved:
    """Improve a plan of torques by derivatives of the exact model, until an iteration gains less than 0.001.

    A local method: it polishes a plan, and it returns the plan itself if it cannot.
    Sampling finds plans, as ``agents/policies/icem.py`` does.

    >>> improved = ilqr(None, [0.0] * 9 + [1.0, 0.0, 0.0], [0.0] * 20, 0.02, repeat=5)
    >>> improved.value > improved.before, improved.torques.shape, improved.states.shape
    (True, (20,), (101, 12))

    Args:
        scene: a Scene, a dict of some of its fields, or None. A drive's side forces act, not its torque.
        state: to start from, shape (12,).
        torques: the plan, on the box [N m], shape (K,), within the scene's torque limit.
        dt: duration of a step [s], > 0.
        task: whose rewards are summed, "juggle" or "spin".
        cost: in place of a task, a function of the states after each step, shape (H, 12). It returns for each step a
            cost, (H,), which may be of some steps only, its slope by the state, (H, 12), and its curvature,
            (H, 12, 12), positive semidefinite.
        repeat: steps that each torque is repeated for, so H = K * repeat.

    Raises:
        TypeError, ValueError: unusable values, also of ``cost``.
        JackLostError: under the plan itself the jack moves too fast to be followed.
    """
    problem = _Problem(Scene.of(scene), state, dt, task, cost, repeat)
    plan = check.array("torques", torques, "be numbers").astype(np.float64) / problem.scene.torque_limit
    if plan.ndim != 1 or not len(plan):
        raise ValueError(f"torques must have shape (K,), got {plan.shape}")
    if not (abs(plan) <= 1.0).all():
        beyond = plan[~(abs(plan) <= 1.0)][0] * problem.scene.torque_limit
        limit = f"+-{problem.scene.torque_limit:g} N m, the scene's torque limit"
        raise ValueError(f"torques must be within {limit}, got {beyond:g}")
    gains, damping, count = np.zeros((len(plan), 12)), 1.0, 0
    best, plan, motion = (part[0] for part in problem.played(plan[None], gains, None))
    before, (model, nonsmooth) = float(best), problem.expanded(plan)
    while count < MOST_ITERATIONS and damping < _MOST_DAMPING:
        changes, gains = _backward(plan, model, damping)
        count += 1
        try:
            tried = problem.played(plan + _LENGTHS[:, None] * changes, gains, motion)
        except JackLostError:
            damping *= 10.0
            continue
        number = int(tried[0].argmax())
        if tried[0][number] < best + _LEAST_GAIN:
            damping *= 10.0
            continue
        best, plan, motion = (part[number] for part in tried)
        damping = max(0.1 * damping, 1e-3) if number < 3 else damping
        model, missing = problem.expanded(plan)
        nonsmooth += missing
    return Improved(plan * problem.scene.torque_limit, motion, float(best), before, count, nonsmooth)


class _Problem:
    """The start, the steps and the value for which torques are improved."""

    def __init__(self, scene: Scene, state: ArrayLike, dt: float, task: str, cost: Cost | None, repeat: int) -> None:
        self.scene, self._start, self._dt = scene, as_restored(scene, state), check.real("dt", dt, above=0.0)
        self._task, self._cost = check.choice("task", task, SLOPES), cost
        if not (cost is None or callable(cost)):
            raise TypeError(f"cost must be a function of the states or None, got {check.shown(cost)}")
        self._repeat = check.whole("repeat", repeat, at_least=1, at_most=1_000_000)

    def played(self, plans: Array, gains: Array, old: Array | None) -> tuple[Array, Array, Array]:
        """Play plans, shape (n, K), plus gains, (K, 12), times the deviations from old states, (K * repeat + 1, 12).

        Returns:
            values, (n,), torques within the limit, (n, K), and states, (n, K * repeat + 1, 12).
        """
        count, knots = plans.shape
        values, torques, states = np.zeros(count), plans.copy(), np.empty((count, knots * self._repeat + 1, 12))
        states[:, 0], time = self._start, 0.0
        for knot in range(knots):
            first, last = knot * self._repeat, (knot + 1) * self._repeat
            off = 0.0 if old is None else _feedback(gains[knot], states[:, first] - old[first])
            torques[:, knot] = np.clip(plans[:, knot] + off, -1.0, 1.0)
            applied = np.repeat(torques[:, knot, None] * self.scene.torque_limit, self._repeat, axis=1)
            played = rollout(self.scene, states[:, first], applied, self._dt, time, rewards=self._task)
            states[:, first + 1 : last + 1] = played.trajectories[:, 1:]
            values += played.rewards.sum(axis=1)
            for _ in range(self._repeat):
                time += self._dt  # as the model adds it up
        if self._cost is not None:
            values = np.array([-self._costs(motion[1:])[0].sum() for motion in states])
        return values, torques, states

    def expanded(self, torques: Array) -> tuple[tuple[Array, Array, Array], int]:
        """The motion to first order and the lost value to second, by the state and the torque at each knot's start.

        Returns:
            derivatives of the next state, (K, 12, 13), slopes, (K, 13), and curvatures, (K, 13, 13); and the number of
            steps without a derivative.
        """
        limit, knots = self.scene.torque_limit, len(torques)
        lin = linearize(self.scene, self._start, torques * limit, self._dt, repeat=self._repeat)
        by_state = np.nan_to_num(lin.A).reshape(knots, self._repeat, 12, 12)
        by_torque = np.nan_to_num(lin.B).reshape(knots, self._repeat, 12) * limit
        ends = lin.trajectories[0, 1:]
        slope, curvature = self._lost(ends) if self._cost is None else self._costs(ends)[1:]
        slope = slope.reshape(knots, self._repeat, 12)
        curvature = curvature.reshape(knots, self._repeat, 12, 12)
        return _condensed(by_state, by_torque, slope, curvature), int((~lin.smooth).sum())

    def _lost(self, states: Array) -> tuple[Array, Array]:
        """Slopes, (H, 12), and curvatures, (H, 12, 12), of what the task's reward loses, by states, (H, 12).

        Of juggle, the curvature of a distance r is set to 1 / r along both axes: a paraboloid that touches the cone
        from above.
        """
        curvatures = np.zeros((len(states), 12, 12))
        if self._task != "juggle":
            return -SLOPES[self._task](self.scene.numbers, states), curvatures
        half_width = self.scene.box_half_width
        reach = max(half_width - self.scene.jack_arm, half_width / 6.0)
        off = states[:, X_JACK:THETA_JACK] - states[:, X_BOX:THETA_BOX]
        far = np.linalg.norm(off, axis=1)
        weights = (far < reach) / (reach * np.maximum(far, _CLOSEST * half_width))
        relative = np.zeros((2, 12))
        relative[[0, 1], [X_JACK, X_JACK + 1]], relative[[0, 1], [X_BOX, X_BOX + 1]] = 1.0, -1.0
        return (weights[:, None] * off) @ relative, weights[:, None, None] * (relative.T @ relative)

    def _costs(self, states: Array) -> tuple[Array, Array, Array]:
        """The user's costs, slopes and curvatures for states, (H, 12).

        Raises:
            TypeError, ValueError: it is not three arrays of finite numbers of these shapes.
        """
        assert self._cost is not None
        count, returned = len(states), self._cost(states.copy())
        if not isinstance(returned, tuple) or len(returned) != 3:
            raise TypeError(f"cost must return costs, slopes and curvatures, got {check.shown(returned)}")
        names, shapes = ("costs", "slopes", "curvatures"), ((count,), (count, 12), (count, 12, 12))
        arrays = [check.array(f"cost's {name}", one, "be numbers") for name, one in zip(names, returned, strict=True)]
        for name, array, shape in zip(names, arrays, shapes, strict=True):
            if array.shape != shape or not np.isfinite(array).all():
                raise ValueError(
                    f"cost's {name} must be finite and have shape {shape}, got {check.shown(array)} of {array.shape}"
                )
        costs, slopes, curvatures = (array.astype(np.float64) for array in arrays)
        return costs, slopes, curvatures


@_overflowing
def _feedback(gains: Array, deviations: Array) -> Array:
    """Changes of a torque, (n,), by gains, (12,), times deviations of the state, (n, 12); 0 where that overflows."""
    return np.nan_to_num(deviations @ gains)


@_overflowing
def _condensed(by_state: Array, by_torque: Array, slope: Array, curvature: Array) -> tuple[Array, Array, Array]:
    """The derivatives of :meth:`_Problem.expanded` from those of each step, shapes (K, repeat, ...)."""
    knots, repeat = slope.shape[:2]
    motion = np.repeat(np.eye(12, 13)[None], knots, axis=0)
    slopes, curvatures = np.zeros((knots, 13)), np.zeros((knots, 13, 13))
    for step in range(repeat):
        motion = by_state[:, step] @ motion
        motion[:, :, 12] += by_torque[:, step]
        slopes += (slope[:, step, None] @ motion)[:, 0]
        curvatures += motion.transpose(0, 2, 1) @ curvature[:, step] @ motion
    return motion, slopes, curvatures


@_overflowing
def _backward(torques: Array, model: tuple[Array, Array, Array], damping: float) -> tuple[Array, Array]:
    """Changes of the torques, shape (K,), and gains, (K, 12); zero where a torque reaches its limit."""
    knots = len(torques)
    changes, gains = np.zeros(knots), np.zeros((knots, 12))
    slope, curvature = np.zeros(12), np.zeros((12, 12))  # of the value lost from this knot on, by the state
    for knot in range(knots - 1, -1, -1):
        motion, slopes, curvatures = (part[knot] for part in model)
        slopes, curvatures = slopes + motion.T @ slope, curvatures + motion.T @ curvature @ motion
        if not (np.isfinite(slopes).all() and np.isfinite(curvatures).all()):
            slope, curvature = np.zeros(12), np.zeros((12, 12))
            continue
        unclipped = -slopes[12] / (curvatures[12, 12] + damping)
        changes[knot] = np.clip(unclipped, -1.0 - torques[knot], 1.0 - torques[knot])
        if changes[knot] == unclipped:
            gains[knot] = -curvatures[12, :12] / (curvatures[12, 12] + damping)
        closed = np.vstack([np.eye(12), gains[knot]])
        slope, curvature = closed.T @ (slopes + curvatures[:, 12] * changes[knot]), closed.T @ curvatures @ closed
    return changes, gains
