"""The meaning of a return: the environment that policies of a table share, in words, and notes on their training."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import fields
from types import MappingProxyType
from typing import Any

from agents.policies.registry import POLICIES, SCRIPTED
from agents.policies.scripted import PolicyWithEnv
from agents.settings import PER_POLICY
from jackbox_env import Scene
from jackbox_env.envs.vector import JackInBoxVectorEnv
from jackbox_env.model.action import EPISODE_STEPS, repeat_of
from jackbox_env.simulators.fidelity import KEYWORDS, Setting, named
from jackbox_env.tools import checks as check

Facts = dict[str, Any]
_ALWAYS = ("task", *KEYWORDS)  # in the line about an environment


def facts_of(keywords: Mapping[str, Any]) -> Facts:
    """The keywords of an environment that decide the meaning of a return: all but :data:`PER_POLICY`, in one form.

    Raises:
        TypeError, ValueError: the environment refuses a keyword, or an episode has no certain number of control steps.
    """
    env = JackInBoxVectorEnv(1, **keywords)
    decisions, steps = env.max_episode_steps or math.inf, env.episode_steps or math.inf
    repeat = repeat_of(env.action_repeat, env.control_dt)
    most = min(steps, decisions * repeat.steps)
    if most == math.inf or (repeat.max_contact_steps and decisions < math.inf):
        got = f"at most {steps:g} in at most {decisions:g} decisions"
        use = f"use --env episode_steps={env.episode_steps or EPISODE_STEPS}"
        raise ValueError(f"episodes must have one number of control steps, got {got}: {use}")
    scene, plain, names = env.scenes[0], Scene(), [part.name for part in fields(Scene)]
    changed = [name for name in names if name not in scene.derived and getattr(scene, name) != getattr(plain, name)]
    return {
        "task": env.task, **named(Setting(env.contact, env.substeps)), "control_dt": env.control_dt,
        "scene": {name: getattr(scene, name) for name in changed}, "randomize": env.randomize or None,
        "episode_steps": int(most),
    }  # fmt: skip


def differences(facts: Facts, others: Facts, names: Mapping[str, str] = MappingProxyType({})) -> str:
    """The facts that others lack or have with another value, in one line; ``names`` are those of some values."""
    differing = {name: value for name, value in facts.items() if name not in others or others[name] != value}
    texts = {name: value if isinstance(value, str) else check.shown(value) for name, value in differing.items()}
    return ", ".join(f"{name} {names.get(name, text)}" for name, text in texts.items())


def shared_environment(acts: Mapping[str, PolicyWithEnv], here: Mapping[str, Any]) -> dict[str, Any]:
    """The keywords of the environment in which all these policies play; only :data:`PER_POLICY` are each policy's own.

    Args:
        acts: policies by name; their keywords go before ``here``.
        here: keywords of the environment.

    Raises:
        ValueError: their environments differ in something else, so that their returns cannot be compared.
    """
    facts = {name: facts_of({**here, **act.keywords}) for name, act in acts.items()}
    first, shared = next(iter(facts.items()))
    for name, others in facts.items():
        if others != shared:
            raise ValueError(
                f"{name} would play with {differences(others, shared)}, {first} with "
                f"{differences(shared, others)}, but a table compares the same episodes: choose for all, "
                "as by --env task=spin or --env episode_steps=500, or evaluate one at a time"
            )
    steps = {"episode_steps": shared["episode_steps"], "max_episode_steps": None}
    return {name: value for name, value in {**here, **acts[first].keywords, **steps}.items() if name not in PER_POLICY}


def describe_env(keywords: Mapping[str, Any], names: Mapping[str, str]) -> str:
    """An environment in one line: task, contact model, and what differs from the default; objects by their names."""
    usual = {name: value for name, value in facts_of({}).items() if name not in _ALWAYS}
    return differences(facts_of(keywords), usual, names)


def note_other_environment(name: str, acting: PolicyWithEnv, env: Mapping[str, Any]) -> None:
    """Print a note if a policy was trained in another environment, or plans in another scene than is drawn."""
    if name in POLICIES and name not in SCRIPTED and env["randomize"]:
        print(f"Note: {name} plans in the scene that is given, not in those that randomize draws", file=sys.stderr)
    trained = getattr(acting.policy, "settings", None)
    if trained and (other := differences(facts_of(trained.env_settings), facts_of(env), trained.objects)):
        print(f"Note: {name} was trained in another environment ({other})", file=sys.stderr)
