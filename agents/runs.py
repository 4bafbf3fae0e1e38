"""Run folders: one folder holds everything a run was made from and made. A folder is never used for another run.

settings.json            resolved settings, from which a model is rebuilt
run.json                 command line, seed, versions, date
checkpoints/ppo_N.zip    weights and optimiser after N steps
best_model.zip           the best by the separate evaluation, and its mean return
model.zip                the last
evaluations.npz          the separate evaluations
time.json                how long the process that finished the run took for its steps, and for what
tensorboard/             curves
lock                     held by the process that works here
"""

from __future__ import annotations

import dataclasses
import datetime
import json
import os
import platform
import subprocess
import sys
from collections.abc import Iterable
from functools import cache
from importlib import metadata
from pathlib import Path

from agents.files import read_bounded
from agents.settings import TrainSettings
from jackbox_env.files import write_json

SETTINGS, RUN, EVALUATIONS, TIME = "settings.json", "run.json", "evaluations.npz", "time.json"
_LARGEST_SETTINGS = 1_000_000  # [bytes]
PACKAGES = ("jackbox", "gymnasium", "numpy", "pymunk", "stable-baselines3", "torch")


def installed(packages: Iterable[str]) -> dict[str, str]:
    """Versions of Python and of these packages."""
    found = {"python": platform.python_version()}
    for package in packages:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "not installed"
    return found


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
    """Write down what the run is made from."""
    started = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    record = {"command": sys.argv, "seed": settings.seed, "started": started, "machine": machine()}
    write_json(folder / RUN, {**record, "versions": versions()})
    write_json(folder / SETTINGS, dataclasses.asdict(settings))  # last: what has settings is a run folder


def read_settings(folder: Path) -> TrainSettings:
    """Read the settings of a run.

    Raises:
        FileNotFoundError: it is no run folder.
        ValueError: the file holds no settings, or one that is unknown or out of range.
    """
    path = folder / SETTINGS
    try:
        return TrainSettings.of(json.loads(read_bounded(path, _LARGEST_SETTINGS)))
    except (RecursionError, TypeError, ValueError) as error:
        raise ValueError(f"{path} holds no settings of a run: {error}") from error
