"""What every contact model offers: the Simulator interface and the record of an impact."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from numpy.typing import ArrayLike

from jackbox_env.scene import Scene
from jackbox_env.states import LATEST_TIME, Array


class Impact(NamedTuple):
    """One impact of one foot on one wall.

    Attributes:
        time: absolute time [s].
        wall: 0..3, outward normal at theta_box + wall pi/2.
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
    total = 0.0
    for impact in impacts:
        total += impact.impulse
    return total


class Simulator(Protocol):
    """A contact model that carries a state (12 float64, see :mod:`jackbox_env.mechanics`) through time.

    A step depends on nothing but (state, time) and its arguments: the same call from the same state gives bitwise the
    same result, whatever the simulator did before, also after pickling and copying.
    """

    @property
    def scene(self) -> Scene:
        """The scene simulated."""

    @property
    def state(self) -> Array:
        """A copy of the present state, float64, shape (12,), SI units."""

    @property
    def time(self) -> float:
        """Present time [s]."""

    @property
    def torque(self) -> float:
        """Mean torque on the box over the last step [N m], 0 after a reset."""

    @property
    def impacts(self) -> list[Impact]:
        """The impacts of the last step in time order; a fresh list."""

    def reset(self, state: ArrayLike, time: float = 0.0) -> None:
        """Set the state, shape (12,), and the time [s], exactly.

        Raises:
            TypeError, ValueError: unusable values; the simulator stays as it was.
        """

    def step(self, dt: float, torque: float | None = None) -> None:
        """Advance by ``dt`` > 0 [s] under a held ``torque`` on the box [N m], or under the scene's drive (None).

        ``torque`` replaces the drive's torque only: its side forces act all the same.

        Raises:
            TypeError, ValueError: unusable values.
            RuntimeError: the jack would leave the box. After any error the simulator is as it was.
        """
