"""All policies by name. A policy of your own is a file here and a line in ``POLICIES``, or ``file.py:function``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from agents.policies.models import model_in_env, picture_policy
from agents.policies.network import SHIPPED, WEIGHTS, NetworkPolicy, layers_of, read_policy
from agents.policies.one_bounce import LANDING, read_landing
from agents.policies.planner import FAST_SEARCHES, planner_for
from agents.policies.scripted import PLAIN, LevelPolicy, PolicyWithEnv, RandomPolicy, StatelessPolicy, ZeroPolicy
from agents.policies.value import VALUE
from agents.runs import read_settings, run_folder, trusted_settings
from agents.settings import EnvSettings
from jackbox_env import Scene, Task
from jackbox_env.tools import checks as check
from jackbox_env.tools.model_files import model_in, read_parameters
from jackbox_env.tools.reading import as_value_error
from jackbox_env.tools.user_code import is_loaded, loaded, with_objects
from jackbox_env.tools.user_code import load as load_code

Maker = Callable[[dict[str, Any], int], PolicyWithEnv]  # of the environment's keywords and a seed
SCRIPTED: dict[str, Maker] = {
    "random": lambda _, seed: PolicyWithEnv(RandomPolicy(seed), PLAIN),
    "chirp": lambda *_: PolicyWithEnv(ZeroPolicy(), {**PLAIN, "torque": "chirp"}),
    "zero": lambda *_: PolicyWithEnv(ZeroPolicy(), PLAIN),
    "level": lambda keywords, _: PolicyWithEnv(LevelPolicy(Scene.of(keywords["scene"])), PLAIN),
}
POLICIES: dict[str, Maker] = {
    **SCRIPTED,
    "planner-fast": lambda keywords, seed: planner_for(keywords, seed, FAST_SEARCHES).in_env,
    "planner": lambda keywords, seed: planner_for(keywords, seed).in_env,
}


def find_policy(
    name: str,
    settings: EnvSettings,
    seed: int = 0,
    trust: bool = False,
    chosen: dict[str, Any] | None = None,
) -> PolicyWithEnv:
    """One of ``POLICIES`` or a shipped policy by its name, or a trained one by its run folder or file.

    Args:
        name: of the policy, or ``file.py:function`` that returns actions, (n,) or (n, size), for n observations.
        settings: of the environment that it plays in.
        seed: of what it draws.
        trust: unpickle a model that has no settings.json, and run the code that its settings, its env.json or the name
            of a function name; without it they must be loaded already (:func:`jackbox_env.tools.user_code.load`).
        chosen: keywords of the environment, over those of ``settings`` and of env.json. What a policy observes and does
            (:data:`agents.settings.PER_POLICY`) is chosen for such models and functions alone.

    Raises:
        FileNotFoundError: it is none of these.
        ValueError: it cannot be read or does not fit.
    """
    chosen = with_objects(chosen or {})
    keywords = {**settings.env_settings, **chosen}
    if name in POLICIES:
        return POLICIES[name](keywords, seed)
    if name in (shipped := shipped_names(keywords["task"])):
        return _read(SHIPPED / f"{keywords['task']}-{name}")
    if is_function(name):
        load_code([name] if trust and not is_loaded(name) else [])
        if not callable(function := loaded(name)):
            raise ValueError(f"a policy must be a function of observations, got {name}, {check.shown(function)}")
        return PolicyWithEnv(StatelessPolicy(function), {**PLAIN, **chosen})
    if not Path(name).exists():
        known = ", ".join((*POLICIES, *shipped))
        raise FileNotFoundError(
            f"a policy must be one of {known}, or a run folder, a model file or file.py:function, got {name!r}"
        )
    if (Path(name) / WEIGHTS).is_file():
        if folder := run_folder(Path(name)):
            trusted_settings(folder, trust)
        return _read(Path(name))
    file = model_in(Path(name))
    if run_folder(file):
        return policy_of_run(file, trust)
    return model_in_env(file, trust, {**settings.changed, **chosen})


def policy_of_run(path: Path, trust: bool) -> PolicyWithEnv:
    """The policy of a run folder, or of a model file in one; nothing is unpickled.

    Args:
        path: of the folder or the file.
        trust: run the code that its settings name.

    Raises:
        FileNotFoundError: there is no model, or no run folder.
        ValueError: a file is damaged, or the model does not fit the settings.
    """
    file = model_in(path)
    settings = trusted_settings(run_folder(file) or file.parent, trust)
    with as_value_error(f"{file} is no model of its settings"):
        parameters = read_parameters(file)["policy"]
        if settings.pixels:
            return picture_policy(settings, parameters)
        return NetworkPolicy(settings, layers_of(parameters)).in_env


def with_chosen_env(name: str) -> bool:
    """Whether it is chosen what a policy observes and does: a function, or a model file without settings.json."""
    return is_function(name) or (Path(name).is_file() and run_folder(Path(name)) is None)


def runs_code(name: str) -> bool:
    """Whether a policy runs code of its author: it is a function or a model file, or its settings name objects."""
    folder = run_folder(Path(name)) if Path(name).exists() else None
    return with_chosen_env(name) or (folder is not None and bool(read_settings(folder).objects))


def is_function(name: str) -> bool:
    """Whether a policy is a function in a file, ``file.py:function``."""
    return name.rpartition(":")[0].endswith(".py") and not Path(name).exists()


def _read(folder: Path) -> PolicyWithEnv:
    return read_landing(folder).in_env if (folder / LANDING).is_file() else read_policy(folder).in_env


def shipped_names(task: str | Task) -> list[str]:
    """Names of the trained policies for a task that come with the repository; none for a task of one's own."""
    folders = [path for path in SHIPPED.iterdir() if path.name.startswith(f"{task}-") and not (path / VALUE).is_file()]
    return sorted(path.name.removeprefix(f"{task}-") for path in folders)
