"""Run folders: the settings and the results of a training. A folder is never used for another run.

Training writes these files; evaluation, export and resuming read them.

settings.json            resolved settings, from which a model is rebuilt
code.json                texts of the user's files whose objects the settings name, by path, if there are any
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
import io
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
from typing import Any

from agents.settings import TrainSettings
from jackbox_env.tools import checks as check
from jackbox_env.tools.files import write_json
from jackbox_env.tools.reading import (
    DamagedFileError,
    as_value_error,
    parsing,
    read_bounded,
    read_json,
    report_skipped,
    unpacked,
)
from jackbox_env.tools.user_code import is_loaded, load, texts_of

SETTINGS, RUN, EVALUATIONS, TIME = "settings.json", "run.json", "evaluations.npz", "time.json"
CODE, LOCK = "code.json", "lock"
BEST, MODEL = "best_model.zip", "model.zip"
TRAINED_BY = "trained_by"  # attribute of a saved model: its settings
_GROUPS = ("policy", "policy.optimizer")  # of parameters
Parameters = dict[str, Any]
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
    names = list(settings.objects.values())
    if not (trust or all(map(is_loaded, names))):
        raise ValueError(f"{folder} runs code ({check.shown(names[0])}): if you trust its author, use --trust")
    texts = read_json(folder / CODE) if names and (folder / CODE).is_file() else {}
    with as_value_error(f"{folder} cannot be used"):
        load(names, {str(path): str(text) for path, text in dict(texts).items()})
    return settings


# -- models ------------------------------------------------------------------------------------------------------------


def run_folder(file: Path) -> Path | None:
    """The run folder of a model file, or ``file`` itself if it is one; None if there is none."""
    return next((folder for folder in (file, *file.parents[:2]) if (folder / SETTINGS).is_file()), None)


def model_in(path: Path) -> Path:
    """The best model of a run folder, else its last; or ``path`` itself if it is a model file.

    A damaged best model is skipped, with a note on standard error.

    Raises:
        FileNotFoundError: there is no model.
        ValueError: the file is that of an exported policy.
    """
    file = path
    if path.is_dir():
        file = path / BEST if is_whole(path / BEST) else path / MODEL
    if not file.is_file():
        raise FileNotFoundError(f"{path} has no model: neither {BEST} nor {MODEL}")
    if file.suffix == ".npz":
        raise ValueError(f"{file} has only weights: pass its folder, {file.parent}")
    return file


def read_parameters(path: Path) -> Parameters:
    """The parameters in a model file, every byte of it checked; nothing is unpickled.

    Raises:
        DamagedFileError: it is no whole model file.
        FileNotFoundError: it is not there.
    """
    import torch  # shipped networks do without

    content = path.read_bytes()
    with parsing(path):
        members, parameters = unpacked(content, path.name), {}
        for group in _GROUPS:
            tensors = members[f"{group}.pth"]
            unpacked(tensors, f"{group}.pth in {path.name}")  # raises if torch would inflate it to many times its size
            parameters[group] = torch.load(io.BytesIO(tensors), map_location="cpu", weights_only=True)
    return parameters


def read_if_whole(path: Path) -> Parameters | None:
    """The parameters in a model file; None if it is missing or damaged; damage is reported on standard error."""
    try:
        return read_parameters(path)
    except FileNotFoundError:
        return None
    except DamagedFileError as error:
        report_skipped(error)
        return None


def is_whole(path: Path) -> bool:
    """Whether there is an intact model file; damage is reported on standard error."""
    return read_if_whole(path) is not None
