"""All policies by name. A policy of your own is a file here and a line in ``POLICIES``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from agents.files import as_value_error
from agents.policies.models import Options, load, policy_of
from agents.policies.network import SHIPPED, WEIGHTS, NetworkPolicy, layers_of, read_policy
from agents.policies.one_bounce import LANDING, read_landing
from agents.policies.planner import FAST_SEARCHES, PlanAlone, planner_for
from agents.policies.scripted import Baseline, LevelPolicy, Policy, RandomPolicy, ZeroPolicy
from agents.policies.value import VALUE
from agents.runs import SETTINGS, TRAINED_BY, model_in, read_parameters, read_settings, run_folder
from agents.settings import EnvSettings, TrainSettings
from jackbox_env import Scene

SCRIPTED: dict[str, Callable[[EnvSettings, Scene, int], Baseline]] = {  # of the environment, its scene, and a seed
    "random": lambda _, scene, seed: Baseline(RandomPolicy(seed), {}),
    "chirp": lambda *_: Baseline(ZeroPolicy(), {"torque": "chirp"}),
    "zero": lambda *_: Baseline(ZeroPolicy(), {}),
    "level": lambda _, scene, seed: Baseline(LevelPolicy(scene), {}),
}
POLICIES: dict[str, Callable[[EnvSettings, Scene, int], Baseline]] = {
    **SCRIPTED,
    "lookahead": lambda settings, *_: Baseline(PlanAlone(settings), {}),
    "planner-fast": lambda settings, scene, seed: Baseline(planner_for(settings, scene, seed, FAST_SEARCHES), {}),
    "planner": lambda settings, scene, seed: Baseline(planner_for(settings, scene, seed), {}),
}
_FORMER_NAMES = {"planner-64": "planner-fast"}


def find_policy(
    name: str, settings: EnvSettings, seed: int = 0, trust: bool = False, options: Options | None = None
) -> Baseline:
    """One of ``POLICIES`` or a shipped policy by its name, or a trained one by its run folder or file.

    Args:
        name: of the policy.
        settings: of the environment that it plays in.
        seed: of what it draws.
        trust: unpickle a model that has no settings.json.
        options: how such a model acts; None: as env.json beside it describes.

    Raises:
        FileNotFoundError: it is none of these.
    """
    name = _FORMER_NAMES.get(name, name)
    if name in POLICIES:
        return POLICIES[name](settings, Scene.of(settings.scene_fields), seed)
    if name in shipped_names(settings.task):
        return Baseline(_read(SHIPPED / f"{settings.task}-{name}"), {})
    if not Path(name).exists():
        known = ", ".join((*POLICIES, *shipped_names(settings.task)))
        raise FileNotFoundError(f"a policy must be one of {known}, or a run folder or model file, got {name!r}")
    if (Path(name) / WEIGHTS).is_file():
        return Baseline(_read(Path(name)), {})
    file = model_in(Path(name))
    folder = run_folder(file)
    return Baseline(_trained(file, folder) if folder else _trusted(file, settings, trust, options or Options()), {})


def _trained(file: Path, folder: Path) -> Policy:
    """The policy in a model file of a run folder, with the folder's settings; nothing is unpickled.

    Raises:
        ValueError: the file is damaged, or no model of these settings.
    """
    settings = read_settings(folder)
    with as_value_error(f"{file} is no model of the settings beside it"):
        return NetworkPolicy(settings, layers_of(read_parameters(file)["policy"]))


def _trusted(file: Path, settings: EnvSettings, trust: bool, options: Options) -> Policy:
    """The policy in a model file without a run folder, by the settings that it stores, by env.json or ``options``.

    Raises:
        FileNotFoundError: ``trust`` is off.
        ValueError: the file is damaged, or does not fit.
    """
    if not trust:
        raise FileNotFoundError(
            f"{file} has no {SETTINGS} beside it to rebuild the model from; if you trust its author, use --trust"
        )
    model = load(file)
    trained_by = getattr(model, TRAINED_BY, None)
    if trained_by is None or options != Options():
        return policy_of(file, model, settings, options)
    with as_value_error(f"{file} is no model of the settings that it stores"):
        return NetworkPolicy(TrainSettings.of(trained_by), layers_of(model.get_parameters()["policy"]))


def _read(folder: Path) -> Policy:
    return read_landing(folder) if (folder / LANDING).is_file() else read_policy(folder)


def shipped_names(task: str) -> list[str]:
    """Names of the trained policies for a task that come with the repository."""
    folders = [path for path in SHIPPED.glob(f"{task}-*") if not (path / VALUE).is_file()]
    return sorted(path.name.removeprefix(f"{task}-") for path in folders)
