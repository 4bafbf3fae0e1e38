"""Run folders: the settings and the results of a training. A folder is never used for another run.

Training writes these files; evaluation, export and resuming read them.

settings.json            resolved settings, from which a model is rebuilt
code.json                texts of the user's files whose objects the settings name, by path, if there are any
env.json                 what jackbox_env.sb3.load_model needs: the environment and PPO's arguments
run.json                 command line, seed, versions, date
checkpoints/ppo_N.zip    weights and optimiser after N steps
best_model.zip           the best by the separate evaluation, and its mean return
model.zip                the last
evaluations.npz          the separate evaluations
time.json                steps and seconds of the process that finished the run
tensorboard/             curves
lock                     a system lock on it (filelock) ends with the process that uses the folder, however that ends
"""

from __future__ import annotations

import dataclasses
import datetime
import json
import os
import platform
import subprocess
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from importlib import metadata
from pathlib import Path

from agents.settings import TrainSettings
from jackbox_env.tools.files import write_json
from jackbox_env.tools.reading import read_bounded
from jackbox_env.tools.user_code import CODE, load_trusted, texts_of

SETTINGS, RUN, EVALUATIONS, TIME = "settings.json", "run.json", "evaluations.npz", "time.json"
LOCK = "lock"
_LARGEST_SETTINGS = 1_000_000  # [bytes]
PACKAGES = ("jackbox", "gymnasium", "numpy", "pymunk", "stable-baselines3", "torch")


class FolderInUseError(RuntimeError):
    """Another process uses the folder."""


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder against every other process, and against a second use within this one.

    Raises:
        FolderInUseError: another process has locked it.
        OSError: its lock is a link, or cannot be opened.
    """
    from filelock import FileLock, Timeout  # of the extra train, which shipped networks do not need

    lock = FileLock(folder / LOCK, timeout=0)
    try:
        lock.acquire()
    except Timeout as error:
        raise FolderInUseError(f"{folder} is in use by another process: wait until it ends, or end it") from error
    try:
        yield
    finally:
        lock.release()


def installed(packages: Iterable[str]) -> dict[str, str]:
    """Versions of Python and of these packages."""
    numbers = {"python": platform.python_version()}
    for package in packages:
        try:
            numbers[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            numbers[package] = "not installed"
    return numbers


def versions(packages: Iterable[str] = PACKAGES) -> dict[str, str]:
    """Versions of Python, of these packages, and the commit of the checkout if there is one."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty"]
    described = subprocess.run(command, capture_output=True, text=True, check=False)
    return {**installed(packages), "commit": described.stdout.strip() or "unknown"}


@cache
def machine() -> str:
    """Processor, cores and system in one line."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        lines = cpuinfo.read_text(encoding="utf-8").splitlines()
        names = [line.split(":", 1)[1].strip() for line in lines if "model name" in line]
        model = names[0] if names else model
    return f"{model}, {os.cpu_count()} cores, {platform.system()}"


def describe(folder: Path, settings: TrainSettings) -> None:
    """Write run.json and settings.json into a new run folder."""
    started = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    record = {"command": sys.argv, "seed": settings.seed, "started": started, "machine": machine()}
    write_json(folder / RUN, {**record, "versions": versions()})
    if settings.objects:
        write_json(folder / CODE, texts_of(settings.objects.values()))
    write_json(folder / SETTINGS, dataclasses.asdict(settings))  # last: a folder with settings is a run folder


def read_settings(folder: Path) -> TrainSettings:
    """Read the settings of a run.

    Raises:
        FileNotFoundError: it is no run folder.
        ValueError: the file is no settings file, or a setting is unknown or out of range.
    """
    path = folder / SETTINGS
    try:
        return TrainSettings.of(json.loads(read_bounded(path, _LARGEST_SETTINGS)))
    except (RecursionError, TypeError, ValueError) as error:
        raise ValueError(f"{path} has no settings of a run: {error}") from error


def trusted_settings(folder: Path, trust: bool) -> TrainSettings:
    """Read the settings of a run, and load the objects that they name.

    Args:
        folder: of the run, or of an exported policy.
        trust: run the code of these objects, with the texts that the folder has.

    Raises:
        FileNotFoundError, ValueError: as :func:`read_settings`; or code would run that is neither trusted nor loaded,
            or cannot.
    """
    settings = read_settings(folder)
    load_trusted(folder, settings.objects.values(), trust)
    return settings


# -- models ------------------------------------------------------------------------------------------------------------


def run_folder(file: Path) -> Path | None:
    """The run folder of a model file, or ``file`` itself if it is one; None if there is none."""
    return next((folder for folder in (file, *file.parents[:2]) if (folder / SETTINGS).is_file()), None)
