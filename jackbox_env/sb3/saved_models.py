"""Models of Stable-Baselines3, saved and loaded together with the environment that they act in."""

from __future__ import annotations

import importlib
import json
import math
import sys
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec

from jackbox_env.envs.settings import completed
from jackbox_env.model.action import ACTIONS, EPISODE_STEPS, Action, most_decisions
from jackbox_env.model.observation import OBSERVATIONS, Observation
from jackbox_env.model.pixels import Pixels
from jackbox_env.model.scene import Drive, Scene
from jackbox_env.model.tasks import TASKS, Task
from jackbox_env.sb3.vec_env import make_sb3_vec_env
from jackbox_env.simulators.fidelity import KEYWORDS
from jackbox_env.tools import checks as check
from jackbox_env.tools.files import replacing, write_json
from jackbox_env.tools.model_files import BEST, MODEL, check_sizes, model_in, read_parameters
from jackbox_env.tools.reading import as_value_error
from jackbox_env.tools.user_code import is_object, load_trusted, with_objects

with check.extra("jackbox_env.sb3", "Stable-Baselines3", "train"):
    from stable_baselines3 import PPO
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecFrameStack, VecNormalize

ENV = "env.json"  # beside saved models: what they act in
PACKAGES = ("stable_baselines3", "sb3_contrib")  # that models are of
# Wrappers that change neither what an agent observes nor how it acts; VecNormalize if it has norm_obs=False.
_WITHOUT_EFFECT = {
    "Monitor", "OrderEnforcing", "PassiveEnvChecker", "RecordEpisodeStatistics", "RecordVideo", "TimeLimit",
    "VecCheckNan", "VecMonitor", "VecNormalize", "VecTransposeImage", "VecVideoRecorder",
}  # fmt: skip
_KEYS = {"algorithm": str, "env": dict, "missing": list, "wrappers": list}  # of an entry
_ARGUMENTS = (  # of PPO, that an entry may have, in which case only tensors are read of its model
    "policy", "learning_rate", "n_steps", "batch_size", "n_epochs", "gamma", "gae_lambda", "clip_range", "ent_coef",
    "policy_kwargs",
)  # fmt: skip
_BUILTIN: dict[type, Mapping[str, Any]] = {Task: TASKS, Observation: OBSERVATIONS, Action: ACTIONS}
_PICTURES = ("render_mode", "render_size", "render_overlay")
_MOST_BYTES = 10_000_000  # that are read of env.json
_MOST_STACKED = 10_000_000  # numbers of a stacked observation: more could fill all memory


def save_model(model: BaseAlgorithm, path: str | Path) -> Path:
    """Save a model of Stable-Baselines3 or sb3_contrib, and in env.json beside it the environment that it acts in.

    :func:`load_model` returns both, and ``jackbox evaluate --policy model.zip --trust`` plays it. env.json has an
    entry for each model of its folder: the environment's keywords, the statistics of ``VecNormalize`` as numbers and
    the number of frames of ``VecFrameStack``. A task, an observation or an action of your own is stored by its name in
    the module or the file that defines it, which loading then runs: so a script must train under
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


def write_entries(folder: Path, env: dict[str, Any], arguments: dict[str, Any]) -> None:
    """Write the env.json of a training by PPO in a run folder, whose models :func:`load_model` then does not unpickle.

    Args:
        folder: of the run.
        env: keywords of :func:`make_sb3_vec_env`, of JSON types; objects are named, and code.json has their texts.
        arguments: keywords of PPO, of JSON types.
    """
    entry = {"env": env, "missing": [], "wrappers": [], "algorithm": _algorithm_of(PPO), "arguments": arguments}
    write_json(folder / ENV, dict.fromkeys((BEST, MODEL), entry))


def load_model(
    path: str | Path, num_envs: int = 1, trust: bool = False, **env_kwargs: Any
) -> tuple[BaseAlgorithm, VecEnv]:
    """Load a model that :func:`save_model` or ``jackbox train`` saved, and environments as those it was trained in.

    They have the stored statistics of ``VecNormalize``, which do not change, and the frames of ``VecFrameStack``.
    Rewards are the task's own. Models of ``jackbox train`` load from settings and tensors. Other files are unpickled.

    Args:
        path: of the model, or a run folder: its best model, else its last.
        num_envs: number of environments. Seed them by ``.seed(0)``, then reset.
        trust: unpickle the model, and run the code of a task, observation or action of a user that env.json names.
        **env_kwargs: of :func:`make_sb3_vec_env`, in place of what is stored. ``episode_steps`` also replaces a stored
            ``max_episode_steps``, and ``fidelity`` a stored contact model.

    Returns:
        The model and the environments. To train a model of ``jackbox train`` further, its learning rate is constant.

    Raises:
        FileNotFoundError: there is no model, or no env.json that describes it.
        ValueError: trust is needed; or a file is damaged, or the model does not fit its environment; or ``env_kwargs``
            lacks a keyword that env.json cannot store.
    """
    file = model_in(Path(path))
    stored = entry_of(file)
    if not (trust or "arguments" in stored):
        raise ValueError(f"{file} can run code, as it is unpickled: if you trust its author, use --trust or trust=True")
    keywords = {**stored["env"], **completed(env_kwargs)}
    if missing := {*map(str, stored["missing"])} - keywords.keys():
        name = min(missing)
        raise ValueError(
            f"{ENV} cannot store the {name} that {file} was trained with: load it with {name}=..., or evaluate it with "
            f"--env {name}=file.py:name"
        )
    load_trusted(file.parent.absolute(), filter(is_object, keywords.values()), trust)
    with as_value_error(f"{file} cannot be played as {ENV} describes and options change"):
        environments = wrapped(make_sb3_vec_env(num_envs, **with_objects(keywords)), stored["wrappers"])
    with as_value_error(f"{file} is no model of {ENV} beside it"):
        if "arguments" not in stored:
            return algorithm_named(stored["algorithm"]).load(file, env=environments, device="cpu"), environments
        model = make_model(environments, _checked(stored["arguments"], environments))
        model.set_parameters(read_parameters(file), device="cpu")
    return model, environments


def make_model(environments: VecEnv, arguments: dict[str, Any], **more: Any) -> PPO:
    """An untrained PPO model on the CPU, whose batches have at most the samples of a rollout."""
    size = min(arguments["batch_size"], arguments["n_steps"] * environments.num_envs)
    return PPO(env=environments, device="cpu", **{**arguments, "batch_size": size, **more})


def _checked(arguments: dict[str, Any], environments: VecEnv) -> dict[str, Any]:
    """The arguments; raises an exception if they are not known, or make a model beyond any memory."""
    check.known_keys("arguments", arguments, _ARGUMENTS)
    check.known_keys("policy_kwargs", arguments["policy_kwargs"], ("net_arch", "log_std_init"))
    steps, layers = check.whole("n_steps", arguments["n_steps"], at_least=1), arguments["policy_kwargs"]["net_arch"]
    widths = [check.whole("net_arch", width, at_least=1) for width in layers]
    check_sizes(environments.num_envs, steps, environments.observation_space.shape or (), widths)
    return arguments


def algorithm_named(name: str) -> type[BaseAlgorithm]:
    """The algorithm ``module:class`` of Stable-Baselines3 or sb3_contrib.

    Raises:
        ValueError: it is something else.
    """
    module, _, attribute = name.partition(":")
    kind = getattr(importlib.import_module(module), attribute, None) if module.split(".")[0] in PACKAGES else None
    if not (isinstance(kind, type) and issubclass(kind, BaseAlgorithm)):
        raise ValueError(f"its algorithm must be of {' or '.join(PACKAGES)}, got {check.shown(name)}")
    return kind


def wrapped(environments: VecEnv, wrappers: list[dict[str, Any]]) -> VecEnv:
    """Environments in the wrappers of an entry, the innermost first; raises an exception if these do not fit."""
    for wrapper in wrappers:
        shape: Any = environments.observation_space.shape
        if "stack" in wrapper:
            most = max(1, min(1000, _MOST_STACKED // math.prod(shape)))
            environments = VecFrameStack(environments, check.whole("stack", wrapper["stack"], at_least=1, at_most=most))
            continue
        mean, variance = (np.array(wrapper[name], np.float64) for name in ("mean", "variance"))
        if not (mean.shape == variance.shape == shape and np.isfinite(mean).all() and (variance >= 0.0).all()):
            raise ValueError(f"mean and variance must be arrays of shape {shape}, at least 0 in the variance")
        clip, epsilon = (check.real(name, wrapper[name], at_least=0.0) for name in ("clip", "epsilon"))
        environments = VecNormalize(environments, False, norm_reward=False, clip_obs=clip, epsilon=epsilon)
        statistics: Any = environments.obs_rms
        statistics.mean, statistics.var = mean, variance
    return environments


def layers_of(environments: VecEnv | None) -> list[Any]:
    """The wrappers of environments, the innermost first."""
    layers = list[VecEnvWrapper]()
    while isinstance(environments, VecEnvWrapper):
        layers.insert(0, environments)
        environments = environments.venv
    return layers


def entry_of(file: Path) -> dict[str, Any]:
    """The entry of a model in the env.json beside it.

    A model that was renamed has the only entry, if no other model is in its folder.

    Raises:
        FileNotFoundError: env.json is missing, or has no entry for it.
        ValueError: env.json is damaged.
    """
    entries = read_stored(file.parent / ENV)
    if len(entries) == 1 and list(file.parent.glob(f"*{file.suffix}")) == [file]:
        return next(iter(entries.values()))
    if file.name not in entries:
        raise FileNotFoundError(
            f"{file} needs an {ENV} beside it that describes its environment: load it with its environments, as "
            "PPO.load(path, env=envs), and save it by jackbox_env.sb3.save_model"
        )
    return entries[file.name]


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


def _algorithm_of(kind: type) -> str:
    """``module:class`` of a model's algorithm; for a subclass elsewhere, of that which it derives from."""
    for one in kind.__mro__:
        package, *inner = one.__module__.split(".")
        if package in PACKAGES and "common" not in inner:
            return f"{one.__module__}:{one.__qualname__}"
    raise TypeError(f"save_model needs a model of {' or '.join(PACKAGES)}, got {check.shown(kind)}")


def _spec_of(environments: VecEnv | None) -> EnvSpec:
    """The spec that all environments have."""
    specs: list[EnvSpec] = [] if environments is None else environments.unwrapped.get_attr("spec")
    if not specs or any(spec is None or spec.id != "JackInBox-v0" for spec in specs):
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
    return specs[0]


def _wrappers_of(environments: VecEnv | None) -> list[dict[str, Any]]:
    """The wrappers that change observations, the innermost first, for JSON."""
    stored = list[dict[str, Any]]()
    for layer in layers_of(environments):
        if isinstance(layer, VecFrameStack):
            stored.append({"stack": layer.stacked_obs.n_stack})
        elif vars(layer).get("norm_obs"):  # of VecNormalize
            stored.append({
                "mean": layer.obs_rms.mean.tolist(), "variance": layer.obs_rms.var.tolist(),
                "clip": float(layer.clip_obs), "epsilon": float(layer.epsilon),
            })  # fmt: skip
        elif type(layer).__name__ not in _WITHOUT_EFFECT:
            raise _refused({type(layer).__name__})
    return stored


def _refused(wrappers: set[str]) -> ValueError:
    known = "of wrappers that change observations or actions it stores VecNormalize and VecFrameStack"
    return ValueError(f"save_model cannot store {', '.join(sorted(wrappers))}: {known}")


def _storable(spec: EnvSpec) -> tuple[dict[str, Any], list[str]]:
    """The environment's keywords, as JSON has them, and the names of those that it cannot have."""
    keywords = {**dict.fromkeys(KEYWORDS), **spec.kwargs}
    env = {name: _storable_value(name, value) for name, value in keywords.items() if name not in _PICTURES}
    missing = [name for name, value in env.items() if value is None and keywords[name] is not None]
    most = most_decisions(spec.kwargs.get("episode_steps", EPISODE_STEPS), spec.kwargs.get("action_repeat", 1))
    if (spec.max_episode_steps or math.inf) < most:
        env["max_episode_steps"] = spec.max_episode_steps
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
