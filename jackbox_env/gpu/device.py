"""Plays rows by a kernel in memory of PyTorch: on a GPU by cuda-core, which loads PTX from memory.

It imports no other module of this package, so that it also runs where there is only PyTorch and cuda-core.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import torch

Launch = Callable[[int, int], None]  # plays rows, by the address of a call and their number
BLOCK = 64  # threads
PLACE = "cuda"  # of PyTorch's tensors


class Wanted(NamedTuple):
    """Which results a call fills in besides the last states; the others have length 0."""

    trajectories: bool = False
    energy: bool = False
    impacts: bool = False
    rewards: bool = False


class Played(NamedTuple):
    """Tensors, see ``row.CardCall``; of rows that have not ended as DONE nothing holds."""

    ended: torch.Tensor
    last: torch.Tensor
    trajectories: torch.Tensor
    energies: torch.Tensor
    hits: torch.Tensor
    impulses: torch.Tensor
    rewards: torch.Tensor
    lengths: torch.Tensor


def play(
    launch: Launch, values: torch.Tensor, states: torch.Tensor, torques: torch.Tensor, dt: float, repeat: int,
    ended: torch.Tensor, wanted: Wanted,
) -> Played:  # fmt: skip
    """Play rows whose ``ended`` is 0, on the device of the tensors.

    Args:
        launch: of :func:`launcher`.
        values: numbers of the scenes, shape (1 or N, numbers).
        states: shape (N, 12).
        torques: shape (N, H / repeat) [N m].
        dt: [s].
        repeat: steps that each torque lasts for.
        ended: int64, shape (N,); written.
        wanted: results.
    """
    count, steps = len(states), torques.shape[1] * repeat

    def new(*shape: int, kind: torch.dtype = torch.float64) -> torch.Tensor:
        """Zeros whose rows lie side by side, so that threads write to neighbouring places."""
        return torch.zeros(shape[::-1], dtype=kind, device=states.device).permute(*range(len(shape))[::-1])

    hits = new(count * wanted.impacts, steps, kind=torch.int64)
    played = Played(
        ended, new(count, 12), new(count * wanted.trajectories, steps + 1, 12), new(count * wanted.energy, steps + 1),
        hits, new(*hits.shape), new(count * wanted.rewards, steps), new(count, kind=torch.int64).fill_(steps),
    )  # fmt: skip
    words = words_of_call(ended, dt, repeat, values, states, torques, *played[1:]).to(states.device)
    launch(words.data_ptr(), count)
    return played


def words_of_call(*fields: torch.Tensor | float) -> torch.Tensor:
    """A call's fields as compiled code reads them: words of 64 bits, eight to twelve of each array."""
    words = list[int]()
    for field in fields:
        if isinstance(field, int):
            words.append(field)
        elif isinstance(field, float):
            words += struct.unpack("q", struct.pack("d", field))
        else:
            strides = [stride * field.element_size() for stride in field.stride()]
            words += [0, 0, math.prod(field.shape), field.element_size(), field.data_ptr(), *field.shape, *strides]
    return torch.tensor(words, dtype=torch.int64, device="cpu")


def require() -> None:
    """Raise ImportError without cuda-core, RuntimeError without a GPU and a driver."""
    try:
        import cuda.core  # noqa: F401
    except ImportError as error:
        sentence = 'device="cuda" needs cuda-core, the extra \'gpu\': in a checkout of jackbox, pip install -e ".[gpu]"'
        raise ImportError(sentence) from error
    if not torch.cuda.is_available():
        raise RuntimeError('device="cuda" needs a GPU of NVIDIA and a driver for CUDA 12 or newer, PyTorch finds none')


def launcher(ptx: str, block: int = BLOCK) -> Launch:
    """A function that plays rows on the present GPU by PTX, and waits for them.

    Raises:
        ImportError: there is no cuda-core.
        RuntimeError: there is no driver, or it is too old for the PTX.
    """
    require()
    return _launcher(ptx, block, torch.cuda.current_device())


@cache
def _launcher(ptx: str, block: int, number: int) -> Launch:
    from cuda.core import Device, LaunchConfig, ObjectCode, Stream, launch

    Device(number).set_current()
    try:
        kernel = ObjectCode.from_ptx(ptx.encode(), name="rollout").get_kernel("rollout")
    except Exception as error:
        raise RuntimeError(
            f'the driver cannot load the code of device="cuda", for CUDA 11.8 or newer: {error}'
        ) from error

    def played(call: int, count: int) -> None:
        if torch.cuda.current_device() != number:
            raise RuntimeError(f"the present GPU must be number {number}, got {torch.cuda.current_device()}")
        stream = torch.cuda.current_stream()
        shape = LaunchConfig(grid=-(-count // block), block=block)
        launch(Stream.from_handle(stream.cuda_stream), shape, kernel, call, count)
        stream.synchronize()

    return played


def tensor(array: Any) -> torch.Tensor:
    """A float64 tensor on the present GPU of an array, or of any library's by DLPack; not copied if it is there."""
    return torch.utils.dlpack.from_dlpack(array).to(PLACE, torch.float64)
