"""``contact="exact"``: from impact to impact, each found with a guarantee, in compiled code.

Law: flight in closed form (``exact/flight.py``); at an impact all feet that touch, within 1e-13 m or 4 units in the
    last place of a far-off position, take the simultaneous Newton law of
    :func:`jackbox_env.mechanics.simultaneous_impact_map`. With loss, bounces pile up. A foot that would rise by 1e-13 m
    at most comes to rest; where a step takes more than 1,024 gap evaluations this limit grows, to 1e-10 m. The law too
    would take that bounce's energy, at the end of the pile. The wall then holds the foot until it would have to pull
    (``exact/rest.py``). A held foot is one impact per wall and step: at the step's end, with the impulse of the
    whole step. So ``impacts``, the environment's counts and impulses, and the task rattle see the weight that rests on
    a wall, m_j g dt in a step.
Order: none; the error is rounding, whatever the control step. The system is chaotic and multiplies any error by about 5
    per impact, so even this model predicts only some 15 impacts.
Cost: below 0.1 microseconds per control step in a batch. Work is in proportion to the impacts. A step with held feet
    takes some 5 to 6 microseconds (docs/costs.md).
Fails: a step that wants more than 1,000,000 gap evaluations raises JackLostError: rotation or impacts far too fast for
    the step. A chirp that turns more than 83,333 times in a step is refused. Without loss a foot that bounces by
    1e-10 m and less does so some thousand times per control step; a foot that reaches another wall meanwhile may be as
    deep in that wall when it bounces. With loss no foot is deeper than 2.4e-10 m. Angles are rounded to their unit in
    the last place: beyond 1e6 rad a foot may be outside by up to 4 L times that unit (5e-10 L at 1e6 rad, 5e-4 L at
    1e12 rad). A drive's functions are interpolated, see ``functions.py``: a pulse that begins and ends between two of
    the 13 points of a piece is not seen.
Bits: the same on every x86-64 CPU and under Linux on ARM, whatever the C library, for states, impacts, observations and
    rewards. Compiled code adds in the order written, fuses no product with a sum, and has its own cosines
    (``trigonometry.py``).
    Three things are the C library's: what a drive's own function takes from it (``math.sin``), the cosine of an angle
    beyond 2^53 rad, and whether a state at the very limit of what is accepted is refused.
Reference: Lygeros et al. 2003, "Dynamical properties of hybrid automata"; the bound stands in ``exact/bounds.py``.
"""

from __future__ import annotations

from functools import cache
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from jackbox_env import checks as check
from jackbox_env.exact.compiler import compiled
from jackbox_env.exact.drives import TABLE_WIDTH
from jackbox_env.exact.search import MOST_WORK
from jackbox_env.exact.step import CHIRP, CONSTANT, CONSTANT_BESIDE_FORCES, FUNCTIONS, step_one
from jackbox_env.exact.workspace import Status, new_log, new_workspaces
from jackbox_env.scene import Chirp, Drive, Scene, too_many_turns
from jackbox_env.simulators.base import ContactModel, Impact, JackLostError, Present, end_of_step
from jackbox_env.simulators.functions import function_pieces
from jackbox_env.states import Array

WITH_PIECES = (FUNCTIONS, CONSTANT_BESIDE_FORCES)  # kinds whose functions are cut into pieces
_NO_PIECES: Array = np.zeros((0, TABLE_WIDTH))


def drive_kind(drive: Chirp | Drive | None, held: bool = False) -> int:
    """The compiled code's number for what turns the box in a step: a ``held`` torque, or the scene's drive."""
    if isinstance(drive, Chirp):
        return CONSTANT if held else CHIRP
    forced = drive is not None and drive.force_bound > 0.0
    if held:
        return CONSTANT_BESIDE_FORCES if forced else CONSTANT
    return FUNCTIONS if forced or (drive is not None and drive.torque_bound > 0.0) else CONSTANT


def pieces_for(drive: Chirp | Drive | None, time: float, dt: float, torque: float | None) -> Array:
    """The pieces of a drive of functions over a step; none for any other drive, or where no function acts."""
    if not isinstance(drive, Drive) or drive_kind(drive, torque is not None) not in WITH_PIECES:
        return _NO_PIECES
    if torque is not None:
        drive = Drive(force_x=drive.force_x, force_y=drive.force_y)
    return function_pieces(drive, time, dt)


def failure(ended: int, scene: Scene, time: float, dt: float, who: str = "the jack") -> Exception:
    """What to raise for a step that did not end well."""
    if ended == Status.TOO_MANY_TURNS and isinstance(scene.drive, Chirp):
        return ValueError(too_many_turns(scene.drive.fastest(time, dt) * dt, time, dt))
    if ended == Status.TOO_MUCH_WORK:
        return JackLostError(
            f"{who} needs more than {MOST_WORK:,} gap evaluations in the dt = {dt:g} s after t = {time:g} s; use a "
            "smaller time step or less torque"
        )
    return JackLostError(
        f"{who} moves too fast to be followed in the dt = {dt:g} s after t = {time:g} s, or is too far off; use a "
        "smaller time step, less speed or less torque"
    )


@cache
def ensure_compiled() -> None:
    """Compile a step, or load it: at an episode's start, and not in its first step behind somebody's progress bar."""
    numbers, state = np.array(Scene().numbers), np.zeros(12)
    memory = new_workspaces(), new_log(64)
    compiled(step_one)(numbers, 0.02, CONSTANT, state, state.copy(), 0.0, 0.0, _NO_PIECES, *memory)


class ExactSimulator(ContactModel):
    """Event-driven simulation; the module's head states the law, :class:`Simulator` the methods."""

    name = "exact"
    room = 500
    compiled = True
    _log: Array  # grows to what a step has recorded

    def __init__(self, scene: Scene) -> None:
        """Start at rest in the middle of the box, each foot facing a corner."""
        super().__init__(scene)
        self._prepare()

    # -- stepping -----------------------------------------------------------------------------------------------------

    def reset(self, state: ArrayLike, time: float = 0.0) -> None:
        """See :meth:`Simulator.reset`."""
        ensure_compiled()
        super().reset(state, time)

    def step(self, dt: float, torque: float | None = None) -> None:
        """See :meth:`Simulator.step`."""
        dt = check.real("dt", dt, above=0.0)
        if torque is not None:
            torque = check.real("torque", torque)
        before, time = cast(Array, self._present.state), self.time
        end = end_of_step(time, dt)
        kind = self._kinds[torque is not None]
        pieces = pieces_for(self.scene.drive, time, dt, torque) if kind in WITH_PIECES else _NO_PIECES
        after = np.empty(12)
        held = 0.0 if torque is None else torque
        while True:
            ended, hits, mean = self._step(
                self._numbers, dt, kind, before, after, time, held, pieces, self._workspaces, self._log
            )  # fmt: skip
            if ended:
                raise failure(ended, self.scene, time, dt)
            if hits <= len(self._log):
                break
            self._log = new_log(2 * hits)  # more impacts than there was room for: repeat the step with room
        self._present = Present(after, end, mean, self._recorded(time, hits) if hits else ())

    def _recorded(self, time: float, hits: int) -> tuple[Impact, ...]:
        rows = self._log[:hits].tolist()
        return tuple(Impact(time + since, int(wall), int(foot), impulse) for since, wall, foot, impulse in rows)

    def _prepare(self) -> None:
        self._step = compiled(step_one)
        self._numbers = np.array(self.scene.numbers)
        self._kinds = drive_kind(self.scene.drive), drive_kind(self.scene.drive, held=True)
        self._workspaces, self._log = new_workspaces(), new_log(64)
