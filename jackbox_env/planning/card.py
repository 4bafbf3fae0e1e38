"""Rollouts on a GPU, which ``rollouts.py`` calls for ``device="cuda"``. PyTorch is imported then, not before."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from jackbox_env.exact.step import CONSTANT
from jackbox_env.exact.workspace import Status
from jackbox_env.gpu.ptx import ptx_of, ptx_with
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import Array, Counts
from jackbox_env.model.tasks import TASKS, Task
from jackbox_env.simulators.exact import drive_kind
from jackbox_env.simulators.users_functions import users_functions
from jackbox_env.tools import checks as check

_codes: WeakKeyDictionary[Task, str] = WeakKeyDictionary()  # PTX with the rewards of users' tasks


def checked(device: str | None) -> str | None:
    """The name of a device, or None.

    Raises:
        ValueError: it is neither "cuda" nor None.
        RuntimeError: ``JACKBOX_UNTRIED_GPU`` is not 1.
    """
    if device is None:
        return None
    check.choice("device", device, ("cuda",))
    if os.environ.get("JACKBOX_UNTRIED_GPU") != "1":
        raise RuntimeError(
            'device="cuda" has not run on a GPU yet, only its code has been checked; JACKBOX_UNTRIED_GPU=1 allows it'
        )
    return device


def tensors(*arrays: Any) -> Sequence[Any]:
    """The arrays as tensors on the GPU if one of them is a tensor of any library with DLPack; else none.

    Raises:
        ImportError: there is no PyTorch.
    """
    with check.extra('device="cuda"', "PyTorch", "gpu"):
        from jackbox_env.gpu import device
    if all(isinstance(one, np.ndarray) or not hasattr(one, "__dlpack__") for one in arrays):
        return ()
    shared = [one if hasattr(one, "__dlpack__") else np.asarray(one, np.float64) for one in arrays]
    return [device.tensor(one) for one in shared]


def played(
    scenes: list[Scene], starts: Array, torques: Array, dt: float, options: Any, left_rows: Callable[[Counts], Any]
) -> tuple[Any, ...]:
    """The fields of a ``Rollout`` that a GPU plays.

    Args:
        scenes: one for all rows, or one for each.
        starts: shape (N, 12).
        torques: [N m], shape (N, H / repeat).
        dt: duration of a step [s].
        options: a ``RolloutOptions``.
        left_rows: returns the ``Rollout`` of rows by the CPU, for those that the GPU does not play to their end.
    """
    import torch

    from jackbox_env.gpu import device

    count, task = len(torques), options.task
    kinds = np.array([drive_kind(one.drive if options.side_forces else None, True) for one in scenes])
    ended = np.broadcast_to(np.where(kinds == CONSTANT, Status.DONE, Status.UNCOMPILED), count)
    first, held = options.tensors or map(device.tensor, (starts, torques))
    first, held = first.expand(count, -1), held.expand(count, -1)
    values = device.tensor(np.array([one.numbers for one in scenes]))
    launch = device.launcher(code_of(task or TASKS["juggle"]))
    try:
        result = device.play(
            launch, values, first, held, dt, options.repeat, device.tensor(ended.copy()).long(),
            device.Wanted(options.whole, options.energy, options.impacts, task is not None),
        )  # fmt: skip
    except torch.cuda.OutOfMemoryError as error:
        steps = held.shape[1] * options.repeat
        raise MemoryError(f"the GPU has too little memory for {count} rows of {steps} steps: play fewer") from error
    wanted = [
        result.trajectories if options.whole else torch.stack([first, result.last], dim=1),
        result.energies if options.energy else None, result.hits if options.impacts else None,
        result.impulses if options.impacts else None,
        *((result.rewards, result.lengths) if task else (None, None)),
    ]  # fmt: skip
    left = result.ended.cpu().numpy().nonzero()[0]
    for field, made in zip(wanted, left_rows(left) if left.size else (), strict=False):
        if field is not None:
            field[left] = device.tensor(made).to(field.dtype)
    if not options.tensors:
        wanted = [None if one is None else np.ascontiguousarray(one.cpu().numpy()) for one in wanted]
    return *wanted, left.size


def code_of(task: Task) -> str:
    """The kernel with a task's rewards.

    Raises:
        TypeError: the task needs more than arithmetic.
    """
    for name, known in TASKS.items():
        if task is known:
            return ptx_of(name)
    if task not in _codes:
        _codes[task] = ptx_with(users_functions(task))
    return _codes[task]
