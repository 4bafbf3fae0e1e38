"""Models of Stable-Baselines3 that were trained without this project's command, played as they were trained.

A model's environment is stored in env.json beside it (:func:`jackbox_env.sb3.save_model`), or comes from ``--env``.
"""

from __future__ import annotations

import json
import pickle
import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from inspect import signature
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.policies.scripted import PLAIN, Actions, PolicyWithEnv
from agents.settings import LENGTHS, PER_POLICY, EnvSettings, TrainSettings
from jackbox_env import JackInBoxEnv
from jackbox_env.simulators.fidelity import FURTHER, KEYWORDS
from jackbox_env.tools import checks as check
from jackbox_env.tools.reading import as_value_error, unpacked
from jackbox_env.tools.user_code import is_object, with_objects
from jackbox_env.tools.user_code import load as load_code

# Algorithms by a name that only their models store; PPO's have A2C's too.
_ALGORITHMS = {
    "clip_range": "PPO", "target_entropy": "SAC", "target_policy_noise": "TD3", "normalize_advantage": "A2C",
    "exploration_fraction": "DQN",
}  # fmt: skip
_CIRCLES = [4, 5], [7, 8]  # components of a built-in observation that are a cosine and a sine
ENV_KEYWORDS = (
    *(name for name in signature(JackInBoxEnv).parameters if name != "settings" and not name.startswith("render")),
    *FURTHER, "max_episode_steps",
)  # fmt: skip


class Memory(NamedTuple):
    """The recurrent state of a model in n environments."""

    frames: list[NDArray[Any]]  # (n, k * numbers) of each VecFrameStack
    state: Any  # of the model's own


class ModelPolicy:
    """A model of Stable-Baselines3 on the observations of its environment.

    Args:
        model: with ``predict``.
        wrappers: what ``checked_wrapper`` returns of each; they change the observations in this order.
    """

    def __init__(self, model: Any, wrappers: list[dict[str, Any]]) -> None:
        self.model, self._wrappers = model, wrappers

    def predict(
        self, observation: Any, state: Memory | None = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Actions, Memory]:
        """The model's actions; see :class:`.scripted.Policy`."""
        pictures = np.ndim(observation) > 2
        rows, frames = np.asarray(observation, dtype=np.uint8 if pictures else np.float32), list[NDArray[Any]]()
        rows = np.atleast_2d(rows)
        for wrapper in self._wrappers:
            if "stack" in wrapper:
                size, earlier = rows.shape[1], state and state.frames[len(frames)]
                empty = np.zeros((len(rows), size * wrapper["stack"]), np.float32)
                stacked = empty if earlier is None else np.roll(earlier, -size, axis=1)
                stacked[np.broadcast_to(False if episode_start is None else episode_start, len(rows))] = 0.0
                stacked[:, -size:] = rows
                rows = stacked
                frames.append(stacked)
            else:
                scaled = (rows - wrapper["mean"]) / np.sqrt(wrapper["variance"] + wrapper["epsilon"])
                rows = np.clip(scaled, -wrapper["clip"], wrapper["clip"]).astype(np.float32)
        actions, recurrent = self.model.predict(
            rows, state=state and state.state, episode_start=episode_start, deterministic=deterministic
        )
        return actions[0] if np.ndim(observation) == 1 else actions, Memory(frames, recurrent)


def picture_policy(settings: TrainSettings, parameters: Mapping[str, Any]) -> PolicyWithEnv:
    """The convolutional network with these parameters of a training, in its environment.

    Raises:
        RuntimeError: they are not those of such a network.
    """
    from jackbox_env.sb3 import make_sb3_vec_env
    from jackbox_env.sb3.saved_models import make_model

    policy: Any = make_model(make_sb3_vec_env(1, **settings.env_settings), settings.arguments).policy
    policy.load_state_dict(parameters)
    policy.settings = settings
    return PolicyWithEnv(policy, settings.nouns)


def load(file: Path, stored: dict[str, Any] | None, trust: bool) -> Any:
    """A model, which is unpickled unless it is stored with the arguments that it is made from.

    Args:
        file: that Stable-Baselines3 has saved.
        stored: what env.json has about it; None: its algorithm is one of ``_ALGORITHMS``, by what the file has.
        trust: as of :func:`jackbox_env.sb3.load_model`.

    Raises:
        ValueError: the file is damaged, or of something else; or the algorithm is not of Stable-Baselines3.
    """
    from jackbox_env.sb3.saved_models import algorithm_named, load_model

    if stored and "arguments" in stored:
        return load_model(file, trust=trust)[0]
    with as_value_error(f"{file} is no model of Stable-Baselines3"):
        if stored is None:
            data = json.loads(unpacked(file.read_bytes(), file.name)["data"])
            names = [name for key, name in _ALGORITHMS.items() if key in data]
            if not names:
                raise ValueError(f"without env.json it must be of {', '.join(_ALGORITHMS.values())}")
            stored = {"algorithm": f"stable_baselines3:{names[0]}"}
        return algorithm_named(stored["algorithm"]).load(file, device="cpu")


def keywords_of(words: Iterable[str]) -> dict[str, Any]:
    """Keywords of the environment from words ``name=value``: a value is JSON, a name, or ``file.py:name``, then loaded.

    Those that choose the contact model come together, and the control steps of an episode are not cut by its decisions.

    Raises:
        ValueError: a word is not of that form, or the environment has no such keyword.
    """
    keywords = dict[str, Any]()
    for word in words:
        name, equals, value = word.partition("=")
        if not equals:
            raise ValueError(f"--env must be name=value, got {check.shown(word)}")
        keywords[name] = value
        with suppress(ValueError):
            keywords[name] = json.loads(value)
    check.known_keys("--env", keywords, ENV_KEYWORDS)
    load_code(filter(is_object, keywords.values()))
    contact = dict.fromkeys(KEYWORDS if keywords.keys() & {*KEYWORDS} else ())
    lengths = dict.fromkeys(LENGTHS if "episode_steps" in keywords else (), keywords.get("episode_steps"))
    return {**contact, **lengths, **keywords}


def model_in_env(
    file: Path, model: Any, stored: dict[str, Any] | None, settings: EnvSettings, chosen: dict[str, Any],
    vecnormalize: Path | None,
) -> PolicyWithEnv:  # fmt: skip
    """A loaded model with its environment: what is stored, over it what ``settings`` change, over both what is chosen.

    Raises:
        ValueError: the model does not fit, or something is missing; the message names the option that would help.
    """
    from jackbox_env.sb3 import make_sb3_vec_env
    from jackbox_env.sb3.saved_models import checked_wrapper, wrapped

    if stored is not None and vecnormalize is not None:
        raise ValueError(f"{file} is described by env.json beside it: leave --vecnormalize out, or move the model")
    if stored is None:
        stored = {"env": {}, "wrappers": _statistics(vecnormalize) if vecnormalize else [], "missing": []}
        if not chosen.keys() & {*PER_POLICY}:
            note = "describes it, so it chooses a torque in every control step (--env)"
            print(f"Note: no env.json beside {file} {note}", file=sys.stderr)
        if vecnormalize is None and _is_normalized(model):
            raise ValueError(
                f"{file} was trained under VecNormalize, whose statistics are missing: use --vecnormalize FILE.pkl, or "
                "save it by jackbox_env.sb3.save_model"
            )
    check.known_keys("missing in env.json", stored["missing"], ENV_KEYWORDS)
    for name in stored["missing"]:
        if name not in chosen:
            raise ValueError(
                f"{file} was trained with a {name} that env.json cannot store: use --env {name}=file.py:name"
            )
    with as_value_error(f"{file} cannot be played as env.json or --env describe"):
        load_code(filter(is_object, stored["env"].values()))
        keywords = with_objects({**PLAIN, **stored["env"], **settings.changed, **chosen})
        environments = wrapped(make_sb3_vec_env(1, **{**settings.env_settings, **keywords}), stored["wrappers"])
        shape, actions = environments.observation_space.shape or (), environments.action_space
        known = model.observation_space.shape
        if len(shape) > 1 and known == (shape[2], *shape[:2]):  # as Stable-Baselines3 transposes them
            known = shape
        wanted, got = (shape, actions), (known, model.action_space)
        if got != wanted:
            nouns = "use --env observation=..., --env action=... and --env action_repeat=... as in its training"
            if len(shape) == len(known) == 1 and known[0] > shape[0] and known[0] % shape[0] == 0:
                nouns = f"if VecFrameStack stacked them, save it by jackbox_env.sb3.save_model; else {nouns}"
            raise ValueError(f"it has observations {got[0]} and {got[1]}, got {wanted[0]} and {wanted[1]}: {nouns}")
    return PolicyWithEnv(ModelPolicy(model, [*map(checked_wrapper, stored["wrappers"])]), keywords)


def _is_normalized(model: Any) -> bool:
    """Whether the last observations in training had sines and cosines that are none, if they were built-in ones."""
    last = getattr(model, "_last_obs", None)
    if not isinstance(last, np.ndarray) or last.ndim != 2 or last.shape[1] not in (10, 21):
        return False
    return any(abs(np.square(last[:, pair]).sum(axis=1) - 1.0).max() > 1e-3 for pair in _CIRCLES)


def _statistics(path: Path) -> list[dict[str, Any]]:
    """The statistics in a file of ``VecNormalize``, which is unpickled; none if it normalizes rewards alone."""
    from stable_baselines3.common.vec_env import VecNormalize

    from jackbox_env.sb3.saved_models import statistics_of

    with as_value_error(f"{path} has no statistics of VecNormalize"):
        normalize = pickle.loads(path.read_bytes())
        if not isinstance(normalize, VecNormalize):
            raise TypeError(f"it is {check.shown(normalize)}")
        return [statistics_of(normalize)] if normalize.norm_obs else []
