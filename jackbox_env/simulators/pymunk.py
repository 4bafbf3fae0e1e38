"""``contact="pymunk"``: fixed substeps in the Chipmunk engine.

Law: contacts that overlap at a substep's end take the simultaneous Newton law of
    :func:`jackbox_env.mechanics.simultaneous_impact_map`, solved by sequential impulses. Between contacts flight is
    exact for gravity, held torque and smooth drives alike.
Order: first in the substep h = dt / substeps: an impact waits for the end of the substep it happens in.
Cost: about the engine's own where a contact is possible within the step; elsewhere the flight is closed form and the
    engine is not asked at all. A step that ends with a contact alive adds two empty engine steps.
Fails: a step that ends with a foot deeper than min(1 m, L) in a wall (speed times h: above 200 m/s at h = 5 ms) is
    taken again with up to 8 times the substeps; if that is not enough it raises RuntimeError. Slow bounces that rise
    and fall within a few substeps come back too fast. Restitution 0 <= e <= 1.
Reference: Catto 2005, "Iterative dynamics with temporal coherence"; pymunk 7.3 (Munk2D).

How the engine is held to the law:

- It moves first, by v h, then changes v by a h. Started from v + a h/2 its positions under constant acceleration are
  exact, and v - a h/2 is the velocity at the step's end. A drive that varies enters through its averages over each
  substep under a falling and under a rising triangle, so the box goes exactly where the drive takes it.
- Feet are circles of radius 0, walls are segments fattened by R (100 m by default) and set back by R: the engine finds
  a foot anywhere in them, only one that passes R within a substep is lost.
- Position correction is off at e = 1: it would add energy. A jack that loses energy comes to rest on a wall, and where
  the wall turns under it, it would sink in: overlap then decays at the rate (1 - e) / 0.05 s.
- Each step works in a frame that starts at the box's centre: far from the origin is as good as near it.
- Cached contacts and the order left in the spatial index are state that (state, time) does not hold. Walls and feet
  share the same few cells of a spatial hash, and a step that ends with a contact alive makes the engine forget it by
  stepping with the jack far away, so the future follows from (state, time) bitwise.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import pymunk
from numpy.typing import ArrayLike
from pymunk.batch import BodyFields, Buffer, get_space_bodies

from jackbox_env import _validation as check
from jackbox_env.mechanics import Array, as_state, clearance
from jackbox_env.scene import Drive, Scene
from jackbox_env.simulators.base import LATEST_TIME, Impact
from jackbox_env.simulators.flight import fly, reach

_FOOT, _WALL = 1, 2  # collision types
_WALL_THICKNESS = 100.0 / 6.0  # R over L: 100 m by default
_HASH_CELL = 1000.0 / 6.0  # over L: 1000 m by default
_DEEPEST = 1.0  # a foot may end a step this far outside [m], or L if that is less
_FARTHEST = 1e9  # over L: motion within one step that the spatial hash can index; beyond it would loop forever
_FINER = (1, 2, 4, 8)  # a step that ends too deep is taken again with so many times the substeps, then refused
_PERSISTENCE = 1  # substeps for which the engine remembers a contact that has ended; 0 would turn collisions off
_CORRECTION_TIME = 0.05  # in which overlap decays to 1 / e at restitution 0 [s]
_FAR_OFF = 500.0  # over L: out of reach of every wall, whose far ends are 55 L away
_MOTION = BodyFields.POSITION | BodyFields.ANGLE | BodyFields.VELOCITY | BodyFields.ANGULAR_VELOCITY


class _Load(NamedTuple):
    """A torque or force as the engine must see it; all in N m or N.

    Engine step k changes the velocity from the middle of substep k to the middle of substep k + 1: by the rising
    average of the one and the falling average of the next. The last step goes half a substep too far: taken back.
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
        """From the averages over each substep under a falling and under a rising triangle."""
        falling = [mean[0] for mean in means]
        rising = [mean[1] for mean in means]
        during = [0.5 * (now + after) for now, after in zip(rising, [*falling[1:], rising[-1]], strict=True)]
        mean = (sum(falling) + sum(rising)) / (2.0 * len(means))
        return cls(falling[0], during, rising[-1], mean, max(map(abs, falling + rising)))


class PymunkSimulator:
    """Time stepping in pymunk; the module's head states the law, :class:`Simulator` the methods."""

    def __init__(self, scene: Scene, substeps: int = 4, iterations: int = 64) -> None:
        """Start at rest in the middle of the box, each foot facing a corner.

        Args:
            scene: what to simulate.
            substeps: engine steps per call of :meth:`step`, 1 to 1,000,000.
            iterations: of the contact solver, 1 to 1,000,000; two feet on a wall need 20, a corner 40.

        Raises:
            TypeError, ValueError: substeps or iterations is no whole number in its range.
        """
        self.scene = scene
        self.substeps = check.whole("substeps", substeps, at_least=1, at_most=1_000_000)
        self.iterations = check.whole("iterations", iterations, at_least=1, at_most=1_000_000)
        self._state = [0.0] * 5 + [math.pi / 4.0] + [0.0] * 6
        self.time = 0.0
        self.torque = 0.0
        self._impacts: list[Impact] = []
        self._prepare()

    # -- state --------------------------------------------------------------------------------------------------------

    @property
    def state(self) -> Array:
        """A copy of the present state, float64, shape (12,), SI units."""
        return np.array(self._state)

    @property
    def impacts(self) -> list[Impact]:
        """The impacts of the last step in time order; a fresh list."""
        return list(self._impacts)

    def reset(self, state: ArrayLike, time: float = 0.0) -> None:
        """See :meth:`Simulator.reset`; a foot may be at most min(1 m, L) outside."""
        values: list[float] = as_state(state).tolist()
        time = check.real("time", time, at_least=-LATEST_TIME, at_most=LATEST_TIME)
        outside = -clearance(self.scene, values)
        if not outside <= self._deepest:
            raise ValueError(f"state must have every foot at most {self._deepest:g} m outside, got {outside:g} m")
        self._state, self.time, self.torque, self._impacts = values, time, 0.0, []

    def __getstate__(self) -> dict[str, Any]:
        kept = ("scene", "substeps", "iterations", "_state", "time", "torque", "_impacts")
        return {name: getattr(self, name) for name in kept}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        self.__dict__.update(kept)
        self._prepare()

    # -- stepping -----------------------------------------------------------------------------------------------------

    def step(self, dt: float, torque: float | None = None) -> None:
        """See :meth:`Simulator.step`."""
        dt = check.real("dt", dt, above=0.0)
        if torque is not None:
            torque = check.real("torque", torque)
        bound = self._drive.torque_bound if torque is None else abs(torque)
        if clearance(self.scene, self._state) > reach(self.scene, self._state, dt, bound, self._drive.force_bound):
            means = self._drive.torque_means(self.time, dt) if torque is None else (torque, torque)
            self._state = fly(self.scene, self._state, dt, *means)
            self.torque = 0.5 * (means[0] + means[1])
            self._impacts = []
        else:
            self._step_engine(dt, torque)
        self.time += dt

    def _step_engine(self, dt: float, torque: float | None) -> None:
        """Let the engine take the step, divided finer by _FINER if it would end with a foot too deep in a wall."""
        before = self._impacts
        try:
            for finer in _FINER:
                substeps = finer * self.substeps
                h = check.real("dt / substeps", dt / substeps, above=0.0)
                load, push = self._loads(h, substeps, torque)
                self._refuse_runaway(dt, load, push)
                self._impacts, self._last_contact = [], -1
                after = self._advance(h, load, push)
                outside = -clearance(self.scene, after)
                if outside <= self._deepest and math.isfinite(sum(after)):
                    break
                self._forget_contacts()
            else:
                raise RuntimeError(
                    f"the jack left the box: a foot ended {outside:.3g} m outside a wall in the step after t = "
                    f"{self.time:g} s, at most {self._deepest:g} m is followed; use more substeps, a smaller "
                    f"time step (h = {h:g} s) or less torque"
                )
        except BaseException:
            self._impacts = before
            self._build()
            raise
        self._state = after
        self.torque = load.mean
        if self._last_contact >= substeps - (_PERSISTENCE + 1):  # the engine may still remember it
            self._forget_contacts()

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
        scene, box, jack, step = self.scene, self._box, self._jack, self._space.step
        x, y, angle, jack_x, jack_y, jack_angle, vx, vy, omega, jack_vx, jack_vy, jack_omega = self._state
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
        for self._substep, torque in enumerate(load.during):  # _record reads the substep
            box.torque = torque
            if weight:
                jack.force = weight
            if push:
                box.force = push[0].during[self._substep], push[1].during[self._substep]
            step(h)
        after = self._read()
        after[0] += x
        after[1] += y
        after[3] += x
        after[4] += y
        after[8] -= half_turn * load.last
        after[10] += half_fall
        if push:
            after[6] -= half_push * push[0].last
            after[7] -= half_push * push[1].last
        return after

    def _read(self) -> list[float]:
        self._motion.clear()
        get_space_bodies(self._space, _MOTION, self._motion)
        box_and_jack = memoryview(self._motion.float_buf()).cast("d").tolist()  # x, y, angle, vx, vy, omega of each
        return [*box_and_jack[0:3], *box_and_jack[6:9], *box_and_jack[3:6], *box_and_jack[9:12]]

    def _record(self, arbiter: pymunk.Arbiter, space: pymunk.Space, _data: Any) -> None:
        """Called by the engine after it solved a contact, once per substep while the contact lasts."""
        self._last_contact = self._substep
        impulse = arbiter.total_impulse.length
        if impulse > 0.0:
            foot, wall = arbiter.shapes
            time = self.time + (self._substep + 1) * space.current_time_step
            self._impacts.append(Impact(time, self._wall_of[wall], self._foot_of[foot], impulse))

    # -- what it cannot do --------------------------------------------------------------------------------------------

    @property
    def _deepest(self) -> float:
        return min(_DEEPEST, self.scene.box_half_width)

    def _refuse_runaway(self, dt: float, load: _Load, push: tuple[_Load, ...]) -> None:
        span = reach(self.scene, self._state, dt, load.peak, sum(force.peak for force in push))
        span += dt * (math.hypot(self._state[6], self._state[7]) + self.scene.jack_arm * abs(self._state[11]))
        farthest = _FARTHEST * self.scene.box_half_width
        if not span <= farthest:
            raise RuntimeError(
                f"the jack would leave the box: things move {span:.3g} m within dt = {dt:g} s, at most {farthest:.3g} "
                "m is followed; use a smaller time step, torque or speed"
            )

    # -- the engine's space -------------------------------------------------------------------------------------------

    def _prepare(self) -> None:
        self._drive = Drive() if self.scene.drive is None else self.scene.drive
        self._motion = Buffer()
        self._substep = 0
        self._last_contact = -1  # the last substep of the last engine step in which a contact was alive
        self._build()

    def _forget_contacts(self) -> None:
        """Let the contacts the engine remembers expire, with nothing in reach to make new ones."""
        for body, x in ((self._box, 0.0), (self._jack, _FAR_OFF * self.scene.box_half_width)):
            body.position, body.velocity, body.angular_velocity = (x, 0.0), (0.0, 0.0), 0.0
        for _ in range(_PERSISTENCE + 1):
            self._space.step(1.0)

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
        walls: list[pymunk.Shape] = []
        for normal in directions:
            middle, end = normal * set_back, normal.perpendicular() * extent
            wall = pymunk.Segment(box, middle - end, middle + end, thickness)
            wall.elasticity, wall.collision_type = scene.restitution, _WALL  # the engine multiplies both elasticities
            walls.append(wall)
        feet: list[pymunk.Shape] = []
        for direction in directions:
            foot = pymunk.Circle(jack, 0.0, direction * scene.jack_arm)
            foot.elasticity, foot.collision_type = 1.0, _FOOT
            feet.append(foot)
        space.add(*walls, *feet)
        space.on_collision(_FOOT, _WALL, post_solve=self._record)
        self._wall_of = {wall: index for index, wall in enumerate(walls)}
        self._foot_of = {foot: index for index, foot in enumerate(feet)}
        self._space, self._box, self._jack = space, box, jack
