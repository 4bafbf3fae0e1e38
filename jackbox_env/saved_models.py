"""Models of Stable-Baselines3 saved together with how they act."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gymnasium.envs.registration import EnvSpec

from jackbox_env import checks as check
from jackbox_env.files import replacing, write_json
from jackbox_env.scene import Drive, Scene
from jackbox_env.simulators.fidelity import KEYWORDS

try:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecNormalize
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(check.extra_needed("jackbox_env.sb3", "Stable-Baselines3", "train")) from error

ENV = "env.json"  # beside saved models: how they act
# Wrappers that change neither what an agent observes nor how it acts.
_WITHOUT_EFFECT = {
    "Monitor", "OrderEnforcing", "PassiveEnvChecker", "RecordEpisodeStatistics", "RecordVideo", "TimeLimit",
    "VecCheckNan", "VecMonitor", "VecVideoRecorder",
}  # fmt: skip
_KEYS = {"env", "repeat", "landing", "lookahead", "normalize", "unknown", "functions"}  # of an entry, at least
_FUNCTIONS: dict[str, Callable[[Any], bool]] = {  # keywords that may be functions, and whether one is
    "task": lambda task: not isinstance(task, str),
    "randomize": callable,
    "scene": lambda scene: isinstance(scene.drive, Drive),
}
_MOST_BYTES = 10_000_000  # that are read of env.json


def save_model(model: BaseAlgorithm, path: str | Path) -> Path:
    """Save a model of Stable-Baselines3, and in env.json beside it how the model acts.

    ``jackbox evaluate --policy model.zip --trust`` then plays it as it was trained. env.json has an entry for each
    model of its folder: the environment, action repeat, landing control, look-ahead, and the statistics of
    ``VecNormalize`` as numbers. Functions, such as a task of your own, and settings that differ between the
    environments, such as a list of scenes, are named but not stored. Both files are replaced in one stroke.

    Args:
        model: trained on :func:`make_sb3_vec_env`, or on ``gymnasium.make("JackInBox-v0")`` in any of
            Stable-Baselines3's environments.
        path: of the model's file; without a suffix it gets ``.zip``.

    Returns:
        The model's path.

    Raises:
        TypeError: the model has no such environment.
        ValueError: an existing env.json has other contents.
    """
    path = Path(path)
    path = path if path.suffix else path.with_suffix(".zip")
    stored = {**read_stored(path.parent / ENV), path.name: _stored(model.get_env())}
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
        if not isinstance(entry, dict) or not entry.keys() >= _KEYS:
            raise ValueError(f"{path}: {name} must have {', '.join(sorted(_KEYS))}, got {check.shown(entry)}")
    return entries


def _stored(venv: VecEnv | None) -> dict[str, Any]:
    """How agents act in environments of Stable-Baselines3, for JSON."""
    inner: Any = None if venv is None else venv.unwrapped
    specs = [] if inner is None else inner.get_attr("spec")
    if any(spec is None or spec.id != "JackInBox-v0" for spec in specs or [None]):
        raise TypeError(f"save_model needs a model with environments of JackInBox-v0, got {check.shown(venv)}")
    stored = dict[str, Any](repeat=1, landing=None, lookahead=None, normalize=None)
    unknown = ["torque='chirp'"] * any(spec.kwargs.get("torque") == "chirp" for spec in specs)
    wrappers = [[one for one in spec.additional_wrappers if one.name not in _WITHOUT_EFFECT] for spec in specs]
    unknown += ["wrappers that differ between its environments"] * any(str(one) != str(wrappers[0]) for one in wrappers)
    for wrapper in wrappers[0]:
        if wrapper.name in ("LandingControl", "Lookahead"):
            stored |= inner.get_attr("stored")[0]
        else:
            unknown.append(wrapper.name)
    layers = list[VecEnv]()
    while isinstance(venv, VecEnvWrapper):
        layers, venv = [venv, *layers], venv.venv
    for layer in layers:
        if isinstance(layer, VecNormalize):
            unknown += ["a second VecNormalize"] * (stored["normalize"] is not None)
            stored["normalize"] = statistics_of(layer)
        elif hasattr(type(layer), "stored"):
            repeats = stored["repeat"] != 1 or stored["landing"] is not None or stored["lookahead"] is not None
            unknown += [f"{type(layer).__name__} around another that repeats actions"] * repeats
            stored |= layer.stored  # type: ignore[attr-defined]
        elif type(layer).__name__ not in _WITHOUT_EFFECT:
            unknown.append(type(layer).__name__)
    return {**_environments(specs), **stored, "unknown": unknown}


def _environments(specs: list[EnvSpec]) -> dict[str, Any]:
    """Settings of the environments that all share, for JSON, and the names of the others."""
    every = [
        {"task": "juggle", "randomize": None, **spec.kwargs, "scene": Scene.of(spec.kwargs.get("scene"))}
        for spec in specs
    ]
    functions = [name for name, is_function in _FUNCTIONS.items() if any(is_function(one[name]) for one in every)]
    envs = [_storable({**one, **dict.fromkeys(functions)}) for one in every]
    names = dict.fromkeys(name for env in envs for name in env)
    each = [name for name in names if any(env.get(name) != envs[0].get(name) for env in envs)]
    env = {name: value for name, value in envs[0].items() if name not in each}
    return {"env": env, "functions": functions, "each": each, "max_episode_steps": specs[0].max_episode_steps}


def _storable(keywords: dict[str, Any]) -> dict[str, Any]:
    """Keywords of an environment that differ from the default, as JSON has them; None is left out, but for the task."""
    stored = {name: keywords[name] for name in ("task", *KEYWORDS, "control_dt") if name in keywords}
    if keywords["randomize"] is not None:
        stored["randomize"] = {name: list(ends) for name, ends in keywords["randomize"].items()}
    if keywords["scene"] is not None:
        fields, default = keywords["scene"].as_dict(), Scene().as_dict()
        stored["scene"] = {name: value for name, value in fields.items() if (name, value) not in default.items()}
    plain: dict[str, Any] = json.loads(json.dumps(stored, default=lambda number: number.tolist()))  # of numpy
    return plain


def statistics_of(normalize: VecNormalize) -> dict[str, Any] | None:
    """How ``VecNormalize`` changes observations, for JSON; None if it changes rewards only."""
    if not normalize.norm_obs:
        return None
    statistics: Any = normalize.obs_rms
    return {
        "mean": statistics.mean.tolist(), "variance": statistics.var.tolist(), "clip": float(normalize.clip_obs),
        "epsilon": float(normalize.epsilon),
    }  # fmt: skip
