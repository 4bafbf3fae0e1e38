"""Settings of environments: attributes that cannot be assigned, because an environment would not follow."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from functools import partial
from typing import Any, NoReturn

import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode

from jackbox_env.model.scene import Scene
from jackbox_env.simulators.fidelity import KEYWORDS
from jackbox_env.tools import checks as check

# Arguments of the vector environment alone, and the end of the sentence that is raised for them elsewhere.
VECTOR_ONLY = dict.fromkeys(
    ("num_envs", "autoreset_mode", "num_threads", "with_infos", "device"),
    'belongs to the native vector environment: gymnasium.make_vec with vectorization_mode="vector_entry_point"',
)
# Properties of environments that something else changes.
_SCENE = 'reset(options={"scene": ...}) changes it'
_INSTEAD = {
    "scene": _SCENE, "scenes": _SCENE, "state": "set_state changes it", "time": "set_state changes it",
    "states": "set_states changes them", "times": "set_states changes them",
    "observation": "make a new environment with observation=...", "np_random": "reset(seed=...) seeds the environments",
}  # fmt: skip


def completed(changes: Mapping[str, Any]) -> dict[str, Any]:
    """Changes of an environment's keywords, with None for the others that they replace.

    Those that choose the contact model come together, and the control steps of an episode are not cut by its decisions.
    """
    contact = dict.fromkeys(KEYWORDS if changes.keys() & {*KEYWORDS} else ())
    return {**contact, **dict.fromkeys(["max_episode_steps"] * ("episode_steps" in changes)), **changes}


class ReadOnly:
    """A read-only attribute: the argument of this name that an environment was made with."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, environment: Any, owner: type) -> Any:
        return self if environment is None else environment._settings[self._name]

    def __set__(self, environment: Any, value: object) -> None:
        _refuse(self._name, f"make a new environment with {self._name}=...", environment, value)


class Settings:
    """Base of environments: assigning a setting, the scene or the state raises AttributeError, with the remedy."""

    _settings: Mapping[str, Any]  # the arguments by name
    contact, substeps, fidelity, task, control_dt = ReadOnly(), ReadOnly(), ReadOnly(), ReadOnly(), ReadOnly()
    torque, randomize = ReadOnly(), ReadOnly()
    action, action_repeat, episode_steps, max_episode_steps = ReadOnly(), ReadOnly(), ReadOnly(), ReadOnly()
    render_mode, render_size, render_overlay = ReadOnly(), ReadOnly(), ReadOnly()

    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """The spec from which Gymnasium makes the same environment, with the number of decisions of an episode."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        """Store a spec, with the name of the autoreset mode in place of the enum, which has no JSON form."""
        if spec is not None:
            spec = copy.copy(spec)
            spec.max_episode_steps = self.max_episode_steps
            if isinstance(mode := spec.kwargs.get("autoreset_mode"), AutoresetMode):
                spec.kwargs = {**spec.kwargs, "autoreset_mode": mode.name}
        self._spec = spec

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        for name, instead in _INSTEAD.items():
            if isinstance(plain := vars(cls).get(name), property):
                setattr(cls, name, plain.setter(partial(_refuse, name, instead)))


def _refuse(name: str, instead: str, environment: Any, value: object) -> NoReturn:
    raise AttributeError(f"{name} cannot be assigned, got {check.shown(value)}: {instead}")


class VectorSettings(Settings):
    """Base of vector environments: their settings, scenes and seeds."""

    observation, num_envs = ReadOnly(), ReadOnly()
    autoreset_mode = ReadOnly()  # TorchRL reads it here, Gymnasium in the metadata
    num_threads, with_infos = ReadOnly(), ReadOnly()

    _seeds: dict[int, int]  # of the environments that one was given

    @property
    def scenes(self) -> list[Scene]:
        """The present scene of each environment, every field resolved."""
        return [self.scene_of(number) for number in range(self.num_envs)]

    def scene_of(self, number: int) -> Scene:
        """The present scene of one environment.

        Raises:
            TypeError, ValueError: there is no such environment.
        """
        raise NotImplementedError

    @property
    def scene(self) -> Scene:
        """The scene of all environments.

        Raises:
            ValueError: they differ; read ``scenes``.
        """
        scenes = self.scenes
        if any(scene != scenes[0] for scene in scenes):
            raise ValueError("the environments have different scenes: read the list scenes")
        return scenes[0]

    @property
    def np_random(self) -> np.random.Generator:
        """There is none: each environment has one of its own, which ``reset(seed=...)`` seeds."""
        raise AttributeError("each environment has a generator of its own: reset(seed=...) seeds them")

    @property
    def np_random_seed(self) -> tuple[int, ...]:
        """The environments' seeds, -1 where none was given."""
        return tuple(self._seeds.get(number, -1) for number in range(self.num_envs))
