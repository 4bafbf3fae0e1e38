"""Scenes and states for the tests of the pymunk model."""

from __future__ import annotations

import numpy as np

from jackbox_env.scene import Scene
from jackbox_env.simulators.pymunk import PymunkSimulator
from tests.states import Array

WEIGHTLESS = Scene(gravity=0.0, drive=None)


INSTANT = 1e-12  # [s] short enough that nothing but the impact happens: poses move by 1e-10 m and less


def relative_error(actual: Array, expected: Array) -> float:
    """Largest velocity error over the largest velocity."""
    return float(np.abs(actual[6:] - expected[6:]).max() / np.abs(expected[6:]).max())


def impact_in_an_instant(scene: Scene, state: Array, iterations: int | None = None) -> PymunkSimulator:
    simulator = PymunkSimulator(scene, substeps=1, iterations=iterations)
    simulator.reset(state)
    simulator.step(INSTANT, torque=0.0)
    return simulator
