"""The environment of an evaluation in words, and notes about policies of another one."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import fields
from types import MappingProxyType
from typing import Any

from agents.policies.registry import POLICIES, SCRIPTED
from agents.policies.scripted import PolicyWithEnv
from agents.settings import EnvSettings, setting_of
from jackbox_env.simulators.fidelity import KEYWORDS, words
from jackbox_env.tools import checks as check


def describe_env(settings: EnvSettings) -> str:
    """The environment in one line: task, contact model, and what differs from the default."""
    others = [part.name for part in fields(EnvSettings) if part.name not in ("task", *KEYWORDS)]
    differing = [name for name in others if getattr(settings, name) != getattr(EnvSettings, name)]
    more = (f"{name} {getattr(settings, name)}" for name in differing)
    return ", ".join([f"task {settings.task}", words(settings.setting), *more])


def note_other_environment(name: str, acting: PolicyWithEnv, here: EnvSettings) -> None:
    """Print a note if a policy was trained, or plays, in another environment, or plans in another scene than drawn."""
    if name in POLICIES and name not in SCRIPTED and here.randomized:
        print(f"Note: {name} plans in the scene that is given, not in those that randomize draws", file=sys.stderr)
    trained = getattr(acting.policy, "settings", None)
    if trained is not None:
        differing, verb = differences(trained.env_settings, here, trained.objects), "was trained"
    else:
        differing, verb = differences({**here.env_settings, **acting.keywords}, here), "plays"
    if differing:
        print(f"Note: {name} {verb} in another environment ({differing})", file=sys.stderr)


def differences(keywords: dict[str, Any], here: EnvSettings, objects: Mapping[str, str] = MappingProxyType({})) -> str:
    """What differs in an environment of these keywords, in words; ``objects`` are names of some of the values."""
    names = [name for name, value in here.env_settings.items() if name not in KEYWORDS and keywords[name] != value]
    setting = setting_of(keywords)
    others = [f"{name} {check.shown(objects.get(name, keywords[name]))}" for name in names]
    return ", ".join([words(setting)] * (setting != here.setting) + others)
