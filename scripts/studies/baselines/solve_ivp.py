"""SciPy's ``solve_ivp`` with events: Runge-Kutta between impacts, an event for each gap, the impact map at an event.

Law: smooth Lagrangian dynamics by the explicit Runge-Kutta pair of order 5(4), rtol = atol = ``tolerance``. 16 terminal
    events, one for each wall and foot, where the gap falls through 0. The Lagrangian impact map follows for that foot.
Order: 5 in flight; an event is a root of an interpolant of order 4, located to rounding.
Cost: one call of ``solve_ivp`` for each substep and each impact, some 3 ms.
Fails: an event is a sign change between the ends of a step. A foot that goes in and out again within one step is
    missed. A foot that starts a step at a gap below 0, by rounding, has no event if it approaches: it leaves the box.
Reference: SciPy's manual, ``scipy.integrate.solve_ivp``; the bouncing cannon ball is its example of events.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.integrate import solve_ivp

from jackbox_env.mechanics import impact_map
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import RATES, THETA_BOX, THETA_JACK, X_BOX, X_JACK, Y_BOX, Y_JACK, Array
from jackbox_env.simulators.base import Impact, JackLostError
from scripts.studies.baselines.base import Baseline, Trace

MOST = 1000  # impacts of one step


def event(scene: Scene, wall: int, foot: int) -> Callable[[float, Array], float]:
    """A gap as an event that ends the integration when it falls through 0."""

    def gap(time: float, y: Array) -> float:
        normal, arm = y[THETA_BOX] + 0.5 * math.pi * wall, y[THETA_JACK] + 0.5 * math.pi * foot
        across = y[X_JACK] - y[X_BOX] + scene.jack_arm * math.cos(arm)
        up = y[Y_JACK] - y[Y_BOX] + scene.jack_arm * math.sin(arm)
        return float(scene.box_half_width - math.cos(normal) * across - math.sin(normal) * up)

    gap.terminal, gap.direction = True, -1.0  # type: ignore[attr-defined]
    return gap


def slope(scene: Scene, torque: float | None, time: float, y: Array) -> Array:
    """The derivative of a state by time in flight, under a constant torque or the drive."""
    load = scene.drive.torque(time) if torque is None and scene.drive and scene.drive.torque else torque or 0.0
    return np.array([*y[RATES:], 0.0, 0.0, load / scene.box_inertia, 0.0, -scene.gravity, 0.0])


class Model(Baseline):
    """``solve_ivp``, see the module's docstring."""

    def __init__(self, scene: Scene, tolerance: float) -> None:
        super().__init__(scene, 1)
        self._tolerance = tolerance

    def _build_unpickled(self) -> None:
        self._events = [event(self.scene, *divmod(number, 4)) for number in range(16)]

    def _simulate(
        self,
        state: list[float],
        time: float,
        h: float,
        torque: float | None,
        impacts: list[tuple[Impact, bool]],
        trace: Trace | None = None,
    ) -> tuple[list[float], float]:
        y, since, end = np.array(state), time, time + h
        tolerances = {"rtol": self._tolerance, "atol": self._tolerance}
        for _ in range(MOST):
            solution = solve_ivp(partial(slope, self.scene, torque), (since, end), y, events=self._events, **tolerances)
            since, y = float(solution.t[-1]), solution.y[:, -1]
            if solution.status != 1:  # no event ended it
                return y.tolist(), self._torque(time, h, torque)
            pair = divmod([len(times) for times in solution.t_events].index(1), 4)
            y, impulse = impact_map(self.scene, y, *pair)
            impacts.append((Impact(since, *pair, impulse), False))
        raise JackLostError(f"solve_ivp finds more than {MOST} impacts in the {h:g} s after t = {time:g} s")
