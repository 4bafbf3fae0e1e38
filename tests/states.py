"""States and reference data that several tests share."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from jackbox_env.mechanics import gap_jacobian, gaps
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import STATE_NAMES

DATA = Path(__file__).parent / "data"
Array = NDArray[np.float64]
WEIGHTLESS = Scene(gravity=0.0, drive=None)
T = TypeVar("T")
FLAT = 6.0 - math.sqrt(0.5)  # of the jack's centre from a wall that carries two of its feet [m]


def load(name: str) -> list[dict[str, Any]]:
    """Read a data file: facts computed independently, trajectories with 60 digits."""
    records: list[dict[str, Any]] = json.loads((DATA / f"{name}.json").read_text())
    return records


def started(one: T, *start: Any, **options: Any) -> T:
    """An environment, a simulator or another thing that has ``reset``, after it."""
    cast(Any, one).reset(*start, **options)
    return one


def at(**values: float) -> Array:
    """A state of zeros but for these."""
    return np.array([values.get(name, 0.0) for name in STATE_NAMES])


def inside(scene: Scene, rng: np.random.Generator, speed: float = 5.0) -> Array:
    """A random state with every foot inside: any angles, centre in the circle that always fits."""
    state = np.concatenate([rng.uniform(-3.0, 3.0, 6), speed * rng.standard_normal(6)])
    room = max(scene.box_half_width - scene.jack_arm, 0.0)
    angle, radius = rng.uniform(0.0, 2.0 * math.pi), room * math.sqrt(rng.uniform())
    state[3:5] = state[0:2] + radius * np.array([math.cos(angle), math.sin(angle)])
    return state


def lying(
    along: float = 0.0, omega: float = 0.0, tilt: float = 0.0, turned: float = math.pi / 4.0, depth: float = FLAT
) -> Array:
    """A jack on the floor of a box at an angle, both turning as one; turned by 45 degrees it lies on two feet."""
    state = np.zeros(12)
    state[2], state[5] = tilt, tilt + turned
    state[3] = along * math.cos(tilt) + depth * math.sin(tilt)
    state[4] = along * math.sin(tilt) - depth * math.cos(tilt)
    state[[8, 11]], state[9], state[10] = omega, -omega * state[4], omega * state[3]
    return state


def one_foot_on_wall(scene: Scene, rng: np.random.Generator) -> tuple[Array, int, int]:
    """A random state with one foot on a wall, approaching it at 0.1 m/s or more, and the others inside by 1 mm."""
    while True:
        state = inside(scene, rng)
        wall = int(rng.integers(4))
        foot = int(np.argmin(gaps(scene, state)[wall]))
        gap = gaps(scene, state)[wall, foot]
        normal_angle = state[2] + wall * math.pi / 2.0
        state[3:5] += gap * np.array([math.cos(normal_angle), math.sin(normal_angle)])
        others = gaps(scene, state)
        others[wall, foot] = 1.0
        approach = gap_jacobian(scene, state, wall, foot) @ state[6:]
        if others.min() > 1e-3 and approach < -0.1:
            return state, wall, foot


def several_contacts(scene: Scene, rng: np.random.Generator, kind: str) -> tuple[Array, list[tuple[int, int]]]:
    """A random state with several feet on walls, each approaching at 0.1 m/s or more.

    ``kind``: "one wall" (two feet at 45 degrees), "two walls" (one foot on each of two neighbours), or "corner".
    """
    contacts = {
        "one wall": [(0, 0), (0, 3)], "two walls": [(0, 0), (1, 1)], "corner": [(0, 0), (1, 0), (1, 1), (0, 3)],
    }[kind]  # fmt: skip
    while True:
        state = inside(scene, rng)
        # In the box frame, turned so that walls 0 and 1 (and feet 0 and 1, or 0 and 3) are the ones touched.
        relative = rng.uniform(-0.6, 0.6) if kind == "two walls" else math.pi / 4.0
        x = y = scene.box_half_width - scene.jack_arm * math.cos(relative)
        if kind == "one wall":
            y = rng.uniform(-0.5, 0.5) * (scene.box_half_width - scene.jack_arm)
        cosine, sine = math.cos(state[2]), math.sin(state[2])
        state[3:5] = state[0:2] + np.array([[cosine, -sine], [sine, cosine]]) @ [x, y]
        state[5] = state[2] + relative
        rates = [gap_jacobian(scene, state, wall, foot) @ state[6:] for wall, foot in contacts]
        if max(rates) < -0.1:
            return state, contacts
