"""What a sweep runs: policies that are evaluated, and trainings whose best model is."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import shutil
from itertools import product
from pathlib import Path
from typing import Any

from agents.evaluation.returns import Returns, evaluate
from agents.files import locked
from agents.policies.registry import find_policy
from agents.runs import read_settings
from agents.settings import EnvSettings, TrainSettings
from agents.sweeps.in_process import Trial
from agents.training.checkpoints import is_whole
from agents.training.models import load_model, make_vec_env
from agents.training.ppo import MODEL, trained_in
from jackbox_env import FIDELITIES
from jackbox_env import _validation as check
from jackbox_env.commands.common import json_object

RUNS = "runs"
_ENV = [part.name for part in dataclasses.fields(EnvSettings)]


def grid_trials(
    *,
    policy: tuple[str, ...],
    train: str | None,
    task: tuple[str, ...],
    setting: tuple[str, ...],
    scene: tuple[str, ...],
    seeds: int,
    episodes: int,
) -> list[Trial]:
    """The trials of a grid, as ``scripts/sweep.py`` names its sides: of policies, or with ``train`` of trainings.

    Raises:
        FileNotFoundError: there is no such policy.
        TypeError, ValueError: one of the sides is unknown or out of its range.
    """
    check.whole("seeds", seeds, at_least=1, at_most=2**32)
    check.whole("episodes", episodes, at_least=2)
    grid = environments(task, setting, scene)
    if train is None:
        return policy_trials(policy, grid, seeds, episodes)
    return training_trials(json_object("train", train), grid, seeds, episodes)


def run_trial(folder: Path, settings: dict[str, Any]) -> dict[str, Any]:
    """What a trial's row holds beside its settings; a training has its run folder below ``folder``, the sweep's."""
    return evaluated(settings) if "policy" in settings else trained(folder, settings)


def check_trial(settings: dict[str, Any]) -> None:
    """Raise KeyError, TypeError or ValueError for settings that :func:`run_trial` cannot run."""
    own = {name: value for name, value in settings.items() if name != "episodes"}
    check.whole("episodes", settings["episodes"], at_least=2)
    if "policy" in own:
        EnvSettings.of({name: value for name, value in own.items() if name not in ("policy", "seed")})
    else:
        TrainSettings.of(own)


def environments(tasks: tuple[str, ...], settings: tuple[str, ...], scenes: tuple[str, ...]) -> list[EnvSettings]:
    """The grid of tasks, settings and scenes; each environment is made once, so what cannot be made is refused.

    Args:
        tasks: names.
        settings: names of fidelities, or fields of :class:`EnvSettings` as JSON.
        scenes: fields of the scene, as JSON.

    Raises:
        TypeError, ValueError: one of them is unknown or out of its range.
    """
    made = []
    for task, setting, scene in product(tasks, settings, scenes):
        named = {"fidelity": setting} if setting in FIDELITIES else json_object("setting", setting)
        check.known_keys("setting", named, [name for name in _ENV if name not in ("task", "scene")])
        given = EnvSettings(task=task, scene=json.dumps(json_object("scene", scene), sort_keys=True), **named)
        environments = make_vec_env(given.env_settings, 1, 0)
        environments.reset()  # whatever has to be compiled is compiled once and now, before any bar
        environments.close()
        made.append(given)
    return made


def policy_trials(policies: tuple[str, ...], grid: list[EnvSettings], seeds: int, episodes: int) -> list[Trial]:
    """A trial for each policy, environment and seed; a policy that cannot be found is refused.

    Raises:
        FileNotFoundError: there is no such policy.
    """
    names = {name: str(Path(name).resolve()) if Path(name).exists() else name for name in policies}
    for name, given in product(names.values(), grid):
        find_policy(name, given, 0)
    return [
        Trial({"policy": name, **dataclasses.asdict(given), "seed": seed, "episodes": episodes})
        for name, given, seed in product(names.values(), grid, range(seeds))
    ]


def evaluated(settings: dict[str, Any]) -> dict[str, Any]:
    """What a policy earns: the work of :func:`policy_trials`."""
    given = EnvSettings(**{name: settings[name] for name in _ENV})
    policy, more = find_policy(settings["policy"], given, settings["seed"])
    return _row(evaluate("", policy, {**given.env_settings, **more}, settings["episodes"], settings["seed"]))


def training_trials(varied: dict[str, Any], grid: list[EnvSettings], seeds: int, episodes: int) -> list[Trial]:
    """A trial for each training.

    Args:
        varied: name of a setting of training -> list of the values it takes.
        grid: environments to train in.
        seeds: of each.
        episodes: that the best model is evaluated on.

    Raises:
        TypeError, ValueError: a setting is unknown, no list, or out of its range.
    """
    own = [part.name for part in dataclasses.fields(TrainSettings) if part.name not in (*_ENV, "seed", "torch_threads")]
    check.known_keys("train", varied, own)
    for name, values in varied.items():
        if not isinstance(values, list) or not values:
            raise TypeError(f"train must have a list of values for each setting, got {check.shown(values)} for {name}")
    trials = []
    for values, given, seed in product(product(*varied.values()), grid, range(seeds)):
        named = dict(zip(varied, values, strict=True))
        settings = TrainSettings.suited(**{**dataclasses.asdict(given), **named, "seed": seed, "torch_threads": 1})
        trials.append(Trial({**dataclasses.asdict(settings), "episodes": episodes}))
    return trials


def trained(folder: Path, settings: dict[str, Any]) -> dict[str, Any]:
    """Train in a run folder below a sweep's, and evaluate the best model: the work of :func:`training_trials`.

    A run that was interrupted starts over: going on from a checkpoint would take other starts than an uninterrupted
    run, and the sweep's table would depend on who was killed when. All trainings are evaluated from the same starts.

    Raises:
        FileNotFoundError: the sweep's folder is not on this machine.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder} must be on a disk that all machines share: it is not on this one")
    own = {name: value for name, value in settings.items() if name != "episodes"}
    wanted, run = TrainSettings.of(own), folder / RUNS / Trial(settings).key
    with contextlib.redirect_stdout(io.StringIO()):  # its times, which are in its folder too
        if run.exists() and not is_whole(run / MODEL):
            with locked(run):  # by a training that was taken for lost, perhaps
                shutil.rmtree(run)
        run.parent.mkdir(exist_ok=True)
        trained_in(run, wanted, progress=False)
    assert read_settings(run) == wanted
    return _row(evaluate("", load_model(run), wanted.env_settings, settings["episodes"], 0))


def _row(found: Returns) -> dict[str, Any]:
    """Columns of the table."""
    low, high = found.interval
    return {"mean": found.mean, "interval_low": low, "interval_high": high, "worst": min(found.returns)}
