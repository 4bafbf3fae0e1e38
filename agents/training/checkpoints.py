"""Model files of a run: written in one stroke, read whole or not at all, and the checkpoints among them."""

from __future__ import annotations

import copy
import io
import re
import zipfile
from pathlib import Path
from typing import Any, NamedTuple

from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.save_util import load_from_zip_file

from agents.files import DamagedFileError, parsing, say_skipped
from agents.training.archives import unpacked_tensors
from jackbox_env.recording.files import make_folder, write_bytes

CHECKPOINTS = "checkpoints"
_GROUPS = {"policy", "policy.optimizer"}  # of parameters

Parameters = dict[str, Any]


class Saved(NamedTuple):
    """What a checkpoint holds: the parameters after so many steps."""

    steps: int
    path: Path
    parameters: Parameters


# -- model files ------------------------------------------------------------------------------------------------------


def model_file(model: PPO) -> bytes:
    """What Stable-Baselines3 keeps of a model, as a file in memory."""
    file = io.BytesIO()
    model.save(file)
    return file.getvalue()


def read_model_file(path: Path) -> Parameters:
    """The parameters in a model file, every byte of it checked.

    Raises:
        DamagedFileError: it is no whole model file.
        FileNotFoundError: it is not there.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path} is no file")
    with parsing(path):
        tensors = unpacked_tensors(path)  # refuses what inflates to many times its size, before it is inflated
        with zipfile.ZipFile(path) as archive:
            if (broken := archive.testzip()) is not None:
                raise ValueError(f"{broken} in it is not what was written")
        _, parameters, _ = load_from_zip_file(tensors, load_data=False, device="cpu")
        if set(parameters) != _GROUPS:
            raise ValueError("it holds no parameters")
    return parameters


def is_whole(path: Path) -> bool:
    """Whether there is a model file with nothing missing."""
    try:
        read_model_file(path)
    except (FileNotFoundError, DamagedFileError):
        return False
    return True


# -- checkpoints ------------------------------------------------------------------------------------------------------


def checkpoint_path(folder: Path, steps: int) -> Path:
    """Where a run keeps what it had after so many steps."""
    return folder / CHECKPOINTS / f"ppo_{steps}.zip"


def kept_steps(folder: Path) -> list[int]:
    """The steps after which a run has checkpoints, the latest first, damaged ones included."""
    matches = (re.fullmatch(r"ppo_(0|[1-9]\d*)\.zip", path.name) for path in (folder / CHECKPOINTS).glob("ppo_*.zip"))
    return sorted((int(match[1]) for match in matches if match), reverse=True)


def latest_checkpoint(folder: Path) -> Saved | None:
    """The newest whole checkpoint of a run; says which damaged ones were skipped."""
    for steps in kept_steps(folder):
        path = checkpoint_path(folder, steps)
        try:
            return Saved(steps, path, read_model_file(path))
        except DamagedFileError as error:
            say_skipped(error)
    return None


class Checkpoint(BaseCallback):
    """Keep weights and optimiser as of the start of a rollout, when the last one has been learnt from."""

    def __init__(self, folder: Path, every: int) -> None:
        super().__init__()
        self._folder, self._every = folder, every
        self._last = 0
        self._start: tuple[int, Parameters] = (0, {})

    def _init_callback(self) -> None:
        make_folder(self._folder / CHECKPOINTS)
        self._last = self.model.num_timesteps
        self._start = (self._last, {})

    def _on_rollout_start(self) -> None:
        assert isinstance(self.model, PPO)
        # a copy: an update may be cut short later
        self._start = (self.num_timesteps, copy.deepcopy(self.model.get_parameters()))
        if self.num_timesteps - self._last >= self._every:
            self.keep()

    def keep(self) -> None:
        """Save as of the start of this rollout, unless that is saved already."""
        steps, parameters = self._start
        if steps > self._last:
            assert isinstance(self.model, PPO)
            self.model.set_parameters(parameters, device="cpu")
            write_bytes(checkpoint_path(self._folder, steps), model_file(self.model))
            self._last = steps

    def _on_step(self) -> bool:
        return True
