"""Writing a run's checkpoints and model files, each atomically. :mod:`agents.runs` reads them."""

from __future__ import annotations

import io
import re
from pathlib import Path

from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from jackbox_env.tools.files import write_bytes
from jackbox_env.tools.model_files import Parameters, read_if_whole

CHECKPOINTS = "checkpoints"


def model_file(model: PPO) -> bytes:
    """The bytes of the file that Stable-Baselines3 saves of a model."""
    file = io.BytesIO()
    model.save(file)
    return file.getvalue()


def checkpoint_path(folder: Path, steps: int) -> Path:
    """Path of a run's checkpoint after so many steps."""
    return folder / CHECKPOINTS / f"ppo_{steps}.zip"


def steps_of_checkpoints(folder: Path) -> list[int]:
    """Numbers of steps after which a run has checkpoints, the latest first, damaged ones included."""
    matches = (re.fullmatch(r"ppo_(0|[1-9]\d*)\.zip", path.name) for path in (folder / CHECKPOINTS).glob("ppo_*.zip"))
    return sorted((int(match[1]) for match in matches if match), reverse=True)


def latest_checkpoint(folder: Path) -> tuple[int, Parameters | None]:
    """The newest whole checkpoint of a run, its steps and parameters; 0 and None if there is none."""
    read = ((steps, read_if_whole(checkpoint_path(folder, steps))) for steps in steps_of_checkpoints(folder))
    return next(((steps, parameters) for steps, parameters in read if parameters is not None), (0, None))


class Checkpoint(BaseCallback):
    """Save weights and optimiser as of the start of a rollout, after the update on the one before."""

    def __init__(self, folder: Path, every: int) -> None:
        super().__init__()
        self._folder, self._every = folder, every
        self._last = self._steps = 0
        self._content = b""

    def _init_callback(self) -> None:
        (self._folder / CHECKPOINTS).mkdir(parents=True, exist_ok=True)
        self._last = self._steps = self.model.num_timesteps

    def _on_rollout_start(self) -> None:
        assert isinstance(self.model, PPO)
        # now: an update may be cut short later
        self._steps, self._content = self.num_timesteps, model_file(self.model)
        if self._steps - self._last >= self._every:
            self.save()

    def save(self) -> None:
        """Save as of the start of this rollout, unless that is saved already."""
        if self._steps > self._last:
            write_bytes(checkpoint_path(self._folder, self._steps), self._content)
            self._last = self._steps

    def _on_step(self) -> bool:
        return True
