"""Settings of environments are what they were made with: assigning one raises an error, and changes nothing."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from inspect import signature
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from jackbox_env import JackInBoxEnv, JackInBoxVectorEnv
from jackbox_env.sb3 import make_sb3_vec_env

VALUES = {
    "contact": "exact", "substeps": None, "fidelity": "exact", "task": "spin", "control_dt": 0.01, "torque": "chirp",
    "randomize": {"gravity": (1.0, 2.0)}, "render_mode": None, "render_size": (20, 30), "render_overlay": False,
    "num_envs": 2, "max_episode_steps": 9, "autoreset_mode": AutoresetMode.SAME_STEP, "num_threads": 1,
    "with_infos": True, "observation": "landing", "action": "landing", "action_repeat": 2, "episode_steps": 30,
}  # fmt: skip
CLASSES: list[type[JackInBoxEnv | JackInBoxVectorEnv]] = [JackInBoxEnv, JackInBoxVectorEnv]
INSTEAD = {
    **dict.fromkeys(
        ("task", "observation", "action", "action_repeat", "randomize", "control_dt", "contact"),
        "make a new environment with {}=",
    ),
    "scene": r'reset\(options={{"scene": ...}}\)',
}


@pytest.mark.parametrize("made", CLASSES)
def test_every_argument_is_an_attribute_that_cannot_be_assigned(made: Any) -> None:
    names = set(signature(made).parameters) - {"settings", "scene"}
    env = made(**{name: VALUES[name] for name in names})
    for one in (env, copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        for name in names:
            if not isinstance(attribute := getattr(one, name), np.ndarray):  # the observation of the present state
                assert attribute == VALUES[name]
            with pytest.raises(AttributeError, match=f"^{name} cannot be .*: make a new environment with {name}="):
                setattr(one, name, VALUES[name])
        for name in {"scene", "scenes", "state", "states", "time", "times"} & set(dir(one)):
            with pytest.raises(AttributeError, match=f"^{name} cannot be assigned, got .*: "):
                setattr(one, name, getattr(one, name))


def single() -> gym.Env[Any, Any]:
    return gym.make("JackInBox-v0", randomize={"gravity": (1.0, 2.0)})


SEVERAL: dict[str, Callable[[], Any]] = {
    "native": lambda: JackInBoxVectorEnv(2), "sync": lambda: SyncVectorEnv([single, single]),
    "sb3": lambda: make_sb3_vec_env(2), "wrapped": single,
}  # fmt: skip


@pytest.mark.parametrize("kind", SEVERAL)
@pytest.mark.parametrize("name", INSTEAD)
def test_set_attr_refuses_them(kind: str, name: str) -> None:
    envs = SEVERAL[kind]()
    assign = envs.set_wrapper_attr if kind == "wrapped" else envs.set_attr
    with pytest.raises(AttributeError, match=INSTEAD[name].format(name)):
        assign(name, "spin")
