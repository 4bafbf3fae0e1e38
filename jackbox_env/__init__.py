"""A Gymnasium environment with exact impacts, the jack in a box. Importing registers ``JackInBox-v0``."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from gymnasium.envs.registration import register

from jackbox_env.model.scene import Chirp, Drive, Scene
from jackbox_env.model.states import State

if TYPE_CHECKING:
    from jackbox_env.envs.single import JackInBoxEnv
    from jackbox_env.envs.vector import JackInBoxVectorEnv
    from jackbox_env.fits.fitting import fit
    from jackbox_env.fits.observed import Recording
    from jackbox_env.fits.result import Fit
    from jackbox_env.measure.choosing import cheapest
    from jackbox_env.model.action import Action
    from jackbox_env.model.observation import Observation
    from jackbox_env.model.pixels import Pixels
    from jackbox_env.planning.ilqr import ilqr
    from jackbox_env.planning.linearization import Linearization, linearize
    from jackbox_env.planning.rollouts import Rollout, rollout
    from jackbox_env.recording.motion import Motion
    from jackbox_env.recording.simulation import simulate
    from jackbox_env.simulators import Impact, JackLostError, Simulator, StepResult, make_simulator
    from jackbox_env.simulators.fidelity import Setting

__version__ = "0.1.0"

#: Contact model and substeps of the fidelities "coarse", "balanced", "fine" and "exact".
FIDELITIES: Mapping[str, Setting]

_LAZY = {
    "Action": "model.action",
    "FIDELITIES": "simulators.fidelity",
    "Fit": "fits.result",
    "JackInBoxEnv": "envs.single",
    "JackInBoxVectorEnv": "envs.vector",
    "Impact": "simulators",
    "JackLostError": "simulators",
    "Linearization": "planning.linearization",
    "Motion": "recording.motion",
    "Observation": "model.observation",
    "Pixels": "model.pixels",
    "Simulator": "simulators",
    "StepResult": "simulators",
    "make_simulator": "simulators",
    "Recording": "fits.observed",
    "Rollout": "planning.rollouts",
    "Task": "model.tasks",
    "TaskError": "model.tasks",
    "cheapest": "measure.choosing",
    "fit": "fits.fitting",
    "ilqr": "planning.ilqr",
    "linearize": "planning.linearization",
    "rollout": "planning.rollouts",
    "simulate": "recording.simulation",
}
_FACES = ("mechanics", "sb3", "torch")  # modules of public names
__all__ = [
    "FIDELITIES",
    "Action",
    "Chirp",
    "Drive",
    "Fit",
    "Impact",
    "JackInBoxEnv",
    "JackInBoxVectorEnv",
    "JackLostError",
    "Linearization",
    "Motion",
    "Observation",
    "Pixels",
    "Recording",
    "Rollout",
    "Scene",
    "Simulator",
    "State",
    "StepResult",
    "Task",
    "TaskError",
    "cheapest",
    "fit",
    "ilqr",
    "linearize",
    "make_simulator",
    "rollout",
    "simulate",
]

register(
    id="JackInBox-v0",
    entry_point="jackbox_env.envs.single:JackInBoxEnv",
    vector_entry_point="jackbox_env.envs:make_vec",
    max_episode_steps=None,  # the environment itself truncates
    reward_threshold=300.0,  # of juggle
)


def __getattr__(name: str) -> Any:
    """Import a public name on first use: importing the package loads neither pymunk nor numba."""
    if name in _LAZY:
        return getattr(importlib.import_module(f"{__name__}.{_LAZY[name]}"), name)
    if name in _FACES:
        return importlib.import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
