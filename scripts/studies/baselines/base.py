"""Base classes of the baselines: substeps, impacts of engines that push, depth and work inside the last step."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import ClassVar

from typing_extensions import override

from jackbox_env.measure.accuracy import Between
from jackbox_env.model.scene import Drive, Scene
from jackbox_env.model.states import OMEGA_BOX, Array, clearance, deepest_restored
from jackbox_env.simulators.base import Impact, JackLostError, Simulator, StepResult, end_of_step
from jackbox_env.tools import checks as check

DIRECTIONS = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))  # of walls 0 to 3 and of feet 0 to 3
Pair = tuple[int, int]  # wall, foot
Trace = list[tuple[list[float], list[float]]]  # states before and after each substep, without the jump at its end


class Baseline(Simulator):
    """A contact model with equal substeps of h = dt / substeps; see :class:`Simulator` for the methods.

    (state, time) determines the motion. It does not determine the record of impacts: of an engine, a later step reports
    an impact that is under way at the end of a step.
    """

    settings: ClassVar = ("substeps", "_played", "_under_way")

    def __init__(self, scene: Scene, substeps: int) -> None:
        """Start at rest in the middle of the box, each foot facing a corner.

        Raises:
            TypeError, ValueError: substeps not from 1 to 1,000,000, or a scene with side forces.
        """
        if scene.drive is not None and scene.drive.force_means:
            raise ValueError(f"a baseline must have a scene without side forces, got {check.shown(scene.drive)}")
        super().__init__(scene)
        self.substeps = check.whole("substeps", substeps, at_least=1, at_most=1_000_000)
        self._played: tuple[StepResult, float, float | None] | None = None  # before the last step; h; torque
        self._under_way: list[tuple[Impact, bool]] = []  # impacts not reported yet, and whether each continues
        self._build_unpickled()

    def _as_stored(self, state: Array) -> list[float]:
        return [float(number) for number in state]

    @override
    def stepped(self, dt: float, torque: float | None) -> StepResult:
        now = self._present
        end, h = end_of_step(now.time, dt), dt / self.substeps
        impacts = list(self._under_way)
        after, mean = self._simulate(list(now.state), now.time, h, torque, impacts)
        outside, deepest = -clearance(self.scene, after), deepest_restored(self.scene)
        if not (outside <= deepest and math.isfinite(sum(after))):
            raise JackLostError(
                f"the jack would leave the box: after t = {now.time:g} s a foot ends {outside:.3g} m outside, at most "
                f"{deepest:g} m is followed"
            )
        finished = next((number for number, (_, going) in enumerate(impacts) if going), len(impacts))
        self._under_way, self._played = impacts[finished:], (now, h, torque)  # in time order: later ones wait too
        return StepResult(after, end, mean, tuple(hit for hit, _ in impacts[:finished]))

    @abstractmethod
    def _simulate(
        self,
        state: list[float],
        time: float,
        h: float,
        torque: float | None,
        impacts: list[tuple[Impact, bool]],
        trace: Trace | None = None,
    ) -> tuple[list[float], float]:
        """Play the substeps, independent of earlier calls; return the final state and the mean torque [N m].

        Impacts are added to ``impacts``, which has those under way, and substeps to a ``trace``.
        """

    def inside_last_step(self, simulator: Simulator, before: Array, time: float, torque: float | None) -> Between:
        """Depth and work in the repeated last step: an Inspect for :func:`jackbox_env.measure.accuracy.follow`.

        The depth is the largest at the ends of the substeps. The work is that of the true torque on the box as the
        model moved it: h * (mean torque) * (mean of omega before and after) in each substep.
        """
        assert simulator is self
        assert self._played is not None
        start, h, torque = self._played
        trace: Trace = []
        after, _ = self._simulate(list(start.state), start.time, h, torque, [], trace)
        assert after == self._present.state, "the step gave another state when it was repeated"
        works = (
            h * self._torque(start.time + number * h, h, torque) * 0.5 * (left[OMEGA_BOX] + right[OMEGA_BOX])
            for number, (left, right) in enumerate(trace)
        )
        return Between(max(-clearance(self.scene, right) for _, right in trace), sum(works))

    def _torque(self, time: float, h: float, torque: float | None) -> float:
        """Mean torque on the box in the ``h`` after ``time`` [s]."""
        return torque if torque is not None else 0.5 * sum((self.scene.drive or Drive()).torque_means(time, h))

    def reset(self, state: object, time: float = 0.0) -> None:
        """Set state and time as :meth:`Simulator.reset` does; an impact under way is forgotten."""
        super().reset(state, time)  # type: ignore[arg-type]
        self._under_way = []


class Engine(Baseline):
    """A baseline that an engine steps: its state is set at every control step, its torque at every substep."""

    def _simulate(
        self,
        state: list[float],
        time: float,
        h: float,
        torque: float | None,
        impacts: list[tuple[Impact, bool]],
        trace: Trace | None = None,
    ) -> tuple[list[float], float]:
        self._set_state(state, h)
        total, after = 0.0, state
        for number in range(self.substeps):
            start = time + number * h
            load = self._torque(start, h, torque)
            total += load
            _enter(impacts, start, self._substep(h, load))
            if trace is not None:
                before, after = after, self._read()
                trace.append((before, after))
        after = self._read()
        impacts[:] = [(hit, going and not self._is_over(after, hit.wall, hit.foot)) for hit, going in impacts]
        return after, total / self.substeps

    @abstractmethod
    def _set_state(self, state: list[float], h: float) -> None:
        """Set the engine's state, to continue with substeps of ``h`` [s]."""

    @abstractmethod
    def _substep(self, h: float, torque: float) -> dict[Pair, float]:
        """Play one substep. Return the impulses of the contacts that pushed, detected at its start [N s]."""

    def _is_over(self, state: list[float], wall: int, foot: int) -> bool:
        """Whether a contact that pushed in the last substep has ended; unless overridden, it ends with the substep."""
        return True

    @abstractmethod
    def _read(self) -> list[float]:
        """The engine's state, 12 numbers."""


def _enter(impacts: list[tuple[Impact, bool]], time: float, pushes: dict[Pair, float]) -> None:
    """A foot that pushes on a wall in consecutive substeps makes one impact, at the first push [s] [N s]."""
    rest = dict(pushes)
    for number, (hit, going) in enumerate(impacts):
        more = rest.pop((hit.wall, hit.foot), None) if going else None
        impacts[number] = hit._replace(impulse=hit.impulse + (more or 0.0)), more is not None
    impacts += [(Impact(time, *pair, impulse), True) for pair, impulse in rest.items()]
