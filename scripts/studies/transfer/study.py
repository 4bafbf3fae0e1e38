"""What a contact model does to a learner: the same PPO trained on each named fidelity, every policy run on all of them.

A study is a folder that holds a run folder for each task, fidelity and seed; :func:`train_all` fills what is missing,
:func:`run_all` runs what is finished. Either can be interrupted and continued.

study.json                      settings of the study, and what the fidelities stood for
study_run.json                  command line, versions, date
<task>-<fidelity>-<seed>/       a run of training each, see :mod:`agents.runs`
cells/<task>-<policy>-on-<fidelity>.json   returns of a policy, one per episode
longrun/<torque>-<setting>.npz  long-run statistics, one number per episode
"""

from __future__ import annotations

import dataclasses
import datetime
import json
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from agents.evaluation.returns import evaluate
from agents.files import DamagedFileError, held, read_json, say_skipped
from agents.policies.scripted import Policy, baseline
from agents.runs import SETTINGS, describe, read_settings, versions
from agents.settings import TaskName, TrainSettings
from agents.sweeps.in_process import InThreads, InTurn, Runner, Trial
from agents.training.best import BEST
from agents.training.checkpoints import is_whole, kept_steps
from agents.training.models import load_model
from agents.training.ppo import MODEL, trained_in
from jackbox_env import FIDELITIES, Scene
from jackbox_env import _validation as check
from jackbox_env.recording.files import make_folder, new_folder, write_json
from scripts.studies.transfer.longrun import Episodes, run_long

TRAIN = Path(__file__).parents[3] / "scripts" / "train.py"
STUDY = "study.json"
_RESOLVED = "settings"  # key in it: fidelity -> [contact, substeps]
BASELINES = ("zero", "level", "chirp")  # without chance: the same policy on every fidelity
# "trained" or "baselines" -> policy -> fidelity run on -> returns, (seeds, episodes) of trained ones, else (episodes,)
Returns = dict[str, dict[str, dict[str, Any]]]
_PATIENCE = 10.0  # for an interrupted training to leave its checkpoint [s]


@dataclass(frozen=True)
class StudySettings:
    """What is trained and how often it is run."""

    tasks: tuple[TaskName, ...] = ("juggle", "rattle")
    """What is rewarded."""
    fidelities: tuple[str, ...] = tuple(FIDELITIES)
    """Trained on and run on; exact, the reference of the others, is among them."""
    seeds: int = 3
    """Trainings of each task and fidelity."""
    total_steps: tuple[int, ...] = (TrainSettings.total_steps,)
    """Environment steps of each training: one number, or one for each task."""
    episodes: int = 128
    """Episodes of each policy on each fidelity, from the same starts everywhere."""
    long_episodes: int = 1024
    """Episodes of the long-run statistics, for each contact setting and each kind of torque."""
    restitution: float = 1.0
    """Of the scene in which everything is trained and run; below 1 with loss."""

    def __post_init__(self) -> None:
        """Refuse a study that cannot be made, by a TypeError or ValueError."""
        check.whole("seeds", self.seeds, at_least=1, at_most=1000)
        for steps in self.total_steps:
            check.whole("total_steps", steps, at_least=1)
        if len(self.total_steps) not in (1, len(self.tasks)):
            raise ValueError(f"total_steps must be one number or {len(self.tasks)}, got {self.total_steps}")
        check.whole("episodes", self.episodes, at_least=2)
        check.whole("long_episodes", self.long_episodes, at_least=4)
        check.real("restitution", self.restitution, at_least=0.0, at_most=1.0)
        for name in self.fidelities:
            check.choice("fidelities", name, FIDELITIES)
        if "exact" not in self.fidelities:
            raise ValueError(f"fidelities must hold 'exact', the reference of the others, got {self.fidelities}")
        for name, chosen in (("tasks", self.tasks), ("fidelities", self.fidelities)):
            if len(set(chosen)) != len(chosen) or not chosen:
                raise ValueError(f"{name} must be different ones, at least one, got {chosen}")
        for task in self.tasks:
            self.run_settings(task, self.fidelities[0], 0)

    @property
    def scene_fields(self) -> dict[str, float]:
        """What the scene has different from the default."""
        return {} if self.restitution == 1.0 else {"restitution": self.restitution}

    @property
    def scene(self) -> Scene:
        """The scene of the study."""
        return Scene(restitution=self.restitution)

    def steps_of(self, task: str) -> int:
        """Environment steps of each training on a task."""
        return dict(zip(self.tasks, self.total_steps * len(self.tasks), strict=False))[task]

    def run_settings(self, task: Any, fidelity: str, seed: int) -> TrainSettings:
        """Settings of one training: the defaults, except for what the study varies."""
        steps = self.steps_of(task)
        every = min(TrainSettings.eval_steps, steps)  # a short training is evaluated too
        return TrainSettings(
            task=task, fidelity=fidelity, scene=json.dumps(self.scene_fields), seed=seed, total_steps=steps,
            eval_steps=every, checkpoint_steps=min(TrainSettings.checkpoint_steps, every),
        )  # fmt: skip

    def runs(self) -> list[tuple[str, str, int]]:
        """Task, fidelity and seed of every run. Seeds are outermost, so an interrupted study has complete seeds."""
        return [(task, name, seed) for seed in range(self.seeds) for task in self.tasks for name in self.fidelities]


def new_study(path: Path | None, settings: StudySettings) -> Path:
    """Make the folder of a study; None: ``runs/transfer-<date>-<time>``.

    Raises:
        FileExistsError: there is something at ``path`` already.
    """
    started = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")

    def describe_study(folder: Path) -> None:
        write_json(folder / "study_run.json", {"command": sys.argv, "started": started, "versions": versions()})
        write_json(folder / STUDY, {**dataclasses.asdict(settings), _RESOLVED: resolved_fidelities()})

    return new_folder(path, "transfer", describe_study)


def resolved_fidelities() -> dict[str, list[Any]]:
    """What the names stand for today, as it is kept in JSON: name -> [contact, substeps]."""
    return {name: [setting.contact, setting.substeps] for name, setting in FIDELITIES.items()}


def read_study(folder: Path) -> StudySettings:
    """Read the settings of a study.

    Raises:
        FileNotFoundError: it is no study.
        TypeError, ValueError: the settings are unknown or out of range; or the names of the fidelities stood for
            something else, so that old and new results do not belong together.
    """
    path = folder / STUDY
    if not path.is_file():
        raise FileNotFoundError(f"{folder} is no study: it has no {STUDY}")
    values = read_json(path)
    made, today = values.pop(_RESOLVED, "unknown"), resolved_fidelities()
    if made != today:
        raise ValueError(
            f"{path} was made with the fidelities {json.dumps(made)}, which are {json.dumps(today)} today, so it "
            "cannot be continued: make another study"
        )
    return settings_from(values)


def settings_from(values: dict[str, Any]) -> StudySettings:
    """Settings as they come from JSON."""
    plain: dict[str, Any] = {name: tuple(of) if isinstance(of, list) else of for name, of in values.items()}
    return StudySettings(**plain)


def run_folder(folder: Path, task: str, fidelity: str, seed: int) -> Path:
    """Where a training of a study is."""
    return folder / f"{task}-{fidelity}-{seed}"


def finished(run: Path) -> bool:
    """Whether a training came to its end, and left its models whole."""
    return is_whole(run / MODEL) and (is_whole(run / BEST) or not (run / BEST).exists())


def train_all(
    folder: Path, settings: StudySettings, processes: int = 2, progress: bool = True, runner: Runner | None = None
) -> None:
    """Train what is not finished, ``processes`` at a time, each in a process of its own, or as ``runner`` runs it.

    Raises:
        FolderInUseError: a training of an earlier, killed study still runs.
        RuntimeError: a training failed; the others under way are interrupted at a checkpoint.
        ValueError: a run in the folder was made by other settings.
    """
    planned = [(run_folder(folder, *run), settings.run_settings(*run)) for run in settings.runs()]
    for run, wanted in planned:
        if (run / SETTINGS).is_file() and read_settings(run) != wanted:
            raise ValueError(f"{run} was made by other settings than those of {folder / STUDY}")
    waiting = [(run, wanted) for run, wanted in planned if not finished(run)]
    for run, _ in waiting:
        if run.is_dir():
            with held(run):  # refused now rather than in its log
                pass
    trials = [Trial({"run": str(run.resolve()), "settings": dataclasses.asdict(wanted)}) for run, wanted in waiting]
    total, apart = sum(wanted.total_steps for _, wanted in planned), _Apart()
    side_by_side, work = (runner, train_here) if runner else (InThreads(processes), apart)
    with tqdm(total=total, unit="steps", unit_scale=True, disable=not progress, desc="training") as bar:

        def look() -> None:
            bar.update(sum(_done(run, wanted.total_steps) for run, wanted in planned) - bar.n)

        try:
            for done in side_by_side.run(trials, work, look):
                if done.error is not None:
                    raise RuntimeError(done.error)
        finally:
            apart.interrupt()


def train_here(asked: dict[str, Any]) -> None:
    """Train in this process, from the newest checkpoint in its run folder: how a machine of a cluster does it."""
    run = Path(asked["run"])
    if not run.parent.is_dir():
        raise FileNotFoundError(f"{run.parent} must be on a disk that all machines share: it is not on this one")
    trained_in(run, TrainSettings.of(asked["settings"]), progress=False)


class _Apart:
    """Trains in processes of their own, which can be interrupted at a checkpoint."""

    def __init__(self) -> None:
        self._under_way: list[subprocess.Popen[bytes]] = []
        self._lock, self._ended = threading.Lock(), False

    def __call__(self, asked: dict[str, Any]) -> None:
        """Train to the end."""
        run = Path(asked["run"])
        make_folder(run)
        if not (run / SETTINGS).is_file():
            describe(run, TrainSettings.of(asked["settings"]))
        with self._lock:
            if self._ended:
                return
            process = _start(run)
            self._under_way.append(process)
        status = process.wait()
        if not finished(run):
            raise RuntimeError(f"training in {run} ended with status {status}; {run / 'log.txt'} says why")

    def interrupt(self) -> None:
        """Interrupt what is under way, and start no other."""
        with self._lock:
            self._ended = True
        _interrupt([process for process in self._under_way if process.poll() is None])


def run_all(
    folder: Path, settings: StudySettings, task: str, progress: bool = True, runner: Runner | None = None
) -> Returns:
    """Run every policy of a task on every fidelity from the same starts, or read what was run before.

    Raises:
        RuntimeError: one of them could not be run; what others returned is kept.
    """
    trained = {name: [f"{name}-{seed}" for seed in range(settings.seeds)] for name in settings.fidelities}
    policies = [*(policy for names in trained.values() for policy in names), *BASELINES]
    trials = [Trial({"policy": policy, "on": on}) for on in settings.fidelities for policy in policies]
    found, work = dict[tuple[str, str], Any](), partial(_cell_of, folder.resolve(), settings, task)
    with tqdm(total=len(trials), unit="policies", disable=not progress, desc=f"running on {task}") as bar:
        for done in (runner or InTurn()).run(trials, work, bar.refresh):
            if done.error is not None:
                raise RuntimeError(f"{json.dumps(done.trial.settings)} could not be run: {done.error}")
            found[done.trial.settings["policy"], done.trial.settings["on"]] = np.round(done.result, 2).tolist()
            bar.update()
    return {
        "trained": {
            name: {on: [found[policy, on] for policy in names] for on in settings.fidelities}
            for name, names in trained.items()
        },
        "baselines": {name: {on: found[name, on] for on in settings.fidelities} for name in BASELINES},
    }


def _cell_of(folder: Path, settings: StudySettings, task: str, asked: dict[str, Any]) -> list[float]:
    return cell(folder, settings, task, asked["policy"], asked["on"])


def cell(folder: Path, settings: StudySettings, task: str, policy: str, fidelity: str) -> list[float]:
    """Returns of a baseline, or of ``<fidelity>-<seed>``'s best model, on a fidelity; kept in a file."""
    path = folder / "cells" / f"{task}-{policy}-on-{fidelity}.json"
    returns: list[float] | None = None
    if path.is_file():
        try:
            returns = read_json(path)
        except DamagedFileError as error:
            say_skipped(error)
    if returns is None:
        more: dict[str, Any] = {}
        actor: Policy
        if policy in BASELINES:
            actor, more = baseline(policy, settings.scene)
        else:
            actor = load_model(folder / f"{task}-{policy}" / BEST)
        env_settings = {"task": task, "fidelity": fidelity, "scene": settings.scene_fields, **more}
        returns = list(evaluate(policy, actor, env_settings, settings.episodes, seed=0).returns)
        make_folder(path.parent)
        write_json(path, returns)
    if len(returns) != settings.episodes:
        raise ValueError(f"{path} holds {len(returns)} episodes instead of {settings.episodes}")
    return returns


def run_statistics(
    folder: Path, settings: StudySettings, progress: bool = True, runner: Runner | None = None
) -> dict[str, dict[str, Episodes]]:
    """Long-run statistics, also under the first policy that was trained on exact for the first task."""
    task = settings.tasks[0]
    policies: dict[str, Policy] = {f"PPO on {task}": load_model(run_folder(folder, task, "exact", 0) / BEST)}
    return run_long(folder / "longrun", policies, settings.long_episodes, progress, settings.scene, runner)


def _start(run: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, str(TRAIN), "--resume", str(run), "--no-progress"]
    with (run / "log.txt").open("ab") as log:
        # in a session of its own: Ctrl-C reaches it once, from here
        return subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True, preexec_fn=_heed_interrupts)


def _interrupt(processes: list[subprocess.Popen[bytes]]) -> None:
    """Let trainings write a checkpoint and end. One that is just starting may miss an interrupt and gets another."""
    while processes:
        for process in processes:
            process.send_signal(signal.SIGINT)
        deadline = time.monotonic() + _PATIENCE
        while time.monotonic() < deadline and any(process.poll() is None for process in processes):
            threading.Event().wait(0.05)
        processes = [process for process in processes if process.poll() is None]


def _heed_interrupts() -> None:
    """Heed interrupts in a new process. A shell makes background commands and their children ignore them."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _done(run: Path, total_steps: int) -> int:
    if (run / MODEL).is_file():
        return total_steps
    return min(max(kept_steps(run), default=0), total_steps)
