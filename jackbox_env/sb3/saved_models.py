"""Models of Stable-Baselines3 saved together with the environment that they act in."""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec

from jackbox_env.model.action import ACTIONS, Action
from jackbox_env.model.observation import OBSERVATIONS, Observation
from jackbox_env.model.pixels import Pixels
from jackbox_env.model.scene import Drive, Scene
from jackbox_env.model.tasks import TASKS, Task
from jackbox_env.simulators.fidelity import KEYWORDS
from jackbox_env.tools import checks as check
from jackbox_env.tools.files import replacing, write_json

with check.extra("jackbox_env.sb3", "Stable-Baselines3", "train"):
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecFrameStack, VecNormalize

ENV = "env.json"  # beside saved models: what they act in
PACKAGES = ("stable_baselines3", "sb3_contrib")  # that models are of
# Wrappers that change neither what an agent observes nor how it acts.
_WITHOUT_EFFECT = {
    "Monitor", "OrderEnforcing", "PassiveEnvChecker", "RecordEpisodeStatistics", "RecordVideo", "TimeLimit",
    "VecCheckNan", "VecMonitor", "VecTransposeImage", "VecVideoRecorder",
}  # fmt: skip
_KEYS = {"algorithm": str, "env": dict, "missing": list, "wrappers": list}  # of an entry
_BUILTIN: dict[type, Mapping[str, Any]] = {Task: TASKS, Observation: OBSERVATIONS, Action: ACTIONS}
_PICTURES = ("render_mode", "render_size", "render_overlay")
_MOST_BYTES = 10_000_000  # that are read of env.json


def save_model(model: BaseAlgorithm, path: str | Path) -> Path:
    """Save a model of Stable-Baselines3 or sb3_contrib, and in env.json beside it the environment that it acts in.

    ``jackbox evaluate --policy model.zip --trust`` then plays it where it was trained. env.json has an entry for each
    model of its folder: the environment's keywords, the statistics of ``VecNormalize`` as numbers and the number of
    frames of ``VecFrameStack``. A task, an observation or an action of your own is stored by its name in the module or
    the file that defines it, which ``evaluate`` then runs: so a script must train under
    ``if __name__ == "__main__":``. If it has no such name, there is a warning. Both files are replaced in one stroke.

    Args:
        model: trained on :func:`make_sb3_vec_env`, or on ``gymnasium.make("JackInBox-v0")`` in any of
            Stable-Baselines3's environments.
        path: of the model's file; without a suffix it gets ``.zip``.

    Returns:
        The model's path.

    Raises:
        TypeError: the model has no such environment, or its algorithm is of another package.
        ValueError: there are other wrappers, or environments that differ; or an existing env.json has other contents;
            or an evaluation runs the script for its task, observation or action.
    """
    path = Path(path)
    path = path if path.suffix else path.with_suffix(".zip")
    algorithm, environments = _algorithm_of(type(model)), model.get_env()
    spec, wrappers = _spec_of(environments), _wrappers_of(environments)
    env, missing = _storable(spec)
    entry = {"env": env, "missing": missing, "wrappers": wrappers, "algorithm": algorithm}
    stored = {**read_stored(path.parent / ENV), path.name: entry}
    if missing:
        options = " ".join(f"--env {name}=file.py:name" for name in missing)
        reason = "no module or file has it by a name"
        warnings.warn(
            f"{ENV} cannot store {' and '.join(missing)}, as {reason}: evaluate the model with {options}", stacklevel=2
        )
    with replacing(path) as partial:
        model.save(partial)
    write_json(path.parent / ENV, stored)
    return path


def read_stored(path: Path) -> dict[str, dict[str, Any]]:
    """The entries of an env.json by the name of the model's file; empty if the file is missing.

    Raises:
        ValueError: it is damaged, or something else.
    """
    if not path.is_file():
        return {}
    entries = check.from_json(str(path), path.read_bytes()[:_MOST_BYTES].decode(errors="replace"), dict)
    for name, entry in entries.items():
        if not isinstance(entry, dict) or not all(isinstance(entry.get(key), kind) for key, kind in _KEYS.items()):
            needed = ", ".join(f"{key} ({kind.__name__})" for key, kind in _KEYS.items())
            raise ValueError(f"{path}: {name} must have {needed}, got {check.shown(entry)}")
    return entries


def statistics_of(normalize: VecNormalize) -> dict[str, Any]:
    """How ``VecNormalize`` changes observations, for JSON."""
    statistics: Any = normalize.obs_rms
    return {
        "mean": statistics.mean.tolist(), "variance": statistics.var.tolist(), "clip": float(normalize.clip_obs),
        "epsilon": float(normalize.epsilon),
    }  # fmt: skip


def _algorithm_of(kind: type) -> str:
    """``module:class`` of a model's algorithm; for a subclass elsewhere, of that which it derives from."""
    for one in kind.__mro__:
        package, *inner = one.__module__.split(".")
        if package in PACKAGES and "common" not in inner:
            return f"{one.__module__}:{one.__qualname__}"
    raise TypeError(f"save_model needs a model of {' or '.join(PACKAGES)}, got {check.shown(kind)}")


def _spec_of(environments: VecEnv | None) -> EnvSpec:
    """The spec that all environments have."""
    specs = [] if environments is None else environments.unwrapped.get_attr("spec")
    if any(spec is None or spec.id != "JackInBox-v0" for spec in specs or [None]):
        raise TypeError(f"save_model needs a model with environments of JackInBox-v0, got {check.shown(environments)}")
    wrappers = {one.name for spec in specs for one in spec.additional_wrappers} - _WITHOUT_EFFECT
    if wrappers:
        raise _refused(wrappers)
    differing = {
        name
        for spec in specs
        for name in spec.kwargs.keys() | specs[0].kwargs.keys()
        if spec.kwargs.get(name) != specs[0].kwargs.get(name)
    }
    if differing:
        raise ValueError(f"save_model needs environments with the same {' and '.join(sorted(differing))}, got several")
    first: EnvSpec = specs[0]
    return first


def _wrappers_of(environments: VecEnv | None) -> list[dict[str, Any]]:
    """The wrappers that change observations, the innermost first, for JSON."""
    stored = list[dict[str, Any]]()
    while isinstance(environments, VecEnvWrapper):
        if isinstance(environments, VecNormalize):
            stored += [statistics_of(environments)] * environments.norm_obs
        elif isinstance(environments, VecFrameStack):
            stored.append({"stack": environments.stacked_obs.n_stack})
        elif type(environments).__name__ not in _WITHOUT_EFFECT:
            raise _refused({type(environments).__name__})
        environments = environments.venv
    return stored[::-1]


def _refused(wrappers: set[str]) -> ValueError:
    known = "of wrappers that change observations or actions it stores VecNormalize and VecFrameStack"
    return ValueError(f"save_model cannot store {', '.join(sorted(wrappers))}: {known}")


def _storable(spec: EnvSpec) -> tuple[dict[str, Any], list[str]]:
    """The environment's keywords, as JSON has them, and the names of those that it cannot have."""
    keywords = {**dict.fromkeys(KEYWORDS), **spec.kwargs}
    env = {name: _storable_value(name, value) for name, value in keywords.items() if name not in _PICTURES}
    missing = [name for name, value in env.items() if value is None and keywords[name] is not None]
    decisions = spec.max_episode_steps or spec.kwargs.get("episode_steps")  # without a limit of decisions that of steps
    if decisions not in (None, gym.spec("JackInBox-v0").max_episode_steps):
        env["max_episode_steps"] = decisions
    plain: dict[str, Any] = json.loads(json.dumps(env, default=lambda number: number.tolist()))  # of numpy
    return {name: value for name, value in plain.items() if name not in missing}, missing


def _storable_value(name: str, value: Any) -> Any:
    """A keyword's value for JSON; None if it cannot have it."""
    if name == "scene" and not isinstance(Scene.of(value).drive, Drive):
        default = Scene().as_dict()
        fields = Scene.of(value).as_dict().items()
        return {field: number for field, number in fields if field not in default or number != default[field]}
    if name == "scene" or callable(value) or isinstance(value, tuple(_BUILTIN)):
        return _name_of(value)
    return value.name if isinstance(value, Pixels) else value


def _name_of(value: Any) -> str | None:
    """The name of a built-in object, else ``file.py:name`` or ``module:name``; None if there is none.

    Raises:
        ValueError: its file is being run only for its objects, for an evaluation.
    """
    for name, one in _BUILTIN.get(type(value), {}).items():
        if one is value:
            return name
    function = getattr(value, "torque", getattr(value, "values", value))
    for module in (getattr(function, "__module__", "__main__"), "__main__"):
        for name, one in vars(sys.modules.get(module, object)).items():
            if one is value or (isinstance(value, Scene) and isinstance(one, Scene) and one == value):
                file = getattr(sys.modules[module], "__file__", None) if module == "__main__" else None
                if module != "__main__" and getattr(sys.modules[module], "__spec__", None) is None:
                    script = Path(getattr(sys.modules[module], "__file__", None) or module).name
                    guard = 'if __name__ == "__main__"'
                    raise ValueError(f"{script} is run for its {name}, so it must train under {guard}")
                source = str(Path(file).resolve()) if file and file.endswith(".py") else module
                return None if source == "__main__" else f"{source}:{name}"
    return None
