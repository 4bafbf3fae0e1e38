"""Box2D v3 (pyb2d3 0.11): soft contacts with relaxation, then restitution, in single precision.

Law: a step finds the contacts nearer than 4 slops, then solves and moves ``inner`` times. At its end a contact that
    pushed gets -e times the relative velocity that it had at the step's start.
Order: first in h = dt / substeps: flight runs ahead by g h t / 2, and an impact waits for its substep's end.
Fails: numbers are float32. A turn by h omega advances the angle by its arctangent only.
Reference: Box2D v3 documentation, "Simulation"; Catto, "Solver2D" (2024).

Settings: no friction, no sleeping; walls as thick as L, set back by the feet's radius; the others as the search in
docs/accuracy.md found: slop and speculative distance are 5 and 20 mm times ``units`` (of length per metre).
"""

from __future__ import annotations

import math
from typing import Any

import pyb2d3  # type: ignore[import-not-found,import-untyped,unused-ignore]

from jackbox_env.model.scene import Scene
from jackbox_env.model.states import RATES, X_JACK
from scripts.studies.baselines.base import DIRECTIONS, Engine, Pair


class Model(Engine):
    """Box2D v3, see the module's docstring."""

    def __init__(self, scene: Scene, substeps: int, **settings: Any) -> None:
        self._settings, self._inner = settings, settings["inner"]
        super().__init__(scene, substeps // self._inner)

    def _build_unpickled(self) -> None:
        scene, half, of = self.scene, self.scene.box_half_width, self._settings
        radius, back = of["radius"] * half, (1.5 + of["radius"]) * half
        pyb2d3.set_length_units_per_meter(of["units"])  # of the whole process
        self._world = pyb2d3.World(
            gravity=(0.0, -scene.gravity), restitution_threshold=of["threshold"], hit_event_threshold=0.0,
            maximum_linear_speed=1e5,
        )  # fmt: skip
        self._world.set_contact_tuning(of["hertz"], of["damping"], of["push"])
        self._bodies = [self._world.create_dynamic_body(gravity_scale=n, enable_sleep=False) for n in (0.0, 1.0)]
        self._bodies[1].bullet = of["bullet"]
        shape = pyb2d3.shape_def(
            density=0.0, enable_hit_events=True,
            material=pyb2d3.surface_material(friction=0.0, restitution=scene.restitution),
        )  # fmt: skip
        self._numbers: dict[int, int] = {}  # of walls and feet, by the ids of their shapes
        for number, (x, y) in enumerate(DIRECTIONS):
            wall = pyb2d3.box(*((0.5 * half, 2.0 * half)[:: 1 if x else -1]), (x * back, y * back))
            foot = pyb2d3.circle((x * scene.jack_arm, y * scene.jack_arm), radius)
            shapes = map(pyb2d3.Body.create_shape, self._bodies, (shape, shape), (wall, foot))
            self._numbers |= dict.fromkeys((one.id for one in shapes), number)
        for body, whose in zip(self._bodies, ("box", "jack"), strict=True):
            data: Any = pyb2d3.MassData()
            data.mass, data.rotational_inertia = getattr(scene, f"{whose}_mass"), getattr(scene, f"{whose}_inertia")
            body.mass_data = data

    def _set_state(self, state: list[float], h: float) -> None:
        self._start = state
        for body, at in zip(self._bodies, (0, X_JACK), strict=True):
            body.set_transform((state[at] - state[0], state[at + 1] - state[1]), pyb2d3.Rot(state[at + 2]))
            body.linear_velocity, body.angular_velocity = (
                tuple(state[RATES + at : RATES + at + 2]), state[RATES + at + 2]
            )  # fmt: skip

    def _substep(self, h: float, torque: float) -> dict[Pair, float]:
        self._bodies[0].apply_torque(torque)
        self._world.step(h, self._inner)
        hits = [(hit.shape_a, hit.shape_b) for hit in self._world.get_contact_events().hit_events()]
        numbers = ({one.body == self._bodies[0]: self._numbers[one.id] for one in shapes} for shapes in hits)
        return {(of[True], of[False]): math.nan for of in numbers}  # a hit's impulse is not offered

    def _read(self) -> list[float]:
        q, v = list[float](), list[float]()
        for body, at in zip(self._bodies, (0, X_JACK), strict=True):
            (x, y), rotation, before = body.position, body.rotation, self._start[at + 2]
            turned = math.remainder(math.atan2(rotation.s, rotation.c) - before, 2.0 * math.pi)
            q += [x + self._start[0], y + self._start[1], before + turned]
            v += [*body.linear_velocity, body.angular_velocity]
        return q + v
