"""Model files of Stable-Baselines3, read without unpickling, and sizes that fit into memory."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from jackbox_env.tools import checks as check
from jackbox_env.tools.reading import DamagedFileError, parsing, report_skipped, unpacked

BEST, MODEL = "best_model.zip", "model.zip"  # in a run folder
Parameters = dict[str, Any]
_GROUPS = ("policy", "policy.optimizer")  # of parameters
_FEATURES = 512  # of a picture, that Stable-Baselines3's convolutions pass on to the layers
# Beyond these an untrusted model could fill all memory.
MOST_ROLLOUT_SAMPLES = 5_000_000  # between updates
MOST_ROLLOUT_NUMBERS = 10**10  # observed between updates; bytes of pictures
MOST_LAYERS = 32
MOST_WEIGHTS = 20_000_000  # of one network; there are two


def model_in(path: Path) -> Path:
    """The best model of a run folder, else its last; or ``path`` itself if it is a model file, also without ``.zip``.

    A damaged best model is skipped, with a note on standard error.

    Raises:
        FileNotFoundError: there is no model.
        ValueError: the file is that of an exported policy.
    """
    file = path if path.suffix or path.exists() else path.with_suffix(".zip")
    if path.is_dir():
        file = path / BEST if is_whole(path / BEST) else path / MODEL
    if not file.is_file():
        raise FileNotFoundError(f"there is no model file {file}")
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


def check_sizes(num_envs: int, rollout_steps: int, shape: Sequence[int], hidden_units: Sequence[int]) -> None:
    """Raise ValueError for a training beyond any memory, before allocating.

    Args:
        num_envs: environments side by side.
        rollout_steps: of each between updates.
        shape: of an observation; of a picture three numbers.
        hidden_units: width of each hidden layer.
    """
    samples, seen = num_envs * rollout_steps, math.prod(shape)
    if samples > MOST_ROLLOUT_SAMPLES:
        raise ValueError(f"num_envs * rollout_steps must be at most {MOST_ROLLOUT_SAMPLES:,}, got {samples:,}")
    if samples * seen > MOST_ROLLOUT_NUMBERS:
        raise ValueError(
            f"num_envs * rollout_steps observations must have at most {MOST_ROLLOUT_NUMBERS:,} numbers, got "
            f"{samples * seen:,}"
        )
    if len(hidden_units) > MOST_LAYERS:
        raise ValueError(f"hidden_units must be at most {MOST_LAYERS} layers, got {len(hidden_units):,}")
    inputs = _FEATURES if len(shape) > 1 else seen
    weights = sum(before * after for before, after in pairwise((inputs, *hidden_units, 1)))
    if weights > MOST_WEIGHTS:
        raise ValueError(
            f"hidden_units must make a network of at most {MOST_WEIGHTS:,} weights, got {check.shown(hidden_units)}"
        )
