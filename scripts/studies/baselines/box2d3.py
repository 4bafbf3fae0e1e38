"""Box2D v3 (pyb2d3 0.11): soft contacts with relaxation, then restitution, in single precision.

Law: a step finds the contacts nearer than 4 slops of 5 mm, then solves and moves ``inner`` times. At its end a contact
    that pushed gets -e times the relative velocity that it had at the step's start.
Order: first in h = dt / substeps: flight runs ahead by g h t / 2, and an impact waits for the end of its substep.
Cost: in docs/accuracy.md; much of a substep is Python's calls.
Fails: numbers are float32. A turn by h omega advances the angle by its arctangent only.
Reference: Box2D v3 documentation, "Simulation"; Catto, "Solver2D" (2024).

Settings: threshold of restitution 0, no friction, no sleeping; walls as thick as L on the box's body, so no bullets. A
search found the others (docs/accuracy.md). Each control step starts with the box at the origin.
"""

from __future__ import annotations

import math
from typing import Any

import pyb2d3

from jackbox_env.model.scene import Scene
from jackbox_env.model.states import RATES, X_JACK
from scripts.studies.baselines.base import DIRECTIONS, Engine, Pair


class Model(Engine):
    """Box2D v3, see the module's docstring; ``radius`` is that of the feet, over L, ``units`` the engine's per metre."""

    def __init__(self, scene: Scene, substeps: int, **settings: Any) -> None:
        self._settings, self._inner = settings, settings["inner"]
        super().__init__(scene, substeps // self._inner)

    def _prepare(self) -> None:
        scene, half, of = self.scene, self.scene.box_half_width, self._settings
        radius = of["radius"] * half
        pyb2d3.set_length_units_per_meter(of["units"])  # of the whole process: slops scale with it
        thresholds = {"restitution_threshold": of["threshold"], "hit_event_threshold": 0.0}
        self._world = pyb2d3.World(gravity=(0.0, -scene.gravity), maximum_linear_speed=1e5, **thresholds)
        self._world.set_contact_tuning(of["hertz"], of["damping"], of["push"])
        self._bodies = [
            self._world.create_dynamic_body(enable_sleep=False, gravity_scale=scale, is_bullet=scale * of["bullet"] > 0)
            for scale in (0.0, 1.0)
        ]
        material = pyb2d3.surface_material(friction=0.0, restitution=scene.restitution)
        shape = pyb2d3.shape_def(density=0.0, material=material, enable_hit_events=True)
        self._numbers = {}  # of walls and feet by their shapes
        for number, (x, y) in enumerate(DIRECTIONS):
            size, back = (0.5 * half, 2.0 * half) if x else (2.0 * half, 0.5 * half), 1.5 * half + radius
            wall = pyb2d3.box(*size, (x * back, y * back))
            foot = pyb2d3.circle((x * scene.jack_arm, y * scene.jack_arm), radius)
            for body, part in zip(self._bodies, (wall, foot), strict=True):
                self._numbers[body.create_shape(shape, part).id] = number
        masses = (scene.box_mass, scene.box_inertia), (scene.jack_mass, scene.jack_inertia)
        for body, (mass, inertia) in zip(self._bodies, masses, strict=True):
            data: Any = pyb2d3.MassData()
            data.mass, data.rotational_inertia, data.center = mass, inertia, (0.0, 0.0)
            body.mass_data = data

    def _set_state(self, state: list[float], h: float) -> None:
        self._start = state
        for body, at in zip(self._bodies, (0, X_JACK), strict=True):
            x, y, angle, vx, vy, omega = *state[at : at + X_JACK], *state[RATES + at : RATES + at + X_JACK]
            body.set_transform((x - state[0], y - state[1]), pyb2d3.Rot(angle))
            body.linear_velocity, body.angular_velocity = (vx, vy), omega

    def _substep(self, h: float, torque: float) -> dict[Pair, float]:
        self._bodies[0].apply_torque(torque)
        self._world.step(h, self._inner)
        events = self._world.get_contact_events()
        if not events.hit_count:
            return {}
        hits = [
            sorted((hit.shape_a, hit.shape_b), key=lambda shape: shape.body != self._bodies[0])
            for hit in events.hit_events()
        ]
        return {(self._numbers[wall.id], self._numbers[foot.id]): math.nan for wall, foot in hits}  # no impulses

    def _is_over(self, state: list[float], wall: int, foot: int) -> bool:
        """True: a hit is over when its substep ends."""
        return True

    def _read(self) -> list[float]:
        q, v = list[float](), list[float]()
        for body, at in zip(self._bodies, (0, X_JACK), strict=True):
            (x, y), rotation, before = body.position, body.rotation, self._start[at + 2]
            turned = math.remainder(math.atan2(rotation.s, rotation.c) - before, 2.0 * math.pi)
            q += [x + self._start[0], y + self._start[1], before + turned]
            v += [*body.linear_velocity, body.angular_velocity]
        return q + v
