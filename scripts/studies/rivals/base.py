"""What the rivals share: the Simulator interface, substeps, the record of pushes, and a look inside the last step."""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

from numpy.typing import ArrayLike

from jackbox_env import _validation as check
from jackbox_env.measure.accuracy import Between
from jackbox_env.scene import Drive, Scene
from jackbox_env.simulators.base import Impact, JackLostError, Simulator, end_of_step
from jackbox_env.states import LATEST_TIME, Array, as_held, as_state, clearance, deepest_held

DIRECTIONS = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))  # of walls 0 to 3 and of feet 0 to 3
Pair = tuple[int, int]  # wall, foot
Loads = tuple[float, float, float]  # on the box over a substep: mean torque [N m] and mean side forces [N]
Waiting = tuple[tuple[Impact, bool], ...]  # impacts not reported yet, and whether each is under way
Trace = list[tuple[list[float], list[float]]]  # states before and after each substep, without the jump at its end


class Record:
    """What happens in a step: a foot that pushes on a wall in consecutive substeps makes one impact.

    Its time is that of the first push, its impulse is the sum. An impact is reported once it is over and all earlier
    ones are reported. So impacts come in time order.
    """

    def __init__(self, waiting: Waiting = (), trace: Trace | None = None) -> None:
        """Continue from the impacts that an earlier record did not report; models add each substep to a ``trace``."""
        self.waiting, self.trace = waiting, trace

    def add(self, time: float, pushes: dict[Pair, float]) -> None:
        """Record a substep: ``pushes`` are its impulses [N s], found at ``time`` [s]."""
        rest, waiting = dict(pushes), list[tuple[Impact, bool]]()
        for hit, under_way in self.waiting:
            more = rest.pop((hit.wall, hit.foot), None) if under_way else None
            waiting.append((hit._replace(impulse=hit.impulse + (more or 0.0)), more is not None))
        self.waiting = (*waiting, *((Impact(time, *pair, impulse), True) for pair, impulse in rest.items()))

    def add_whole(self, impact: Impact) -> None:
        """Record an impact that is over at once."""
        self.waiting += ((impact, False),)

    def close(self, is_over: Callable[[int, int], bool]) -> None:
        """End the impacts under way for which ``is_over(wall, foot)`` is true."""
        self.waiting = tuple((hit, going and not is_over(hit.wall, hit.foot)) for hit, going in self.waiting)

    def take(self) -> list[Impact]:
        """Remove and return the impacts that can be reported now."""
        told = [hit for hit, _ in itertools.takewhile(lambda entry: not entry[1], self.waiting)]
        self.waiting = self.waiting[len(told) :]
        return told


class _Present(NamedTuple):
    """Everything that a step changes. It is replaced at once, so an error leaves it intact."""

    state: list[float]
    time: float
    torque: float = 0.0
    impacts: tuple[Impact, ...] = ()
    waiting: Waiting = ()
    played: tuple[list[float], float, float, float | None] | None = None  # state, time, h, torque of the last step


class Rival(ABC):
    """A contact model that takes equal substeps of h = dt / substeps; see :class:`Simulator` for the methods.

    (state, time) determines the motion but not the record of impacts. A later step reports an impact that is under way
    at the end of a step. After a reset such an impact counts from the reset on.
    """

    def __init__(self, scene: Scene, substeps: int) -> None:
        """Start at rest in the middle of the box, each foot facing a corner.

        Raises:
            TypeError, ValueError: substeps not from 1 to 1,000,000, or a scene that the model cannot simulate.
        """
        self.scene = scene
        self.substeps = check.whole("substeps", substeps, at_least=1, at_most=1_000_000)
        self._present = _Present([0.0] * 5 + [math.pi / 4.0] + [0.0] * 6, 0.0)

    @abstractmethod
    def _simulate(
        self, state: list[float], time: float, h: float, torque: float | None, record: Record
    ) -> tuple[list[float], float]:
        """Take the substeps, independent of earlier calls; return the final state and the mean torque [N m]."""

    @property
    def state(self) -> Array:
        """A copy of the present state, float64, shape (12,), SI units."""
        return as_state(self._present.state)

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
        """The impacts that the last step reported, in time order; a fresh list."""
        return list(self._present.impacts)

    def reset(self, state: ArrayLike, time: float = 0.0) -> None:
        """See :meth:`Simulator.reset`; a foot may be at most min(1 m, L) outside."""
        values: list[float] = as_held(self.scene, state).tolist()
        self._present = _Present(values, check.real("time", time, at_least=-LATEST_TIME, at_most=LATEST_TIME))

    def step(self, dt: float, torque: float | None = None) -> None:
        """See :meth:`Simulator.step`."""
        dt = check.real("dt", dt, above=0.0)
        if torque is not None:
            torque = check.real("torque", torque)
        now = self._present
        end = end_of_step(now.time, dt)
        h = check.real("dt / substeps", dt / self.substeps, above=0.0)
        record = Record(now.waiting)
        after, mean = self._simulate(now.state, now.time, h, torque, record)
        outside, deepest = -clearance(self.scene, after), deepest_held(self.scene)
        if not (outside <= deepest and math.isfinite(sum(after))):
            raise JackLostError(
                f"the jack would leave the box: after t = {now.time:g} s a foot ends {outside:.3g} m outside, at most "
                f"{deepest:g} m is followed"
            )
        played = now.state, now.time, h, torque
        self._present = _Present(after, end, mean, tuple(record.take()), record.waiting, played)

    def look(self, simulator: Simulator, before: Array, time: float, torque: float | None) -> Between:
        """Look inside the last step by taking it again: a Look for :func:`jackbox_env.measure.accuracy.follow`.

        The depth is the largest at the ends of the substeps. The work is that of the true torque and side forces on the
        box as the model moved it: h * (mean torque) * (mean of omega before and after) in each substep.

        Raises:
            ValueError: asked about another simulator.
            RuntimeError: there was no step since the reset, or (state, time) does not determine the motion.
        """
        if simulator is not self:
            raise ValueError("a rival can look only into its own steps, got another simulator")
        if self._present.played is None:
            raise RuntimeError("there was no step to look into since the reset")
        state, time, h, torque = self._present.played
        trace: Trace = []
        after, _ = self._simulate(state, time, h, torque, Record(trace=trace))
        if after != self._present.state:
            raise RuntimeError(f"the step after t = {time:g} s gave another state when it was repeated")
        work = 0.0
        for number, (left, right) in enumerate(trace):
            for load, rate in zip(self._loads(time + number * h, h, torque), (8, 6, 7), strict=True):
                work += h * load * 0.5 * (left[rate] + right[rate])
        return Between(max(-clearance(self.scene, right) for _, right in trace), work)

    def _loads(self, time: float, h: float, torque: float | None) -> Loads:
        """Mean loads on the box in the ``h`` after ``time`` [s]."""
        drive = self.scene.drive or Drive()
        if torque is None:
            torque = 0.5 * sum(drive.torque_means(time, h))
        forces = [0.5 * sum(means(time, h)) for means in drive.force_means] or [0.0, 0.0]
        return torque, forces[0], forces[1]

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.scene, self.substeps), {"_present": self._present}


class EngineRival(Rival):
    """A rival that an engine steps: placed anew at every control step, then given the loads of each substep."""

    engine: str  # its name in errors

    def __init__(self, scene: Scene, substeps: int = 4) -> None:
        """See :class:`Rival`. Lengths and masses must be from 1e-6 to 1e6, to suit the engine's own constants."""
        for field in ("box_half_width", "box_mass", "box_inertia", "jack_arm", "jack_mass", "jack_inertia"):
            check.real(f"{field} for {self.engine}", getattr(scene, field), at_least=1e-6, at_most=1e6)
        super().__init__(scene, substeps)
        self._build()

    def _simulate(
        self, state: list[float], time: float, h: float, torque: float | None, record: Record
    ) -> tuple[list[float], float]:
        self._place(state, h)
        total, before = 0.0, state
        for number in range(self.substeps):
            start = time + number * h
            loads = self._loads(start, h, torque)
            total += loads[0]
            record.add(start, self._substep(h, loads))
            if record.trace is not None:
                after = self._read()
                record.trace.append((before, after))
                before = after
        end = self._read()
        record.close(lambda wall, foot: self._is_over(end, wall, foot))
        return end, total / self.substeps

    @abstractmethod
    def _build(self) -> None:
        """Build the scene in the engine."""

    @abstractmethod
    def _place(self, state: list[float], h: float) -> None:
        """Put the engine in a state, to continue with substeps of ``h`` [s]."""

    @abstractmethod
    def _substep(self, h: float, loads: Loads) -> dict[Pair, float]:
        """Take one substep. Return the impulses of the contacts that pushed, found at its start [N s]."""

    @abstractmethod
    def _is_over(self, state: list[float], wall: int, foot: int) -> bool:
        """Whether a contact that pushed in the last substep has ended."""

    @abstractmethod
    def _read(self) -> list[float]:
        """The engine's state, 12 numbers."""
