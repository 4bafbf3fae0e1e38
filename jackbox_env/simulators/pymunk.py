"""``contact="pymunk"``: fixed substeps in the Chipmunk engine.

Law: contacts that overlap at a substep's end obey the simultaneous Newton law of
    :func:`jackbox_env.mechanics.simultaneous_impact_map`, solved by sequential impulses. Between contacts flight is
    exact under gravity, constant torques and smooth drives.
Order: first in the substep h = dt / substeps: impacts are resolved at the end of their substep.
Cost: about the engine's own if a contact is possible within the step; otherwise flight is in closed form without the
    engine. A step that ends in contact adds two empty engine steps.
Fails: a step in which a foot could move further than min(1 m, L) within a substep, or that ends with a foot deeper than
    that in a wall (above 200 m/s at h = 5 ms), is repeated with up to 64 times the substeps. If that is not enough it
    raises JackLostError.
    A foot that enters and leaves a wall within a substep is missed. Bounces that last only a few substeps return too
    fast.
    Below restitution 1 a foot that sank v h into a wall is lifted out again, which returns up to m_j g v h of the
    energy that the impact dissipated.
    A jack inertia far below m_j l^2 couples the feet so strongly that the contact solver needs more iterations. The
    scene determines their number; scenes that need more than 100,000 raise ValueError.
    A jack with an arm longer than L can be wedged: feet deep in opposite walls have almost no leverage, and no number
    of iterations is enough. Feet that a coarse substep drives deep into walls need more iterations, too. If an elastic
    scene does not conserve its energy to 1e-6 over a step with several simultaneous contacts, the step is divided
    further, and raises JackLostError if that does not help. A scene with loss is off by a few percent there.
Bits: the same on every CPU on which the C library's cosine, sine, exp and pow have the same last place. The engine uses
    cosines and sines of both angles wherever a contact is possible, the chirp uses a sine, the observation cosines and
    sines. Restitution below 1 uses exp and pow. With one glibc that is every x86-64 CPU with FMA and AVX2 (from
    2013 or 2015 on); without them one cosine in 1,500 differs.
Reference: Catto 2005, "Iterative dynamics with temporal coherence"; pymunk 7.3 (Munk2D).

How the engine obeys the law:

- It moves first, by v h, then changes v by a h. Started from v + a h/2 its positions under constant acceleration are
  exact, and v - a h/2 is the velocity at the step's end. A drive that varies enters through its averages over each
  substep under a falling and under a rising triangle, so the box goes exactly where the drive takes it.
- Feet are circles of radius 0, walls are segments fattened by R (100 m by default) and set back by R: the engine finds
  a foot anywhere in them, only a foot that passes R within a substep is lost.
- Position correction is off at e = 1: it would add energy. A jack that loses energy comes to rest on a wall, and
  would sink in where the wall turns under it: below e = 1 overlap decays at the rate (1 - e) / 0.05 s.
- Each step uses a frame at the box's centre, so accuracy does not depend on the distance from the origin.
- Cached contacts and the order in the spatial index are state besides (state, time). So walls and feet share the same
  few cells of a spatial hash, and after a step that ends in contact the engine drops it by stepping with the jack far
  away. Then (state, time) determines the motion bitwise.
"""

from __future__ import annotations

import math
from typing import NamedTuple, cast

import pymunk
from pymunk.batch import BodyFields, Buffer, get_space_bodies
from typing_extensions import override

from jackbox_env.model.mechanics import energy_of
from jackbox_env.model.scene import Drive, Scene
from jackbox_env.model.states import (
    OMEGA_BOX,
    RATES,
    VX_BOX,
    VX_JACK,
    VY_BOX,
    VY_JACK,
    X_BOX,
    X_JACK,
    Y_BOX,
    Y_JACK,
    Array,
    clearance,
    deepest_restored,
    total,
)
from jackbox_env.simulators.base import JackLostError, Simulator, StepResult, end_of_step
from jackbox_env.simulators.contacts import ContactRecorder, iterations_for
from jackbox_env.simulators.flight import after_flight, reach
from jackbox_env.simulators.replay import replayed
from jackbox_env.tools import checks as check

_WALL_THICKNESS = 100.0 / 6.0  # R over L: 100 m by default
_HASH_CELL = 1000.0 / 6.0  # over L: 1000 m by default
_FARTHEST = 1e9  # over L: motion within one step that the spatial hash can index
_FINER = (1, 2, 4, 8, 16, 32, 64)  # by which a step too fast for its substeps is divided further
_UNRESOLVED = 1e-6  # of the energy in a step with contacts that strain the solver: it stopped short
_PERSISTENCE = 1  # substeps for which the engine remembers a contact that has ended; 0 would turn collisions off
_CORRECTION_TIME = 0.05  # in which overlap decays to 1 / e at restitution 0 [s]
_ROUNDING = 1e-9  # over L: more than that of a gap
_FAR_OFF = 500.0  # over L: out of reach of every wall, whose far ends are 55 L away
_set_force, _set_torque = (vars(pymunk.Body)[name].fset for name in ("force", "torque"))  # faster than assigning
_MOTION = BodyFields.POSITION | BodyFields.ANGLE | BodyFields.VELOCITY | BodyFields.ANGULAR_VELOCITY


class _Load(NamedTuple):
    """A torque or force in the form that the engine needs; all in N m or N.

    Engine step k changes the velocity from the middle of substep k to the middle of substep k + 1: by the rising
    average of substep k and the falling average of substep k + 1. The last step goes half a substep too far, which is
    taken back.
    """

    first: float  # half a substep of it takes the rate from the step's start to the middle of the first substep
    during: list[float]  # acts in each engine step, from the middle of one substep to the middle of the next
    last: float  # half a substep of it is taken back at the step's end
    mean: float
    peak: float

    @classmethod
    def held(cls, value: float, substeps: int) -> _Load:
        return cls(value, [value] * substeps, value, value, abs(value))

    @classmethod
    def of(cls, means: list[tuple[float, float]]) -> _Load:
        """The load whose averages over each substep, under a falling and a rising triangle, are ``means``."""
        falling = [mean[0] for mean in means]
        rising = [mean[1] for mean in means]
        during = [0.5 * (now + after) for now, after in zip(rising, [*falling[1:], rising[-1]], strict=True)]
        mean = (total(falling) + total(rising)) / (2.0 * len(means))
        return cls(falling[0], during, rising[-1], mean, max(map(abs, falling + rising)))


class PymunkSimulator(Simulator):
    """Time stepping in pymunk; the module's head states the law, :class:`Simulator` the methods."""

    name = "pymunk"
    settings = ("substeps", "iterations")
    room = 130_000
    _dirty: bool  # whether the engine may remember something that (state, time) does not determine

    def __init__(self, scene: Scene, substeps: int = 4, iterations: int | None = None) -> None:
        """Start at rest in the middle of the box, each foot facing a corner.

        Args:
            scene: what to simulate.
            substeps: engine steps per call of :meth:`step`, 1 to 1,000,000.
            iterations: of the contact solver, 1 to 1,000,000; None: as many as the scene needs, 64 at least.

        Raises:
            TypeError, ValueError: substeps or iterations is no whole number in its range, or the scene needs too many.
        """
        self.substeps = check.whole("substeps", substeps, at_least=1, at_most=1_000_000)
        if iterations is None:
            iterations = iterations_for(scene)
        self.iterations = check.whole("iterations", iterations, at_least=1, at_most=1_000_000)
        super().__init__(scene)

    # -- stepping -----------------------------------------------------------------------------------------------------

    @override
    def stepped(self, dt: float, torque: float | None) -> StepResult:
        state, time = self._present[:2]
        end = end_of_step(time, dt)
        if self._may_touch(dt, torque):
            after, mean_torque = self._step_engine(dt, torque)
            return StepResult(after, end, mean_torque, tuple(self._recorder.impacts))
        falling, rising = self._drive.torque_means(time, dt) if torque is None else (torque, torque)
        return StepResult(after_flight(self.scene, state, dt, falling, rising), end, 0.5 * (falling + rising))

    @property
    def _numbers(self) -> list[float]:
        """The present state's 12 numbers."""
        return cast(list[float], self._present.state)

    def _as_stored(self, state: Array) -> list[float]:
        """The state as Python's numbers."""
        return cast(list[float], state.tolist())

    def _may_touch(self, dt: float, torque: float | None) -> bool:
        """Whether a foot may reach a wall within ``dt`` [s]; flight is in closed form if none can."""
        scene, state, drive = self.scene, self._numbers, self._drive
        bound = drive.torque_bound if torque is None else abs(torque)
        moves = reach(scene, state, dt, bound, drive.force_bound)
        # Most often the circle through the feet is far enough from all walls.
        distance = math.hypot(state[X_JACK] - state[X_BOX], state[Y_JACK] - state[Y_BOX])
        if scene.box_half_width * (1.0 - _ROUNDING) - scene.jack_arm - distance > moves:
            return False
        return not clearance(scene, state) > moves

    def _step_engine(self, dt: float, torque: float | None) -> tuple[list[float], float]:
        """Step the engine, in substeps as fine as the speed needs; return state and mean torque."""
        self._refuse_runaway(dt)
        if self._dirty:  # the last step was cut short, between two steps of the engine
            self._forget_contacts()
        self._dirty = True  # until the engine has forgotten this step, also if it is cut short
        unresolved = False
        for finer in _FINER:
            substeps = finer * self.substeps
            h = check.real("dt / substeps", dt / substeps, above=0.0)
            load, push = self._loads(h, substeps, torque)
            # How far a foot may move against the walls within one substep [m]; perhaps infinite or NaN.
            moves = reach(self.scene, self._numbers, h, load.peak, sum(force.peak for force in push))
            if not moves <= self._deepest:
                continue
            self._recorder.start(self.time)
            after = self._advance(h, load, push)
            moves = -clearance(self.scene, after)
            followed = moves <= self._deepest and math.isfinite(sum(after))
            strained = followed and self.scene.elastic and self._recorder.strained
            unresolved = strained and not self._resolved(after, dt, torque)
            if followed and not unresolved:
                if self._recorder.last_contact >= substeps - (_PERSISTENCE + 1):  # the engine may still remember it
                    after = self._corrected(after, self._forget_contacts(), h)
                self._dirty = False
                return after, load.mean
            self._forget_contacts()
        self._build()  # it may have overflowed
        if unresolved:
            raise JackLostError(
                f"in the step of dt = {dt:g} s after t = {self.time:g} s the contacts gain or lose energy: substeps of "
                f"h = {h:.3g} s are too long, or the jack is wedged between walls; use more of them, a smaller time "
                "step or contact='exact'"
            )
        raise JackLostError(
            f"the jack would leave the box: after t = {self.time:g} s a foot moves {moves:.3g} m in h = {h:.3g} s, or "
            f"ends so far outside, at most {self._deepest:g} m is followed; use more substeps, a smaller time step or "
            "less torque"
        )

    def _resolved(self, after: list[float], dt: float, torque: float | None) -> bool:
        """Whether the contact solver kept the energy of an elastic step with contacts that strain it."""
        scene, before, time = self.scene, self._numbers, self.time
        work = replayed(scene, before, time, self._recorder.impacts, time + dt, torque).work
        kinetic = energy_of(scene, before) - scene.jack_mass * scene.gravity * before[Y_JACK]
        gained = energy_of(scene, after) - energy_of(scene, before)
        return abs(gained - work) <= _UNRESOLVED * (kinetic + abs(work))

    def _refuse_runaway(self, dt: float) -> None:
        """Refuse motion that would overflow the engine's spatial hash, which may loop forever on it."""
        state, farthest = self._numbers, _FARTHEST * self.scene.box_half_width
        travel = dt * max(abs(state[VX_BOX]), abs(state[VY_BOX]), abs(state[VX_JACK]), abs(state[VY_JACK]))
        if not travel <= farthest:
            raise JackLostError(
                f"the jack would leave the box: it or the box moves {travel:.3g} m within dt = {dt:g} s, at most "
                f"{farthest:.3g} m is followed; use a smaller time step or speed"
            )

    def _loads(self, h: float, substeps: int, torque: float | None) -> tuple[_Load, tuple[_Load, ...]]:
        """The torque, and the side forces along x and y if there are any."""
        times = [self.time + k * h for k in range(substeps)]
        if torque is None:
            load = _Load.of([self._drive.torque_means(time, h) for time in times])
        else:
            load = _Load.held(torque, substeps)
        return load, tuple(_Load.of([means(time, h) for time in times]) for means in self._drive.force_means)

    def _advance(self, h: float, load: _Load, push: tuple[_Load, ...]) -> list[float]:
        """Run the substeps from the present state and return the state after them."""
        scene, box, jack, step, recorder = self.scene, self._box, self._jack, self._space.step, self._recorder
        x, y, angle, jack_x, jack_y, jack_angle, vx, vy, omega, jack_vx, jack_vy, jack_omega = self._numbers
        half_fall = 0.5 * h * scene.gravity
        half_turn = 0.5 * h / scene.box_inertia
        half_push = 0.5 * h / scene.box_mass
        if push:
            vx, vy = vx + half_push * push[0].first, vy + half_push * push[1].first
        box.position, box.angle, box.velocity = (0.0, 0.0), angle, (vx, vy)
        box.angular_velocity = omega + half_turn * load.first
        jack.position, jack.angle, jack.velocity = (jack_x - x, jack_y - y), jack_angle, (jack_vx, jack_vy - half_fall)
        jack.angular_velocity = jack_omega
        weight = (0.0, -scene.jack_mass * scene.gravity) if scene.gravity > 0.0 else None
        for recorder.substep, torque in enumerate(load.during):
            if torque:  # the engine forgets it after each step
                _set_torque(box, torque)
            if weight:
                _set_force(jack, weight)
            if push:
                _set_force(box, (push[0].during[recorder.substep], push[1].during[recorder.substep]))
            step(h)
        recorder.check()
        after = self._read()
        after[X_BOX] += x
        after[Y_BOX] += y
        after[X_JACK] += x
        after[Y_JACK] += y
        after[OMEGA_BOX] -= half_turn * load.last
        after[VY_JACK] += half_fall
        if push:
            after[VX_BOX] -= half_push * push[0].last
            after[VY_BOX] -= half_push * push[1].last
        return after

    def _read(self) -> list[float]:
        self._motion.clear()
        get_space_bodies(self._space, _MOTION, self._motion)
        box_and_jack = memoryview(self._motion.float_buf()).cast("d").tolist()  # x, y, angle, vx, vy, omega of each
        return [*box_and_jack[0:3], *box_and_jack[6:9], *box_and_jack[3:6], *box_and_jack[9:12]]

    @property
    def _deepest(self) -> float:
        return deepest_restored(self.scene)

    # -- the engine's space -------------------------------------------------------------------------------------------

    def _build_unpickled(self) -> None:
        self._drive = Drive() if self.scene.drive is None else self.scene.drive
        self._motion = Buffer()
        self._build()

    def _forget_contacts(self) -> list[float]:
        """Let the contacts the engine remembers expire, with nothing in reach to make new ones.

        Returns:
            The rates at which the engine would have moved overlap apart in its next step: box x, y, angle, jack x, y,
            angle [m/s and rad/s]; all 0 where position correction is off.
        """
        box, jack, away = self._box, self._jack, _FAR_OFF * self.scene.box_half_width
        for body, x in ((box, 0.0), (jack, away)):
            body.position, body.velocity, body.angular_velocity = (x, 0.0), (0.0, 0.0), 0.0
            body.force, body.torque = (0.0, 0.0), 0.0
        angles = box.angle, jack.angle
        self._space.step(1.0)  # the engine applies the correction that it stored, and forgets it
        rates = [*box.position, box.angle - angles[0], jack.position.x - away, jack.position.y, jack.angle - angles[1]]
        for _ in range(_PERSISTENCE):
            self._space.step(1.0)
        return rates

    def _corrected(self, after: list[float], rates: list[float], h: float) -> list[float]:
        """A step's end with the correction of its last substep, which the engine makes only in its next step."""
        if self.scene.elastic:
            return after
        return [position + h * rate for position, rate in zip(after[:RATES], rates, strict=True)] + after[RATES:]

    def _build(self) -> None:
        scene = self.scene
        space = pymunk.Space()
        space.iterations = self.iterations
        space.collision_bias = math.exp(-(1.0 - scene.restitution) / _CORRECTION_TIME)
        space.collision_slop = 0.0
        space.collision_persistence = _PERSISTENCE
        space.use_spatial_hash(_HASH_CELL * scene.box_half_width, 16)
        box = pymunk.Body(scene.box_mass, scene.box_inertia)
        jack = pymunk.Body(scene.jack_mass, scene.jack_inertia)
        space.add(box, jack)
        thickness = _WALL_THICKNESS * scene.box_half_width
        set_back = scene.box_half_width + thickness
        extent = scene.box_half_width + 2.0 * thickness  # past the corners
        directions = [pymunk.Vec2d(1, 0), pymunk.Vec2d(0, 1), pymunk.Vec2d(-1, 0), pymunk.Vec2d(0, -1)]
        shapes = list[pymunk.Shape]()
        for normal in directions:
            middle, end = normal * set_back, normal.perpendicular() * extent
            shapes.append(pymunk.Segment(box, middle - end, middle + end, thickness))
        shapes += [pymunk.Circle(jack, 0.0, direction * scene.jack_arm) for direction in directions]
        for number, shape in enumerate(shapes):
            shape.collision_type = number
            shape.elasticity = scene.restitution if shape.body is box else 1.0  # the engine multiplies both
        space.add(*shapes)
        recorder = ContactRecorder()
        space.on_collision(None, None, post_solve=recorder)
        self._space, self._box, self._jack, self._recorder = space, box, jack, recorder
        self._dirty = False
