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
    >>> simulator = make_simulator({"drive": None}, fidelity="exact")
    >>> simulator.reset([0.0] * 12)  # the jack falls 5 m
    >>> hit = simulator.step(1.2).impacts[0]
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


class StepResult(NamedTuple):
    """The result of a step of a simulator, a named tuple.

    Attributes:
        state: at the step's end, 12 numbers, SI units; a step returns a fresh float64 array.
        time: at the step's end [s].
        torque: mean on the box over the step [N m].
        impacts: of the step, in time order.
    """

    state: Any  # an array, or Python's numbers, as the contact model computes with them
    time: float
    torque: float = 0.0
    impacts: tuple[Impact, ...] = ()


class Simulator(ABC):
    """A contact model with a state (12 float64, see :mod:`jackbox_env.mechanics`) and a time, which it steps.

    A step depends only on state, time and its arguments. Equal calls from equal states return equal bits, also after
    pickling and copying. A simulator is used by one thread at a time; ``step`` and ``reset`` raise RuntimeError while
    another thread is in one of them.

    >>> from jackbox_env import make_simulator
    >>> simulator = make_simulator({"gravity": 10.0}, fidelity="exact")
    >>> simulator.reset([0, 0, 0, 0, -4.9, 0, 0, 0, 0, 0, -10, 0])  # 0.1 m above the floor
    >>> state, time, torque, impacts = simulator.step(0.02)
    >>> [(impact.wall, impact.foot) for impact in impacts]
    [(3, 3)]

    A contact model of your own derives from this class and implements :meth:`stepped`, which returns the step's
    :class:`StepResult`. Its ``__init__`` raises ValueError for a scene that it cannot simulate.
    """

    name: ClassVar[str]  # as in contact="..."
    settings: ClassVar[tuple[str, ...]] = ()  # further arguments, attributes of the same names; pickled
    room: ClassVar[int]  # [bytes] of memory of one environment, about
    compiled: ClassVar[bool] = False  # whether rewards and observations are computed in compiled code, by its steps

    def __init__(self, scene: Scene) -> None:
        """Start at rest in the middle of the box, each foot facing a corner."""
        self.scene, self._inside = scene, ThreadNote()
        # The state and the results of the last step: assigned together, so that an interrupt cannot separate them.
        self._present = StepResult(self._as_stored(np.array([0.0] * 5 + [math.pi / 4.0] + [0.0] * 6)), 0.0)
        self._build_unpickled()

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
        if self._inside.setdefault(0, get_ident()) != get_ident():
            raise in_use("a simulator")
        try:
            self._present = StepResult(self._as_stored(state), time)
        finally:
            self._inside.clear()

    def snapshot(self) -> StepResult:
        """State, time and the results of the last step, for :meth:`restore`."""
        return self._present

    def restore(self, snapshot: StepResult) -> None:
        """Return to the moment of a :meth:`snapshot`."""
        self._present = snapshot

    def _as_stored(self, state: Array) -> Numbers:
        """A fresh state in the form in which the model stores it."""
        return state

    def step(self, dt: float, torque: float | None = None) -> StepResult:
        """Advance by ``dt`` > 0 [s] under a constant ``torque`` on the box [N m], or under the scene's drive (None).

        ``torque`` replaces only the drive's torque. Its side forces act in any case.

        Returns:
            State and time at the step's end, its mean torque and its impacts.

        Raises:
            TypeError, ValueError: unusable values.
            JackLostError: the jack would leave the box, or cannot be followed. An error leaves the simulator unchanged.
        """
        if not (type(dt) is float and 0.0 < dt < math.inf):  # a plain float needs no more
            dt = check.real("dt", dt, above=0.0)
        if torque is not None and not (type(torque) is float and -math.inf < torque < math.inf):
            torque = check.real("torque", torque)
        state, time, mean, impacts = self.step_checked(dt, torque)
        return StepResult(np.array(state), time, mean, impacts)

    def step_checked(self, dt: float, torque: float | None, *scoring: Any) -> StepResult:
        """Make a :meth:`step` whose arguments are checked. A later step may overwrite the result's state.

        ``scoring``: for a ``compiled`` model, the ``Scoring`` of ``exact.py`` that its step fills in.
        """
        inside, thread = self._inside, get_ident()
        if inside.setdefault(0, thread) != thread:
            raise in_use("a simulator")
        try:
            result = self.stepped(dt, torque, *scoring)
            if type(result) is not StepResult:
                raise TypeError(f"{type(self).__name__}.stepped must return a StepResult, got {check.shown(result)}")
            self._present = result
        finally:
            inside.clear()
        return result

    @abstractmethod
    def stepped(self, dt: float, torque: float | None) -> StepResult:
        """The result of a step from the present state, which :meth:`step` then makes the present one.

        A contact model implements it and changes nothing that a later step depends on. ``step`` has checked the
        arguments; ``state`` and ``time`` are those before the step. A model whose :meth:`snapshot` copies the state may
        write the result's state again two steps later. A ``compiled`` model takes ``scoring`` too, see
        :meth:`step_checked`.

        Raises:
            JackLostError: the jack would leave the box, or cannot be followed.
        """

    def _build_unpickled(self) -> None:  # noqa: B027  # some have nothing to build
        """Build the parts that are not pickled, from the scene and the settings."""

    def __getstate__(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in ("scene", *self.settings, "_present")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._inside = ThreadNote()
        self._build_unpickled()
