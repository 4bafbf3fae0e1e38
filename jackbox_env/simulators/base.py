"""The common base of the contact models, and the record of an impact."""

from __future__ import annotations

import math
from _thread import get_ident
from abc import ABC, abstractmethod
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from jackbox_env.model.scene import Scene
from jackbox_env.model.states import LATEST_TIME, Array, Numbers, as_restored
from jackbox_env.tools import checks as check
from jackbox_env.tools.one_thread import ThreadNote, in_use


class JackLostError(RuntimeError):
    """The jack would leave the box, or moves too fast for the contact model. The state is unchanged."""


class Impact(NamedTuple):
    """One impact of one foot on one wall, a named tuple.

    >>> from jackbox_env import make_simulator
    >>> simulator = make_simulator({"drive": None}, contact="exact")
    >>> simulator.reset([0.0] * 12)  # the jack falls 5 m
    >>> simulator.step(1.2)
    >>> hit = simulator.impacts[0]
    >>> round(hit.time, 6), hit.wall, hit.foot, round(hit.impulse, 2)
    (1.009638, 3, 3, 78.45)

    Attributes:
        time: absolute time [s].
        wall: 0..3, counter-clockwise from the right one of a level box: outward normal at theta_box + wall pi/2.
        foot: 0..3, at theta_jack + foot pi/2.
        impulse: along the wall's normal [N s], > 0.
    """

    time: float
    wall: int
    foot: int
    impulse: float


def end_of_step(time: float, dt: float) -> float:
    """Return ``time`` + ``dt`` [s].

    Raises:
        ValueError: the step does not move the time, or ends too late.
    """
    end = time + dt
    if not (end != time and end <= LATEST_TIME):
        raise ValueError(f"dt must move the time and end by {LATEST_TIME:g} s, got {dt:g} at t = {time:g} s")
    return end


def total_impulse(impacts: list[Impact]) -> float:
    """Sum of the impulses [N s], added in order as the compiled code does."""
    impulse = 0.0
    for impact in impacts:
        impulse += impact.impulse
    return impulse


class Present(NamedTuple):
    """A simulator's state and the results of its last step: assigned together, so an interrupt cannot separate them."""

    state: Numbers  # 12 numbers, never written again
    time: float  # [s]
    torque: float = 0.0  # mean over the last step [N m]
    impacts: tuple[Impact, ...] = ()  # of the last step


class Simulator(ABC):
    """A contact model with a state (12 float64, see :mod:`jackbox_env.mechanics`) and a time, which it steps.

    A step depends only on state, time and its arguments. Equal calls from equal states return equal bits, also after
    pickling and copying. A simulator is used by one thread at a time; ``step`` and ``reset`` raise RuntimeError while
    another thread is in one of them.

    >>> from jackbox_env import make_simulator
    >>> simulator = make_simulator({"gravity": 10.0}, contact="exact")
    >>> simulator.reset([0, 0, 0, 0, -4.9, 0, 0, 0, 0, 0, -10, 0])  # foot 3 is 0.1 m above wall 3, the floor
    >>> simulator.step(0.02)
    >>> [(impact.wall, impact.foot) for impact in simulator.impacts]
    [(3, 3)]

    A contact model of your own derives from this class and implements ``step``. Its ``__init__`` raises ValueError for
    a scene that it cannot simulate.
    """

    name: ClassVar[str]  # as in contact="..."
    settings: ClassVar[tuple[str, ...]] = ()  # further arguments, attributes of the same names; pickled
    room: ClassVar[int]  # [bytes] of memory of one environment, about
    compiled: ClassVar[bool] = False  # whether rewards and observations are computed in compiled code, as its steps are

    def __init__(self, scene: Scene, **settings: Any) -> None:
        """Start at rest in the middle of the box, each foot facing a corner."""
        self.scene, self._inside = scene, ThreadNote()
        self._present = Present(self._as_stored(np.array([0.0] * 5 + [math.pi / 4.0] + [0.0] * 6)), 0.0)

    @property
    def state(self) -> Array:
        """A copy of the present state, float64, shape (12,), SI units."""
        return np.array(self._present.state)

    @property
    def time(self) -> float:
        """Present time [s]."""
        return self._present.time

    @property
    def torque(self) -> float:
        """Mean torque on the box over the last step [N m], 0 after a reset."""
        return self._present.torque

    @property
    def impacts(self) -> list[Impact]:
        """The impacts of the last step in time order; a fresh list."""
        return list(self._present.impacts)

    def reset(self, state: ArrayLike, time: float = 0.0) -> None:
        """Set the state, shape (12,), and the time [s], exactly; a foot may be at most min(1 m, L) outside.

        Raises:
            TypeError, ValueError: unusable values; the simulator stays as it was.
        """
        state = as_restored(self.scene, state)
        time = check.real("time", time, at_least=-LATEST_TIME, at_most=LATEST_TIME)
        self._enter()
        try:
            self._present = Present(self._as_stored(state), time)
        finally:
            self._inside.clear()

    def _enter(self) -> None:
        """Note this thread, or raise RuntimeError if another one is in the simulator."""
        thread = get_ident()
        if self._inside.setdefault(0, thread) != thread:
            raise in_use("a simulator")

    def snapshot(self) -> Present:
        """State, time and the results of the last step, for :meth:`restore`."""
        return self._present

    def restore(self, snapshot: Present) -> None:
        """Return to the moment of a :meth:`snapshot`."""
        self._present = snapshot

    def _as_stored(self, state: Array) -> Numbers:
        """A fresh state in the form in which the model stores it."""
        return state

    @abstractmethod
    def step(self, dt: float, torque: float | None = None) -> None:
        """Advance by ``dt`` > 0 [s] under a constant ``torque`` on the box [N m], or under the scene's drive (None).

        ``torque`` replaces only the drive's torque. Its side forces act in any case.

        Raises:
            TypeError, ValueError: unusable values.
            JackLostError: the jack would leave the box, or cannot be followed. An error leaves the simulator unchanged.
        """

    def _prepare(self) -> None:  # noqa: B027  # some have nothing to build
        """Build the parts that are not pickled."""

    def __getstate__(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in ("scene", *self.settings, "_present")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._inside = ThreadNote()
        self._prepare()
