"""Models of Stable-Baselines3, played as they were trained: env.json beside them describes their environments."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from inspect import signature
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from agents.policies.scripted import PLAIN, Actions, PolicyWithEnv
from agents.settings import TrainSettings
from jackbox_env import JackInBoxEnv
from jackbox_env.envs.settings import completed
from jackbox_env.simulators.fidelity import FURTHER
from jackbox_env.tools import checks as check
from jackbox_env.tools.user_code import is_object, with_objects
from jackbox_env.tools.user_code import load as load_code

ENV_KEYWORDS = (
    *(name for name in signature(JackInBoxEnv).parameters if name != "settings" and not name.startswith("render")),
    *FURTHER, "max_episode_steps",
)  # fmt: skip


class RecurrentState(NamedTuple):
    """The recurrent state of a model in n environments."""

    frames: list[NDArray[Any]]  # (n, k * numbers) of each VecFrameStack, or (n, h, w, k * channels)
    state: Any  # of the model's own


class ModelPolicy:
    """A model of Stable-Baselines3 on the observations of its environment.

    Args:
        model: with ``predict``.
        space: of an observation.
        layers: VecFrameStack and VecNormalize that change the observations, in this order.
    """

    def __init__(self, model: Any, space: gym.Space[Any], layers: list[Any]) -> None:
        self.model, self._space, self._layers = model, space, layers

    def predict(
        self,
        observation: Any,
        state: RecurrentState | None = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Actions, RecurrentState]:
        """The model's actions; see :class:`.scripted.Policy`."""
        shape: Any = self._space.shape
        rows, frames = np.asarray(observation, self._space.dtype).reshape(-1, *shape), list[NDArray[Any]]()
        for layer in self._layers:
            if "stacked_obs" not in vars(layer):
                rows = layer.normalize_obs(rows)
                continue
            size, earlier = rows.shape[-1], state and state.frames[len(frames)]
            empty = np.zeros((len(rows), *layer.observation_space.shape), rows.dtype)
            stacked = empty if earlier is None else np.roll(earlier, -size, axis=-1)
            stacked[np.broadcast_to(False if episode_start is None else episode_start, len(rows))] = 0
            stacked[..., -size:] = rows
            rows = stacked
            frames.append(stacked)
        actions, recurrent = self.model.predict(
            rows, state=state and state.state, episode_start=episode_start, deterministic=deterministic
        )
        return actions[0] if np.shape(observation) == shape else actions, RecurrentState(frames, recurrent)


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
    return PolicyWithEnv(policy, settings.interface)


def keywords_of(words: Iterable[str]) -> dict[str, Any]:
    """Keywords of the environment from words ``name=value``: a value is JSON, a name, or ``file.py:name``, then loaded.

    They are completed by :func:`jackbox_env.envs.settings.completed`.

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
    return completed(keywords)


def model_in_env(file: Path, trust: bool, changed: dict[str, Any]) -> PolicyWithEnv:
    """A saved model with its environment: that of env.json beside it, with the keywords that are changed.

    Raises:
        FileNotFoundError, ValueError: as :func:`jackbox_env.sb3.load_model`.
    """
    from jackbox_env.sb3.saved_models import entry_of, layers_of, load_model

    model, environments = load_model(file, trust=trust, **changed)
    keywords = with_objects({**PLAIN, **entry_of(file)["env"], **changed})
    return PolicyWithEnv(
        ModelPolicy(model, environments.unwrapped.observation_space, layers_of(environments)), keywords
    )
