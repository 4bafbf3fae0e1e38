"""The environment of an evaluation in words, and notes about policies that were trained in another one."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from agents.files import as_value_error
from agents.policies.models import ModelPolicy
from agents.policies.network import NetworkPolicy
from agents.policies.one_bounce import LandingPolicy
from agents.policies.registry import POLICIES, SCRIPTED
from agents.policies.scripted import Policy
from agents.settings import EPISODE_STEPS, EnvSettings
from jackbox_env import Scene
from jackbox_env.simulators.fidelity import KEYWORDS, words


def describe_env(settings: EnvSettings) -> str:
    """The environment in one line: task, contact model, and what differs from the default."""
    others = [part.name for part in fields(EnvSettings) if part.name not in ("task", *KEYWORDS)]
    differing = [name for name in others if getattr(settings, name) != getattr(EnvSettings, name)]
    more = (f"{name} {getattr(settings, name)}" for name in differing)
    return ", ".join([f"task {settings.task}", words(settings.setting), *more])


def _settings_of(name: str, policy: Policy, here: EnvSettings) -> EnvSettings | None:
    """The environment that a policy was trained in, as ``here`` where it is not stored; None if nothing is."""
    if isinstance(policy, NetworkPolicy | LandingPolicy):
        return EnvSettings(**{part.name: getattr(policy.settings, part.name) for part in fields(EnvSettings)})
    stored = policy.stored if isinstance(policy, ModelPolicy) else None
    if stored is None:
        return None
    with as_value_error(f"env.json beside {name} describes no environment"):
        texts = {name: json.dumps(stored["env"][name]) for name in ("scene", "randomize") if name in stored["env"]}
        as_here = {name: getattr(here, name) for name in (*stored["functions"], *stored.get("each", ()))}
        settings = EnvSettings.of({**stored["env"], **texts, **as_here})
        Scene.of(settings.scene_fields)
    return settings


def _not_stored(stored: Mapping[str, Any]) -> list[str]:
    """In words, what env.json tells of a model's environments and cannot be played here."""
    functions, each = (" and ".join(stored.get(name, ())) for name in ("functions", "each"))
    steps = stored.get("max_episode_steps", EPISODE_STEPS)
    episodes = "episodes without a limit" if steps is None else f"episodes of {steps} steps"
    return [
        *[f"{functions} by functions of its own"] * bool(functions),
        *[f"another {each} in each environment"] * bool(each),
        *[f"{episodes}, not of {EPISODE_STEPS}"] * (steps != EPISODE_STEPS),
    ]


def warn_of_other_training(name: str, policy: Policy, here: EnvSettings) -> None:
    """Print a note if a policy was trained in another environment, or plans in another scene than those drawn."""
    if name in POLICIES and name not in SCRIPTED and here.randomized:
        print(f"Note: {name} plans in the scene that is given, not in those that randomize draws", file=sys.stderr)
    if isinstance(policy, ModelPolicy) and (others := _not_stored(policy.stored or {})):
        here_on = f"here it plays on {describe_env(here)}"
        print(f"Note: {name} was trained with {', '.join(others)}; {here_on}", file=sys.stderr)
    trained = _settings_of(name, policy, here)
    if trained is None:
        return
    same = replace(trained, **{name: getattr(here, name) for name in KEYWORDS}) == here
    if trained.setting != here.setting or not same:  # one setting can be written in several ways
        print(f"Note: {name} was trained in another environment ({describe_env(trained)})", file=sys.stderr)
