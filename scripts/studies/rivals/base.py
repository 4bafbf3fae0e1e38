"""What the rivals share: the Simulator interface, substeps, the record of pushes, and a look inside the last step."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

from numpy.typing import ArrayLike

from jackbox_env import _validation as check
from jackbox_env.accuracy import Between
from jackbox_env.scene import Drive, Scene
from jackbox_env.simulators.base import Impact, Simulator, end_of_step
from jackbox_env.states import LATEST_TIME, Array, as_held, as_state, clearance, deepest_held

Pair = tuple[int, int]  # wall, foot
Loads = tuple[float, float, float]  # on the box over a substep: mean torque [N m] and mean side forces [N]
_MOST_SUBSTEPS = 1_000_000


class Stretch(NamedTuple):
    """What a model did in one substep, but for jumps of the velocity at its end."""

    before: list[float]  # 12 numbers
    after: list[float]


class Pushes:
    """Makes impacts of contacts that push during substeps.

    A foot that pushes on a wall in substeps that follow one another does so in one impact: its time is that of the
    first, its impulse the sum. An impact is told once it is over and those that began before it have been told, so
    impacts come in the order of their times.
    """

    def __init__(self, waiting: tuple[tuple[Impact, bool], ...] = ()) -> None:
        """Go on from ``waiting``: what an earlier record left."""
        self._waiting = [list[Any](entry) for entry in waiting]  # of [impact, whether it is under way]

    def add(self, time: float, pushes: dict[Pair, float]) -> None:
        """Take note of a substep: ``pushes`` are the impulses in it [N s], ``time`` [s] is when they are found."""
        rest = dict(pushes)
        for entry in self._waiting:
            hit = entry[0]
            if entry[1]:
                more = rest.pop((hit.wall, hit.foot), None)
                entry[0], entry[1] = hit._replace(impulse=hit.impulse + (more or 0.0)), more is not None
        self._waiting += [[Impact(time, wall, foot, impulse), True] for (wall, foot), impulse in rest.items()]

    def add_whole(self, impact: Impact) -> None:
        """Take note of an impact that is over at once."""
        self._waiting.append([impact, False])

    def close(self, is_over: Callable[[int, int], bool]) -> None:
        """End the impacts under way of which ``is_over(wall, foot)`` knows that they will not push any more."""
        for entry in self._waiting:
            entry[1] = entry[1] and not is_over(entry[0].wall, entry[0].foot)

    def take(self) -> list[Impact]:
        """What can be told now."""
        told = list[Impact]()
        while self._waiting and not self._waiting[0][1]:
            told.append(self._waiting.pop(0)[0])
        return told

    def left(self) -> tuple[tuple[Impact, bool], ...]:
        """What can not be told yet."""
        return tuple((entry[0], entry[1]) for entry in self._waiting)


class _Present(NamedTuple):
    """All that changes: replaced as one, so that no error parts it."""

    state: list[float]
    time: float
    torque: float = 0.0
    impacts: tuple[Impact, ...] = ()
    waiting: tuple[tuple[Impact, bool], ...] = ()
    played: tuple[list[float], float, float, float | None] | None = None  # state, time, h, torque of the last step


class Rival(ABC):
    """A contact model that takes equal substeps of h = dt / substeps; see :class:`Simulator` for the methods.

    The motion follows from (state, time) alone. The record of impacts does not: an impact under way at a step's end is
    told by a later step, and one that is under way in a state put back counts from there on.
    """

    def __init__(self, scene: Scene, substeps: int) -> None:
        """Start at rest in the middle of the box, each foot facing a corner.

        Args:
            scene: what to simulate.
            substeps: per call of :meth:`step`, 1 to 1,000,000.

        Raises:
            TypeError, ValueError: substeps is no whole number in its range, or the model can not do the scene.
        """
        self.scene = scene
        self.substeps = check.whole("substeps", substeps, at_least=1, at_most=_MOST_SUBSTEPS)
        self._present = _Present([0.0] * 5 + [math.pi / 4.0] + [0.0] * 6, 0.0)
        self._prepare()

    def _prepare(self) -> None:  # noqa: B027  # most have an engine to build, one has not
        """Build what is not kept when pickled."""

    @abstractmethod
    def _simulate(
        self, state: list[float], time: float, h: float, torque: float | None, pushes: Pushes,
        trace: list[Stretch] | None,
    ) -> tuple[list[float], float]:  # fmt: skip
        """Take the substeps; return the state after them and the mean torque [N m].

        Whatever the model did before must not matter. ``trace``, if there is one, gets every substep.
        """

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
        """The impacts that the last step told of, in time order; a fresh list."""
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
        pushes = Pushes(now.waiting)
        after, mean = self._simulate(now.state, now.time, h, torque, pushes, None)
        outside, deepest = -clearance(self.scene, after), deepest_held(self.scene)
        if not (outside <= deepest and math.isfinite(sum(after))):
            raise RuntimeError(
                f"the jack would leave the box: after t = {now.time:g} s a foot ends {outside:.3g} m outside, at most "
                f"{deepest:g} m is followed"
            )
        played = now.state, now.time, h, torque
        self._present = _Present(after, end, mean, tuple(pushes.take()), pushes.left(), played)

    def look(self, simulator: Simulator, before: Array, time: float, torque: float | None) -> Between:
        """See inside the last step, by taking it once more; for :func:`jackbox_env.accuracy.follow`.

        The depth is the deepest at any substep's end. The work is that of the true torque and side forces on the rate
        omega that the model gave the box: over a substep of h it changes from one omega to the next, so the work is
        h * (mean torque) * (mean of both), and in flight that is what the true motion would take from the one to the
        other. The arguments are those of any Look; this one knows of its own last step.

        Raises:
            ValueError: asked about another simulator.
            RuntimeError: there was no step, or taking it again led elsewhere: the model is not a function of
                (state, time).
        """
        if simulator is not self:
            raise ValueError("a rival can look only into its own steps, got another simulator")
        if self._present.played is None:
            raise RuntimeError("there was no step to look into since the reset")
        state, time, h, torque = self._present.played
        trace = list[Stretch]()
        after, _ = self._simulate(state, time, h, torque, Pushes(), trace)
        if after != self._present.state:
            raise RuntimeError(f"the step after t = {time:g} s, taken again, led elsewhere")
        work = 0.0
        for number, stretch in enumerate(trace):
            for load, rate in zip(self._loads(time + number * h, h, torque), (8, 6, 7), strict=True):
                work += h * load * 0.5 * (stretch.before[rate] + stretch.after[rate])
        return Between(max(-clearance(self.scene, stretch.after) for stretch in trace), work)

    def _loads(self, time: float, h: float, torque: float | None) -> Loads:
        """What acts on the box in the ``h`` after ``time`` [s], averaged."""
        drive = self.scene.drive or Drive()
        if torque is None:
            torque = 0.5 * sum(drive.torque_means(time, h))
        forces = [0.5 * sum(means(time, h)) for means in drive.force_means] or [0.0, 0.0]
        return torque, forces[0], forces[1]

    def __getstate__(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in ("scene", "substeps", "_present")}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        self.__dict__.update(kept)
        self._prepare()


class EngineRival(Rival):
    """A rival that an engine steps: placed anew at every control step, then told the loads of each substep."""

    def _simulate(
        self, state: list[float], time: float, h: float, torque: float | None, pushes: Pushes,
        trace: list[Stretch] | None,
    ) -> tuple[list[float], float]:  # fmt: skip
        self._place(state, h)
        total, before = 0.0, state
        for number in range(self.substeps):
            start = time + number * h
            loads = self._loads(start, h, torque)
            total += loads[0]
            pushes.add(start, self._substep(h, loads))
            if trace is not None:
                after = self._read()
                trace.append(Stretch(before, after))
                before = after
        end = self._read()
        pushes.close(lambda wall, foot: self._is_over(end, wall, foot))
        return end, total / self.substeps

    @abstractmethod
    def _place(self, state: list[float], h: float) -> None:
        """Put the engine in a state, to go on with substeps of ``h`` [s]."""

    @abstractmethod
    def _substep(self, h: float, loads: Loads) -> dict[Pair, float]:
        """Take one substep; return the impulses of the contacts that pushed in it [N s].

        The engine finds its contacts where the substep starts.
        """

    @abstractmethod
    def _is_over(self, state: list[float], wall: int, foot: int) -> bool:
        """Whether a contact that pushed in the last substep is done with."""

    @abstractmethod
    def _read(self) -> list[float]:
        """The engine's state, 12 numbers."""


def refuse_extremes(scene: Scene, name: str) -> None:
    """Refuse a scene whose lengths and masses an engine's own constants could not tell from nothing.

    Raises:
        ValueError: one of them is outside [1e-6, 1e6] m, kg or kg m^2.
    """
    for field in ("box_half_width", "box_mass", "box_inertia", "jack_arm", "jack_mass", "jack_inertia"):
        check.real(f"{field} for {name}", getattr(scene, field), at_least=1e-6, at_most=1e6)
