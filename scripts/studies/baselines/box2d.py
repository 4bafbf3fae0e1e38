"""Box2D 2.3.10: semi-implicit Euler and sequential impulses in single precision, tuned as its manual advises.

Law: each substep adds the forces' impulses to the velocities. It solves the contacts detected where the substep starts
    (restitution by the approach speed before the solve) and moves by the new velocities. Then it pushes apart what
    overlaps by more than 5 mm.
Order: first in h = dt / substeps: flight runs ahead by g h t / 2, and an impact waits for the next substep's start.
Cost: about 20 us per substep, half of it in the engine.
Fails: below a closing speed of 1 m/s (``b2_velocityThreshold``, compiled in: assigning to the module's constant does
    nothing) a contact is inelastic, whatever its restitution. Numbers are float32. The engine clips motion above
    2 m or a quarter turn per substep, so such a step raises JackLostError. Position correction moves bodies without any
    work.
Reference: Catto, Box2D v2.3 User Manual; b2Settings.h for the constants.

How it is tuned: metres, kilograms, seconds; 8 velocity and 3 position iterations (30 and 10 gave the same numbers under
the default chirp); both restitutions e (the larger counts), no friction, no damping, no sleeping. Walls are boxes as
thick as L on the box's body, so bullets are not needed. Every polygon has a skin of 0.01 m, and the walls are set back
by it: a foot, a circle of radius 0, touches at gap 0. Each control step starts with the box at the origin and angles
within half a turn, where float32 is finest. It starts without contacts: the engine solves contacts in the order in
which they began, from their last impulses, so contacts of earlier steps would let the past act.
"""

from __future__ import annotations

import math
from typing import Any

import Box2D
import numpy as np

from jackbox_env.mechanics import gap_jacobian
from jackbox_env.model.states import OMEGA_BOX, OMEGA_JACK, RATES, VX_BOX, VX_JACK, VY_BOX, VY_JACK, X_JACK
from jackbox_env.simulators.base import JackLostError
from scripts.studies.baselines.base import DIRECTIONS, Engine, Pair

_VELOCITY_ITERATIONS, _POSITION_ITERATIONS = 8, 3
_SKIN = float(Box2D.b2_polygonRadius)  # [m]
_FARTHEST, _FURTHEST_TURN = float(Box2D.b2_maxTranslation), float(Box2D.b2_maxRotation)  # of a substep [m], [rad]
_SLACK = 0.999  # of float32
_LEAVING = 1e-3  # [m/s]
_FAR_OFF = 100.0  # over L


class _Listener(Box2D.b2ContactListener):  # type: ignore[misc]
    """Stores the impulses of a substep."""

    def __init__(self) -> None:
        super().__init__()
        self.pushes: dict[Pair, float] = {}

    def PostSolve(self, contact: Any, impulse: Any) -> None:  # noqa: N802
        pushed = sum(impulse.normalImpulses)
        if pushed > 0.0:
            one, other = contact.fixtureA.userData, contact.fixtureB.userData
            self.pushes[(one[1], other[1]) if one[0] == "wall" else (other[1], one[1])] = pushed


class Model(Engine):
    """Box2D, see the module's docstring."""

    def _build_unpickled(self) -> None:
        scene = self.scene
        self._listener = _Listener()
        world = Box2D.b2World(gravity=(0.0, -scene.gravity), doSleep=False, contactListener=self._listener)
        world.continuousPhysics = False  # for bullets and unmoved bodies, of which there are none
        self._box = world.CreateDynamicBody(allowSleep=False, gravityScale=0.0)
        self._jack = world.CreateDynamicBody(allowSleep=False)
        material = {"density": 0.0, "friction": 0.0, "restitution": scene.restitution}
        thick = 0.5 * scene.box_half_width
        back = scene.box_half_width + _SKIN + thick
        wide = scene.box_half_width + 2.0 * thick
        for number, (x, y) in enumerate(DIRECTIONS):
            size = (thick, wide) if x else (wide, thick)
            wall = Box2D.b2PolygonShape(box=(*size, (x * back, y * back), 0.0))
            self._box.CreateFixture(shape=wall, userData=("wall", number), **material)
            foot = Box2D.b2CircleShape(pos=(x * scene.jack_arm, y * scene.jack_arm), radius=0.0)
            self._jack.CreateFixture(shape=foot, userData=("foot", number), **material)
        self._box.massData = Box2D.b2MassData(mass=scene.box_mass, I=scene.box_inertia, center=(0.0, 0.0))
        self._jack.massData = Box2D.b2MassData(mass=scene.jack_mass, I=scene.jack_inertia, center=(0.0, 0.0))
        self._world = world

    def _set_state(self, state: list[float], h: float) -> None:
        x, y, angle, _, _, jack_angle = state[:RATES]
        whole, jack_whole = (turned - math.remainder(turned, 2.0 * math.pi) for turned in (angle, jack_angle))
        self._origin = [x, y, whole, x, y, jack_whole]
        self._h = h
        self._jack.transform = (_FAR_OFF * self.scene.box_half_width, 0.0), 0.0  # out of reach: contacts are dropped
        self._world.Step(0.0, 1, 1)
        q = [number - start for number, start in zip(state[:RATES], self._origin, strict=True)]
        for body, at, rate in (
            (self._box, q[:X_JACK], state[VX_BOX:VX_JACK]),
            (self._jack, q[X_JACK:], state[VX_JACK:]),
        ):
            body.transform = (at[0], at[1]), at[2]
            body.linearVelocity = rate[0], rate[1]
            body.angularVelocity = rate[2]

    def _substep(self, h: float, torque: float) -> dict[Pair, float]:
        self._listener.pushes = {}
        self._box.ApplyTorque(torque, True)
        self._world.Step(h, _VELOCITY_ITERATIONS, _POSITION_ITERATIONS)
        self._world.ClearForces()
        return self._listener.pushes

    def _is_over(self, state: list[float], wall: int, foot: int) -> bool:
        """True when the foot moves away. The rate of a foot that sticks is only float32's rounding."""
        return bool(gap_jacobian(self.scene, state, wall, foot) @ np.array(state[RATES:]) > _LEAVING)

    def _read(self) -> list[float]:
        q, v = list[float](), list[float]()
        for body in (self._box, self._jack):
            position, rate = body.position, body.linearVelocity
            q += [position.x, position.y, body.angle]
            v += [rate.x, rate.y, body.angularVelocity]
        state = [number + start for number, start in zip(q, self._origin, strict=True)] + v
        self._check_clipping(state)
        return state

    def _check_clipping(self, state: list[float]) -> None:
        """Raise JackLostError if the engine has clipped a speed to its bound."""
        travel = self._h * max(math.hypot(state[VX_BOX], state[VY_BOX]), math.hypot(state[VX_JACK], state[VY_JACK]))
        turn = self._h * max(abs(state[OMEGA_BOX]), abs(state[OMEGA_JACK]))
        if not (travel < _SLACK * _FARTHEST and turn < _SLACK * _FURTHEST_TURN):
            raise JackLostError(
                f"box2d cannot follow the jack: {travel:.3g} m and {turn:.3g} rad per substep, its limits "
                f"are {_FARTHEST:g} m and {_FURTHEST_TURN:.3g} rad; use more substeps"
            )
