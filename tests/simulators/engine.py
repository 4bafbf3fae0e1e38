"""An impact in the pymunk model, with nothing else."""

from __future__ import annotations

from jackbox_env.model.scene import Scene
from jackbox_env.simulators.pymunk import PymunkSimulator
from tests.states import Array


def impact_in_an_instant(scene: Scene, state: Array, iterations: int | None = None) -> PymunkSimulator:
    """A simulator after 1e-12 s, in which poses move by 1e-10 m and less."""
    simulator = PymunkSimulator(scene, substeps=1, iterations=iterations)
    simulator.reset(state)
    simulator.step(1e-12, torque=0.0)
    return simulator
