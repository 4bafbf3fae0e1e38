"""Networks that nobody has trained, and states for them."""

from __future__ import annotations

import numpy as np

from agents.policies.network import Layer
from agents.policies.value import INPUTS
from jackbox_env import Scene
from jackbox_env.model.states import Array
from tests.states import inside


def layers_for(width: int = 16) -> list[Layer]:
    """Layers of a value, with random weights."""
    rng = np.random.default_rng(0)
    return [
        (rng.normal(size=(after, before)).astype(np.float32), rng.normal(size=after).astype(np.float32))
        for before, after in ((INPUTS, width), (width, 1))
    ]


def states_in(scene: Scene, count: int) -> Array:
    rng = np.random.default_rng(3)
    return np.array([inside(scene, rng) for _ in range(count)])
