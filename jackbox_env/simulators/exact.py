"""``contact="exact"``: from impact to impact, each found with a guarantee, in compiled code.

Law: flight in closed form (``kernel.py``); at an impact all feet that touch, within 1e-13 m or 4 units in the last
    place of a far-off position, take the simultaneous Newton law of
    :func:`jackbox_env.mechanics.simultaneous_impact_map`.
Order: none; the error is rounding, whatever the control step. The system is chaotic and multiplies any error by about 5
    per impact, so some 15 impacts are predicted before even this one is lost. Angles are rounded to their unit in the
    last place: beyond 1e6 rad a foot may be outside by up to 4 L times that unit, 5e-10 L at 1e6 rad.
Cost: below 0.1 microseconds per control step in a batch. Work is in proportion to the impacts.
Fails: elastic scenes only. A step that wants more than 1,000,000 gap evaluations raises RuntimeError: rotation or
    impacts far too fast for the step. A chirp that turns more than 83,333 times in a step is refused. A foot at rest
    on a wall bounces by 1e-10 m and less, some thousand times per control step. A drive's functions are interpolated:
    what happens between 13 points of a smooth stretch is not seen.
Reference: Lygeros et al. 2003, "Dynamical properties of hybrid automata"; the bound is stated in ``kernel.py``.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from jackbox_env import _validation as check
from jackbox_env._compiled import compiled
from jackbox_env.mechanics import Array, as_held
from jackbox_env.scene import Chirp, Drive, Scene, too_many_turns
from jackbox_env.simulators.base import LATEST_TIME, Impact, end_of_step
from jackbox_env.simulators.drives import TABLE_WIDTH, function_pieces
from jackbox_env.simulators.kernel import MOST_WORK, TOO_MUCH_WORK
from jackbox_env.simulators.step import CHIRP, FUNCTIONS, NO_DRIVE, TOO_MANY_TURNS, step_one
from jackbox_env.simulators.workspace import RECORD, Workspace, new_workspace

_NO_PIECES: Array = np.zeros((0, TABLE_WIDTH))


def refuse_inelastic(scene: Scene) -> None:
    """Refuse a scene that loses energy.

    Raises:
        ValueError: its restitution is below 1.
    """
    if scene.restitution != 1.0:
        raise ValueError(
            f"contact='exact' is elastic only, restitution 1, got {scene.restitution!r}; contact='pymunk' takes 0 to 1"
        )


def drive_kind(scene: Scene, held: bool = False) -> int:
    """Which kind of drive the compiled code is told of, with a torque ``held`` in place of the drive's or without."""
    drive = scene.drive
    if isinstance(drive, Chirp):
        return CHIRP
    idle = drive is None or (drive.force_bound == 0.0 and (held or drive.torque_bound == 0.0))
    return NO_DRIVE if idle else FUNCTIONS


def pieces_for(scene: Scene, time: float, dt: float, torque: float | None) -> Array:
    """The pieces of a drive of functions over a step; none for any other drive, or where no function acts."""
    drive = scene.drive
    if not isinstance(drive, Drive) or drive_kind(scene, torque is not None) != FUNCTIONS:
        return _NO_PIECES
    if torque is not None:
        drive = Drive(force_x=drive.force_x, force_y=drive.force_y)
    return function_pieces(drive, time, dt)


def failure(ended: int, scene: Scene, time: float, dt: float, who: str = "the jack") -> Exception:
    """What to raise for a step that did not end well."""
    if ended == TOO_MANY_TURNS and isinstance(scene.drive, Chirp):
        return ValueError(too_many_turns(scene.drive.fastest(time, dt) * dt, time, dt))
    if ended == TOO_MUCH_WORK:
        return RuntimeError(
            f"{who} needs more than {MOST_WORK:,} gap evaluations in the dt = {dt:g} s after t = {time:g} s; use a "
            "smaller time step or less torque"
        )
    return RuntimeError(
        f"{who} moves too fast to be followed in the dt = {dt:g} s after t = {time:g} s, or is too far off; use a "
        "smaller time step, less speed or less torque"
    )


class ExactSimulator:
    """Event-driven simulation; the module's head states the law, :class:`Simulator` the methods."""

    _workspace: Workspace  # grows to what a step has recorded

    def __init__(self, scene: Scene) -> None:
        """Start at rest in the middle of the box, each foot facing a corner.

        Raises:
            ValueError: the scene is not elastic.
        """
        refuse_inelastic(scene)
        self.scene = scene
        # state (never written again), time, mean torque and impacts of the last step: replaced as one
        self._present = (np.array([0.0] * 5 + [math.pi / 4.0] + [0.0] * 6), 0.0, 0.0, list[Impact]())
        self._prepare()

    # -- state --------------------------------------------------------------------------------------------------------

    @property
    def state(self) -> Array:
        """A copy of the present state, float64, shape (12,), SI units."""
        return self._present[0].copy()

    @property
    def time(self) -> float:
        """Present time [s]."""
        return self._present[1]

    @property
    def torque(self) -> float:
        """Mean torque on the box over the last step [N m], 0 after a reset."""
        return self._present[2]

    @property
    def impacts(self) -> list[Impact]:
        """The impacts of the last step in time order; a fresh list."""
        return list(self._present[3])

    def reset(self, state: ArrayLike, time: float = 0.0) -> None:
        """See :meth:`Simulator.reset`; a foot may be at most min(1 m, L) outside, as the pymunk model leaves it.

        A foot outside that comes in is free, one that goes out bounces at once.
        """
        values = as_held(self.scene, state)
        time = check.real("time", time, at_least=-LATEST_TIME, at_most=LATEST_TIME)
        self._present = values, time, 0.0, []

    def __getstate__(self) -> dict[str, Any]:
        return {"scene": self.scene, "_present": self._present}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        self.__dict__.update(kept)
        self._prepare()

    # -- stepping -----------------------------------------------------------------------------------------------------

    def step(self, dt: float, torque: float | None = None) -> None:
        """See :meth:`Simulator.step`."""
        dt = check.real("dt", dt, above=0.0)
        if torque is not None:
            torque = check.real("torque", torque)
        before, time, _, _ = self._present
        end = end_of_step(time, dt)
        drive = self._drives[torque is not None]
        pieces = pieces_for(self.scene, time, dt, torque) if drive == FUNCTIONS else _NO_PIECES
        after = np.empty(12)
        held = math.nan if torque is None else torque
        while True:
            ended, hits, mean = self._step(
                self._numbers, dt, drive, before, after, time, held, pieces, self._workspace
            )  # fmt: skip
            if ended:
                raise failure(ended, self.scene, time, dt)
            if RECORD + hits <= len(self._workspace):
                break
            self._workspace = new_workspace(2 * hits)  # more impacts than were ever recorded: once more, with room
        self._present = after, end, mean, self._recorded(time, hits) if hits else []

    def _recorded(self, time: float, hits: int) -> list[Impact]:
        rows = self._workspace[RECORD : RECORD + hits, :4].tolist()
        return [Impact(time + since, int(wall), int(foot), impulse) for since, wall, foot, impulse in rows]

    def _prepare(self) -> None:
        self._step = compiled(step_one)
        self._numbers = np.array(self.scene.numbers)
        self._drives = drive_kind(self.scene), drive_kind(self.scene, held=True)
        self._workspace = new_workspace(64)
