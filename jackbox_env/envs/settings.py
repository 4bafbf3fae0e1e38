"""Settings of environments: attributes that cannot be assigned, because an environment would not follow."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Any, NoReturn

from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode

from jackbox_env.simulators.fidelity import KEYWORDS
from jackbox_env.tools import checks as check

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
    """A read-only attribute: the argument of this name, or of another name, that an environment was made with."""

    def __init__(self, argument: str = "") -> None:
        self._argument = argument

    def __set_name__(self, owner: type, name: str) -> None:
        self._name, self._argument = name, self._argument or name

    def __get__(self, environment: Any, owner: type) -> Any:
        return self if environment is None else environment._settings[self._argument]

    def __set__(self, environment: Any, value: object) -> None:
        _refuse(self._name, value, f"make a new environment with {self._argument}=...")


class Settings:
    """Base of environments: assigning a setting, the scene or the state raises AttributeError, with the remedy."""

    _settings: Mapping[str, Any]  # the arguments by name
    contact, substeps, fidelity, task, control_dt = ReadOnly(), ReadOnly(), ReadOnly(), ReadOnly(), ReadOnly()
    torque, torque_source, randomize = ReadOnly(), ReadOnly("torque"), ReadOnly()
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
                setattr(cls, name, plain.setter(_refusing(name, instead)))


def _refusing(name: str, instead: str) -> Callable[[Any, object], None]:
    return lambda environment, value: _refuse(name, value, instead)


def _refuse(name: str, value: object, instead: str) -> NoReturn:
    raise AttributeError(f"{name} cannot be assigned, got {check.shown(value)}: {instead}")
