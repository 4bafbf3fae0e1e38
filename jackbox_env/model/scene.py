"""The scene: geometry, masses, gravity, restitution, and the drive that moves the box.

Nothing here simulates. Lengths are in m, masses in kg, inertias in kg m^2, torques in N m, forces in N, times in s.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from functools import partial
from typing import Any, ClassVar, NamedTuple

from jackbox_env.tools import checks as check

# Gauss-Legendre nodes and weights with five points on [0, 1]: exact for polynomials of degree 9.
_GAUSS = (
    (0.04691007703066800, 0.11846344252809454),
    (0.23076534494715845, 0.23931433524968324),
    (0.5, 0.28444444444444444),
    (0.76923465505284155, 0.23931433524968324),
    (0.95308992296933200, 0.11846344252809454),
)

# A panel of a twelfth of a turn: five points integrate a sine over it to 1e-15 of its amplitude.
_PANELS_PER_TURN = 12
# A chirp that turns more often within one step would take seconds to follow.
MOST_TURNS = 83_333
# The least and the largest value of each of a scene's numbers, in the order in which they are checked. Lengths, masses
# and inertias outside 1e-60 to 1e60 would under- or overflow once squared and multiplied.
BOUNDS = {
    **dict.fromkeys(("box_half_width", "box_mass", "jack_arm", "jack_mass", "torque_limit"), (1e-60, 1e60)),
    **dict.fromkeys(("box_inertia", "jack_inertia"), (1e-60, 1e60)),
    "gravity": (0.0, 1e60),
    "restitution": (0.0, 1.0),
}


def _hat_means(signal: Callable[[float], float], duration: float, panels: int = 1) -> tuple[float, float]:
    """Average ``signal(s)`` over 0 <= s <= duration under a falling and under a rising triangle.

    With T the duration these are 2/T^2 int (T - s) f(s) ds and 2/T^2 int s f(s) ds. A constant acceleration of
    the first moves a coordinate as far in T as f does. One of the mean of both changes its rate as much as f does.
    """
    falling = rising = 0.0
    for panel in range(panels):
        for node, weight in _GAUSS:
            share = (panel + node) / panels  # s / T
            part = weight * signal(share * duration)
            rising += part * share
            falling += part * (1.0 - share)
    return 2.0 * falling / panels, 2.0 * rising / panels


def _two_product(a: float, b: float) -> tuple[float, float]:
    """Return a*b as an unevaluated sum of two floats (Dekker 1971, "A floating-point technique", Mul12)."""
    product = a * b
    split = 134217729.0 * a
    a_high = split - (split - a)
    a_low = a - a_high
    split = 134217729.0 * b
    b_high = split - (split - b)
    b_low = b - b_high
    return product, ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


def remainder(x: float, y: float) -> float:
    """``x`` modulo ``y``, for 0 <= ``x`` < 2^53 ``y``, with the bits of ``%``, which GPUs round.

    It is exact: the quotient is at most one too large, and neither difference needs more digits than ``y``.
    """
    multiple, error = _two_product(float(math.floor(x / y)), y)
    rest = (x - multiple) - error
    return rest + y if rest < 0.0 else rest


def chirp_turns(start_frequency: float, rate: float, time: float) -> float:
    """Phase f0 t + k t^2 / 2 at ``time`` in turns, less a whole number; its error does not grow with the time."""
    linear, linear_error = _two_product(start_frequency, time)
    square, square_error = _two_product(time, time)
    growth, growth_error = _two_product(0.5 * rate, square)
    errors = linear_error + growth_error + 0.5 * rate * square_error
    return linear % 1.0 + growth % 1.0 + errors


def too_many_turns(turns: float, time: float, duration: float) -> str:
    """The sentence that refuses a chirp too fast for a step."""
    return (
        f"the chirp turns {turns:.3g} times in the {duration:g} s after t = {time:g} s, "
        f"at most {MOST_TURNS} turns in one step or substep can be followed"
    )


@dataclass(frozen=True)
class Chirp:
    """The torque ``amplitude * sin(2 pi (start_frequency t + rate t^2 / 2))`` on the box.

    >>> Chirp(amplitude=100.0, start_frequency=1.0, rate=0.0).torque(0.25)
    100.0

    Attributes:
        amplitude: [N m], any finite number.
        start_frequency: frequency at t = 0 [Hz], from -1e9 to 1e9.
        rate: growth of the frequency [Hz/s], from -1e9 to 1e9; 0 is a plain sine.

    Raises:
        TypeError, ValueError: a parameter is not a finite number in its range.
    """

    amplitude: float = 90000.0  # [N m] gain 30000 times 3
    start_frequency: float = 0.5  # [Hz]
    rate: float = 0.9  # [Hz/s]
    force_bound: ClassVar[float] = 0.0  # a chirp has no side force [N]
    force_means: ClassVar[tuple[()]] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "amplitude", check.real("amplitude", self.amplitude, at_least=-1e60, at_most=1e60))
        for name in ("start_frequency", "rate"):
            object.__setattr__(self, name, check.real(name, getattr(self, name), at_least=-1e9, at_most=1e9))

    def torque(self, time: float) -> float:
        """Torque on the box [N m] at ``time`` [s]."""
        return self.amplitude * math.sin(2.0 * math.pi * chirp_turns(self.start_frequency, self.rate, time))

    def fastest(self, time: float, duration: float) -> float:
        """Highest frequency within [time, time + duration] [Hz]."""
        return abs(self.start_frequency + self.rate * (time + 0.5 * duration)) + 0.5 * abs(self.rate) * duration

    @property
    def torque_bound(self) -> float:
        """The torque never exceeds this [N m]."""
        return abs(self.amplitude)

    def torque_means(self, time: float, duration: float) -> tuple[float, float]:
        """Torque over [time, time + duration] [N m], averaged under a falling and under a rising triangle.

        Five-point Gauss-Legendre quadrature on panels of at most a twelfth of a turn.

        Raises:
            ValueError: the chirp turns more than 83,333 times in the interval.
        """
        middle = time + 0.5 * duration
        phase = chirp_turns(self.start_frequency, self.rate, middle)
        frequency = self.start_frequency + self.rate * middle  # [Hz]
        turns = self.fastest(time, duration) * duration
        if not turns <= MOST_TURNS:
            raise ValueError(too_many_turns(turns, time, duration))

        half_rate, half = 0.5 * self.rate, middle - time  # not duration / 2: a late middle is rounded

        def signal(since: float) -> float:
            offset = since - half
            return math.sin(2.0 * math.pi * (phase + (frequency + half_rate * offset) * offset))

        falling, rising = _hat_means(signal, duration, max(1, math.ceil(_PANELS_PER_TURN * turns)))
        return self.amplitude * falling, self.amplitude * rising


@dataclass(frozen=True)
class Drive:
    """A drive given by functions of time, ``Scene(drive=Drive(torque=lambda time: 9000.0 * time))``.

    Each function has one argument, the time as a Python float [s], and returns a finite number. The pymunk model
    samples it at five points of every substep, so it should be smooth on that scale. The exact model interpolates it to
    rounding and locates each jump within 2^-44 of the control step, or within the spacing of float64 times if that is
    wider. It samples 13 points of each smooth stretch, at most 0.13 of it apart, and misses a pulse between two.
    A Drive has no JSON form, so an environment made with one cannot write its spec as JSON. Bits are the same on
    machines on which the functions return the same; the last place of ``math.sin`` depends on the C library.

    Attributes:
        torque: torque on the box [N m].
        force_x: force on the box's centre along the world's x [N].
        force_y: force on the box's centre along the world's y [N], besides the lift that carries the box.

    Raises:
        TypeError: something that is neither a function nor None.
    """

    torque: Callable[[float], float] | None = None
    force_x: Callable[[float], float] | None = None
    force_y: Callable[[float], float] | None = None

    def __post_init__(self) -> None:
        for part in fields(self):
            function = getattr(self, part.name)
            if function is not None and not callable(function):
                raise TypeError(f"{part.name} must be a function of the time in s or None, got {check.shown(function)}")

    @property
    def torque_bound(self) -> float:
        """The torque never exceeds this [N m]: infinite for a function, 0 without one."""
        return 0.0 if self.torque is None else math.inf

    @property
    def force_bound(self) -> float:
        """The side force never exceeds this [N]: infinite for functions, 0 without any."""
        return 0.0 if self.force_x is None and self.force_y is None else math.inf

    def torque_means(self, time: float, duration: float) -> tuple[float, float]:
        """Torque over [time, time + duration] [N m], averaged as by :class:`Chirp`, with one five-point panel."""
        return self._means("torque", time, duration)

    @property
    def force_means(self) -> tuple[Callable[[float, float], tuple[float, float]], ...]:
        """The functions that correspond to ``torque_means`` for the forces along x and y [N]; empty if neither acts."""
        return () if self.force_bound == 0.0 else (partial(self._means, "force_x"), partial(self._means, "force_y"))

    def _means(self, part: str, time: float, duration: float) -> tuple[float, float]:
        function = getattr(self, part)
        if function is None:
            return 0.0, 0.0
        return _hat_means(lambda since: check.real(f"{part}({time + since:g} s)", function(time + since)), duration)


class SceneNumbers(NamedTuple):
    """A scene and its chirp as plain numbers, under the scene's own names.

    It replaces a Scene in compiled code, and in a task's functions under every contact model. The chirp's numbers are
    0 if the drive is not a Chirp.
    """

    box_half_width: float  # [m]
    box_mass: float  # [kg]
    box_inertia: float  # [kg m^2]
    jack_arm: float  # [m]
    jack_mass: float  # [kg]
    jack_inertia: float  # [kg m^2]
    gravity: float  # [m/s^2]
    torque_limit: float  # [N m]
    speed_scale: float  # [m/s]
    chirp_amplitude: float  # [N m]
    chirp_start_frequency: float  # [Hz]
    chirp_rate: float  # [Hz/s]
    restitution: float


def square_inertia(mass: float, length: float) -> float:
    """Inertia [kg m^2] of a mass [kg] all of which is ``length`` [m] from the axis.

    A product, because the last place of a power is the C library's.
    """
    return mass * (length * length)


def fall_speed(height: float) -> float:
    """Speed after a fall from a height [m] on Earth [m/s]."""
    return math.sqrt(2.0 * 9.81 * height)


@dataclass(frozen=True)
class Scene:
    """All parameters of the physics. Frozen; every number is a Python float.

    Attributes:
        box_half_width: L, the walls are at +-L in the box frame [m].
        box_mass: m_b [kg].
        box_inertia: J_b [kg m^2]; None: m_b L^2, which the attribute then is.
        jack_arm: l, distance of each foot from the jack's centre [m]; below sqrt(2) L, or the jack fits at no angle.
        jack_mass: m_j [kg].
        jack_inertia: J_j [kg m^2]; None: m_j l^2 (four point feet), which the attribute then is.
        gravity: g, acts downwards on the jack; the box's weight is lifted [m/s^2], >= 0.
        restitution: e, 0 <= e <= 1.
        torque_limit: torque of an agent's action 1 [N m].
        drive: a Chirp, a Drive, a dict of Chirp's fields, or None. Its torque acts unless an agent's does, its side
            forces always.

    Torque limit and drive do not scale with the box: a small or light box needs less of both. Lengths, masses, inertias
    and the torque limit are within [1e-60, 1e60]. :meth:`changed` derives an inertia anew that was not given;
    ``dataclasses.replace`` keeps it.

    >>> scene = Scene(box_half_width=3.0, restitution=0.8)
    >>> scene.box_inertia, scene.elastic
    (3600.0, False)

    Raises:
        TypeError, ValueError: a field is of the wrong type or out of its range.
    """

    box_half_width: float = 6.0  # [m]
    box_mass: float = 400.0  # [kg] four walls of 100 kg
    box_inertia: float = None  # type: ignore[assignment]  # [kg m^2] resolved below, never None afterwards
    jack_arm: float = 1.0  # [m]
    jack_mass: float = 4.0  # [kg] four feet of 1 kg
    jack_inertia: float = None  # type: ignore[assignment]  # [kg m^2]
    gravity: float = 9.81  # [m/s^2]
    restitution: float = 1.0
    torque_limit: float = 90000.0  # [N m]
    drive: Chirp | Drive | None = field(default_factory=Chirp)

    def __post_init__(self) -> None:
        assign = partial(object.__setattr__, self)
        assign("_derived", tuple(name for name in ("box_inertia", "jack_inertia") if getattr(self, name) is None))
        for name, (least, largest) in BOUNDS.items():
            if name in self.derived:
                size = self.box_half_width if name == "box_inertia" else self.jack_arm
                assign(name, square_inertia(getattr(self, name.replace("inertia", "mass")), size))
            assign(name, check.real(name, getattr(self, name), at_least=least, at_most=largest))
        largest_arm = math.sqrt(2.0) * self.box_half_width
        if self.jack_arm >= largest_arm:
            raise ValueError(
                f"jack_arm must be below sqrt(2) * box_half_width = {largest_arm:g} m to fit, got {self.jack_arm:g} m"
            )
        if isinstance(self.drive, Mapping):
            check.known_keys("drive", self.drive, (part.name for part in fields(Chirp)))
            assign("drive", Chirp(**self.drive))
        if not isinstance(self.drive, Chirp | Drive | None):
            hint = ": for a function f of the time write Drive(torque=f)" if callable(self.drive) else ""
            raise TypeError(
                f"drive must be a Chirp, a Drive, a dict of Chirp's fields or None, got {check.shown(self.drive)}{hint}"
            )

    @classmethod
    def of(cls, given: Scene | Mapping[str, Any] | None) -> Scene:
        """Return a scene from a Scene, from a dict of some of its fields, or from None (the default scene).

        Raises:
            TypeError, ValueError: something else, an unknown field, or a field out of its range.
        """
        if given is None or isinstance(given, cls):
            return given or cls()
        if not isinstance(given, Mapping):
            raise TypeError(f"scene must be a Scene, a dict of its fields or None, got {check.shown(given)}")
        check.known_keys("scene", given, (part.name for part in fields(cls)))
        return cls(**given)

    def as_dict(self) -> dict[str, Any]:
        """The fields from which :meth:`of` makes this scene, for JSON; ValueError for a Drive, which has functions."""
        if isinstance(self.drive, Drive):
            raise ValueError("a Drive of functions has no JSON form, got one")
        return {name: value for name, value in asdict(self).items() if name not in self.derived}

    def changed(self, **values: Any) -> Scene:
        """This scene with other values of some fields; an inertia that was not given follows mass and size.

        >>> Scene().changed(jack_mass=8.0).jack_inertia
        8.0

        Raises:
            TypeError, ValueError: an unknown field, or a value out of its range.
        """
        names = [part.name for part in fields(self)]
        check.known_keys("scene", values, names)
        present = {name: getattr(self, name) for name in names if name not in self.derived}
        return Scene(**{**present, **values})

    @property
    def derived(self) -> tuple[str, ...]:
        """The inertias that were not given: names of "box_inertia" and "jack_inertia"."""
        return self._derived  # type: ignore[attr-defined, no-any-return]

    @property
    def elastic(self) -> bool:
        """Whether impacts conserve the energy: restitution 1."""
        return self.restitution == 1.0

    @property
    def mass_diagonal(self) -> tuple[float, float, float, float, float, float]:
        """Diagonal of the mass matrix M for q = (box x, y, angle, jack x, y, angle) [kg, kg, kg m^2, twice]."""
        return (self.box_mass,) * 2 + (self.box_inertia,) + (self.jack_mass,) * 2 + (self.jack_inertia,)

    @property
    def speed_scale(self) -> float:
        """v0 = sqrt(2 * 9.81 * L) [m/s], the unit of speed: after a fall of L on Earth, whatever ``gravity`` is."""
        return fall_speed(self.box_half_width)

    @property
    def numbers(self) -> SceneNumbers:
        """The scene as plain numbers; those of the chirp are 0 if the drive is not a Chirp."""
        values = {name: getattr(self, name) for name in SceneNumbers._fields if hasattr(self, name)}
        chirp = self.drive if isinstance(self.drive, Chirp) else Chirp(0.0, 0.0, 0.0)
        return SceneNumbers(
            **values, chirp_amplitude=chirp.amplitude, chirp_start_frequency=chirp.start_frequency,
            chirp_rate=chirp.rate,
        )  # fmt: skip


for _kind in (Chirp, Drive, Scene):  # an unknown field is refused with the closest one
    _kind.__init__ = check.refuse_unknown(_kind.__name__, {})(_kind.__init__)  # type: ignore[method-assign]


def scenes_of(scene: Any) -> tuple[list[Scene], bool]:
    """The scenes from one scene, or from a list with one for each environment or row; whether it was a list.

    Raises:
        TypeError, ValueError: as :meth:`Scene.of`; an empty list.
    """
    if isinstance(scene, str) or not isinstance(scene, Sequence):
        return [Scene.of(scene)], False  # type: ignore[arg-type]  # anything else raises
    if not len(scene):
        raise ValueError("scene must be one scene or a list of at least one, got an empty list")
    scenes = list[Scene]()
    for number, one in enumerate(scene):
        try:
            scenes.append(Scene.of(one))
        except (TypeError, ValueError) as error:
            raise type(error)(f"scene[{number}]: {error}") from error
    return scenes, True
