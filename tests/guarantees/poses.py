"""States with contacts, and the impact law by an independent computation."""

from __future__ import annotations

import itertools
import math

import numpy as np

from jackbox_env.mechanics import gap_jacobian
from jackbox_env.model.scene import Scene
from tests.states import Array, inside

PAIRS = list(itertools.product(range(4), range(4)))  # (wall, foot)


def random_scene(rng: np.random.Generator, restitution: float = 1.0) -> Scene:
    """Any sizes, masses and inertias over two to five powers of ten, none of them tied to another."""
    half = rng.uniform(0.5, 20.0)
    return Scene(
        box_half_width=half,
        box_mass=10.0 ** rng.uniform(-1.0, 3.0),
        box_inertia=10.0 ** rng.uniform(-1.0, 4.0),
        jack_arm=half * rng.uniform(0.05, 0.95),
        jack_mass=10.0 ** rng.uniform(-1.0, 2.0),
        jack_inertia=10.0 ** rng.uniform(-1.0, 2.0),
        gravity=rng.uniform(0.0, 20.0),
        restitution=restitution,
    )


def approaching(scene: Scene, rng: np.random.Generator, wall: int, foot: int) -> Array:
    """A random state whose velocities, mirrored if need be, bring the foot closer to the wall."""
    state = inside(scene, rng)
    if gap_jacobian(scene, state, wall, foot) @ state[6:] > 0.0:
        state[6:] *= -1.0
    return state


def energy_norm(scene: Scene, velocities: Array) -> float:
    """Root of twice the kinetic energy [J^1/2]."""
    return float(np.linalg.norm(np.sqrt(scene.mass_diagonal) * velocities))


def velocity_error(scene: Scene, actual: Array, expected: Array) -> float:
    """Relative error of six velocities in the norm of the kinetic energy."""
    return energy_norm(scene, actual - expected) / energy_norm(scene, expected)


def momenta(scene: Scene, state: Array) -> Array:
    """Total p_x, p_y [N s] and angular momentum about the world's origin [N m s]."""
    box, jack = state[0:2], state[3:5]
    p_box, p_jack = scene.box_mass * state[6:8], scene.jack_mass * state[9:11]
    orbital = box[0] * p_box[1] - box[1] * p_box[0] + jack[0] * p_jack[1] - jack[1] * p_jack[0]
    spin = scene.box_inertia * state[8] + scene.jack_inertia * state[11]
    return np.array([*(p_box + p_jack), orbital + spin])


def momentum_scale(scene: Scene, state: Array) -> float:
    """Sum of the sizes of all terms in ``momenta``, the yardstick for what cancels in them."""
    box, jack = math.hypot(*state[0:2]), math.hypot(*state[3:5])
    orbital = (1.0 + box) * scene.box_mass * math.hypot(*state[6:8])
    orbital += (1.0 + jack) * scene.jack_mass * math.hypot(*state[9:11])
    return float(orbital + scene.box_inertia * abs(state[8]) + scene.jack_inertia * abs(state[11]))
