"""Trainings that are killed: processes that run scripts/train.py, forked from one that has imported torch already."""

from __future__ import annotations

import json
import multiprocessing
import os
import resource
import signal
import sys
import zipfile
from collections.abc import Callable
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest
import torch._dynamo  # noqa: F401  # Adam does so at its first use, which takes seconds
from stable_baselines3.common.vec_env import VecEnv

from agents.runs import EVALUATIONS
from agents.settings import TrainSettings
from agents.training import best
from agents.training import ppo as training
from agents.training.best import read_evaluations
from agents.training.checkpoints import Checkpoint, checkpoint_path, steps_of_checkpoints
from agents.training.models import make_vec_env
from jackbox_env.tools.model_files import BEST, MODEL, read_parameters
from jackbox_env.tools.reading import read_json
from scripts import train as command

# Six rollouts, three evaluations, three checkpoints, the first for an evaluation: a fraction of a second.
SIZES: dict[str, Any] = {
    "total_steps": 96, "num_envs": 2, "rollout_steps": 8, "batch_size": 16, "epochs": 1, "checkpoint_steps": 24,
    "eval_steps": 32, "eval_episodes": 2,
}  # fmt: skip
SMALL = TrainSettings(**SIZES, hidden_units=(8,))
KILLS = int(os.environ.get("JACKBOX_KILLS", "3"))
# Operations that change a disk, or decide what is on it, where our code does them itself or by pathlib.
_WRITES = {"open", "write", "close", "fsync", "replace", "rename", "unlink", "mkdir", "flock"}
_OURS = (f"{os.sep}agents{os.sep}", f"{os.sep}tools{os.sep}files.py", f"{os.sep}pathlib")


def short_episodes(env_settings: dict[str, Any], num_envs: int, seed: int) -> VecEnv:
    """Replaces ``make_vec_env`` with short episodes, so that evaluations are fast."""
    return make_vec_env({**env_settings, "max_episode_steps": 20}, num_envs, seed)


def train(folder: Path, output: Path, kill_at: int | None = None, file_size: int | None = None) -> None:
    """Run the command line in a forked process, with its output in ``output``.

    Args:
        run folder to make or to resume.
        output: what the command line says.
        kill_at: number of the operation on the disk before which the process kills itself; without it ``output`` has
            how many there were.
        file_size: no file may become larger, as if the disk were full [bytes].
    """
    log = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(log, 1)
    os.dup2(log, 2)
    setattr(best, "make_vec_env", short_episodes)  # as monkeypatch does  # noqa: B010
    asked = ["--resume", str(folder)] if folder.exists() else ["--folder", str(folder), "--hidden-units", "8"]
    sizes = [] if folder.exists() else [f"--{name.replace('_', '-')}={value}" for name, value in SIZES.items()]
    sys.argv = ["train.py", *asked, *sizes, "--no-progress"]
    if file_size is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (file_size, file_size))
    count = 0

    def watch(frame: FrameType, event: str, called: Any) -> None:
        """Count operations on the disk, and kill the process just before one of them."""
        nonlocal count
        if event != "c_call" or called.__name__ not in _WRITES or isinstance(called.__self__, str | set):
            return
        if not any(part in frame.f_code.co_filename for part in _OURS):
            return
        if called.__name__ == "open" and "r" in str(frame.f_locals.get("mode")):
            return
        count += 1
        if count == kill_at:
            os.kill(os.getpid(), signal.SIGKILL)

    sys.setprofile(watch)
    command.main()
    sys.setprofile(None)
    print(f"{count} operations")


def start(target: Callable[..., None], *arguments: Any) -> ForkServerProcess:
    """Start a function in a process forked from one that has imported everything."""
    server = multiprocessing.get_context("forkserver")
    server.set_forkserver_preload([__name__])
    process = server.Process(target=target, args=arguments)
    process.start()
    return process


def ended(process: ForkServerProcess) -> int | None:
    """Wait for a process and return its exit status; -9 if it was killed."""
    process.join(120)
    status = process.exitcode
    process.close()
    return status


def expected_steps(settings: TrainSettings) -> list[int]:
    """Steps of the evaluations of an uninterrupted run."""
    return list(range(settings.eval_steps, settings.total_steps + 1, settings.eval_steps))


def stop_after(steps: int, settings: TrainSettings, folder: Path) -> None:
    """Train in a described folder, and interrupt the training after so many steps."""

    class Interrupt(Checkpoint):
        def _on_step(self) -> bool:
            if self.num_timesteps > steps:
                raise KeyboardInterrupt
            return True

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "Checkpoint", Interrupt)
        with pytest.raises(KeyboardInterrupt):
            training.train(settings, folder, progress=False)


def check_whole(folder: Path) -> None:
    """Assert that the files of a killed training are complete and belong together."""
    assert read_json(folder / "run.json")["seed"] == SMALL.seed
    assert TrainSettings(**{**read_json(folder / "settings.json"), "hidden_units": SMALL.hidden_units}) == SMALL
    for steps in steps_of_checkpoints(folder):
        read_parameters(checkpoint_path(folder, steps))
    if (folder / EVALUATIONS).exists():
        evaluations = read_evaluations(folder, SMALL.eval_episodes)
        assert evaluations.timesteps == expected_steps(SMALL)[: len(evaluations.timesteps)] != []
        read_parameters(folder / BEST)


def check_finished(folder: Path) -> None:
    """Assert that a run that was killed and resumed ends like an uninterrupted one."""
    check_whole(folder)
    read_parameters(folder / MODEL)
    with zipfile.ZipFile(folder / MODEL) as archive:
        assert json.loads(archive.read("data"))["num_timesteps"] == SMALL.total_steps
    evaluations = read_evaluations(folder, SMALL.eval_episodes)
    assert evaluations.timesteps == expected_steps(SMALL)  # none twice, none missing
    steps = evaluations.timesteps[int(np.argmax(np.mean(evaluations.results, axis=1)))]
    rollout = SMALL.num_envs * SMALL.rollout_steps
    evaluated = read_parameters(checkpoint_path(folder, (steps - 1) // rollout * rollout))["policy"]
    best = read_parameters(folder / BEST)["policy"]
    assert all(bool((best[name] == value).all()) for name, value in evaluated.items())
    assert not list(folder.rglob("*.partial*"))
