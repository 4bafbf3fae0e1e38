"""The environment of an evaluation in words, and notes about policies that were trained in another one."""

from __future__ import annotations

import json
import sys
from dataclasses import fields, replace
from pathlib import Path

from agents.files import as_value_error
from agents.policies.models import stored_beside
from agents.policies.network import SHIPPED
from agents.policies.one_bounce import LANDING, read_landing
from agents.policies.registry import POLICIES, SCRIPTED, shipped_names
from agents.runs import SETTINGS, read_settings, run_folder
from agents.settings import EnvSettings
from jackbox_env import Scene
from jackbox_env.simulators.fidelity import KEYWORDS, words


def describe_env(settings: EnvSettings) -> str:
    """The environment in one line: task, contact model, and what differs from the default."""
    others = [part.name for part in fields(EnvSettings) if part.name not in ("task", *KEYWORDS)]
    differing = [name for name in others if getattr(settings, name) != getattr(EnvSettings, name)]
    more = (f"{name} {getattr(settings, name)}" for name in differing)
    return ", ".join([f"task {settings.task}", words(settings.setting), *more])


def _settings_of(name: str, here: EnvSettings) -> EnvSettings | None:
    """The environment that a policy was trained in, a shipped network too; None if that is unknown."""
    if name in POLICIES:
        return None
    shipped = name in shipped_names(here.task)
    folder = SHIPPED / f"{here.task}-{name}" if shipped else run_folder(Path(name))
    settings: EnvSettings
    if folder is not None and (folder / SETTINGS).is_file():
        settings = read_settings(folder)
    elif ((folder or Path(name)) / LANDING).is_file():
        settings = read_landing(folder or Path(name)).settings
    else:
        return _stored_env(Path(name), here)
    return EnvSettings(**{part.name: getattr(settings, part.name) for part in fields(EnvSettings)})


def _stored_env(file: Path, here: EnvSettings) -> EnvSettings | None:
    """The environment in the env.json beside a model, with the functions' fields as ``here``; None if there is none."""
    stored = stored_beside(file)
    if stored is None:
        return None
    with as_value_error(f"env.json beside {file} describes no environment"):
        texts = {name: json.dumps(stored["env"][name]) for name in ("scene", "randomize") if name in stored["env"]}
        as_here = {name: getattr(here, name) for name in stored["functions"]}
        settings = EnvSettings.of({**stored["env"], **texts, **as_here})
        Scene.of(settings.scene_fields)
    return settings


def warn_of_other_training(name: str, here: EnvSettings) -> None:
    """Print a note if a policy was trained in another environment, or plans in another scene than those drawn."""
    if name in POLICIES and name not in SCRIPTED and here.randomized:
        print(f"Note: {name} plans in the scene that is given, not in those that randomize draws", file=sys.stderr)
    if name not in POLICIES and (functions := (stored_beside(Path(name)) or {}).get("functions")):
        here_on = f"here it plays on {describe_env(here)}"
        print(
            f"Note: {name} was trained with {' and '.join(functions)} by functions of its own; {here_on}",
            file=sys.stderr,
        )
    trained = _settings_of(name, here)
    if trained is None:
        return
    same = replace(trained, **{name: getattr(here, name) for name in KEYWORDS}) == here
    if trained.setting != here.setting or not same:  # one setting can be written in several ways
        print(f"Note: {name} was trained in another environment ({describe_env(trained)})", file=sys.stderr)
