"""The kernel of a GPU, translated from PTX to C, computes the CPU's bits: states, energies, impacts and rewards."""

from __future__ import annotations

import os
import re
import shutil
from typing import NamedTuple

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

import jackbox_env
from jackbox_env import Rollout, Scene
from jackbox_env.exact.workspace import Status
from jackbox_env.gpu import ptx
from jackbox_env.gpu.device import Launch, Played, Wanted, play
from tests.gpu.translation import loaded

DT, REPEAT = 0.02, 2
needs_gcc = pytest.mark.skipif(
    shutil.which("gcc") is None and "CI" not in os.environ, reason="the GPU's kernel cannot be translated: no gcc"
)


class Case(NamedTuple):
    """Rows of a scene: its restitution, how far the angles begin [rad], and a factor of the rates."""

    restitution: float = 1.0
    turned: float = 0.0
    factor: float = 1.0


CASES = {
    "elastic": Case(factor=5.0),
    "loss": Case(restitution=0.7, factor=5.0),
    "many turns": Case(turned=3e6, factor=5.0),
    "fast": Case(factor=30.0),
}


def drawn(case: Case, rows: int, steps: int) -> tuple[Scene, NDArray[np.float64], NDArray[np.float64]]:
    """The scene, states and torques of a case."""
    rng, scene = np.random.default_rng(rows), Scene(restitution=case.restitution)
    states = np.zeros((rows, 12))
    states[:, 3:5], states[:, 5] = rng.uniform(-1.0, 1.0, (rows, 2)), rng.uniform(-0.5, 0.5, rows)
    states[:, [2, 5]] += case.turned
    states[:, 8:] = case.factor * rng.normal(size=(rows, 4))
    return scene, states, scene.torque_limit * rng.uniform(-1.0, 1.0, (rows, steps // REPEAT))


def by_kernel(kernel: Launch, scene: Scene, states: NDArray[np.float64], torques: NDArray[np.float64]) -> Played:
    values, ended = torch.tensor([scene.numbers], dtype=torch.float64), torch.zeros(len(states), dtype=torch.int64)
    rows = torch.from_numpy(states), torch.from_numpy(torques)
    return play(kernel, values, *rows, DT, REPEAT, ended, Wanted(True, True, True, True))


def by_cpu(scene: Scene, states: NDArray[np.float64], torques: NDArray[np.float64], task: str) -> Rollout:
    return jackbox_env.rollout(scene, states, torques, DT, repeat=REPEAT, energy=True, impacts=True, rewards=task)


def different(played: Played, cpu: Rollout) -> list[str]:
    """The names of results of which a bit differs in a row that has not been left to the CPU."""
    done = played.ended.numpy() == Status.DONE
    pairs = {
        "states": (played.trajectories, cpu.trajectories), "energies": (played.energies, cpu.energy),
        "impacts": (played.hits, cpu.impacts), "impulses": (played.impulses, cpu.impulse),
        "rewards": (played.rewards, cpu.rewards), "lengths": (played.lengths, cpu.lengths),
        "last": (played.last, cpu.trajectories[:, -1]),
    }  # fmt: skip
    return [name for name, (one, other) in pairs.items() if one.numpy()[done].tobytes() != other[done].tobytes()]


@pytest.fixture(scope="module")
def kernel(tmp_path_factory: pytest.TempPathFactory) -> Launch:
    return loaded(ptx.ptx_of("rattle"), tmp_path_factory.mktemp("kernel"))


@needs_gcc
@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_the_translated_kernel_computes_the_bits_of_the_cpu(kernel: Launch, case: Case) -> None:
    drawn_case = drawn(case, 10, 50)
    played, cpu = by_kernel(kernel, *drawn_case), by_cpu(*drawn_case, "rattle")
    assert different(played, cpu) == []
    assert cpu.impacts.sum() > 0
    assert {*played.ended.tolist()} <= {Status.DONE, Status.UNCOMPILED}
    assert played.ended.count_nonzero() < 10


def test_ptx_that_may_round_otherwise_is_refused() -> None:
    text = ptx.ptx_of("rattle")
    assert len(re.findall("mul.rn.f64", text)) > 1000
    for fault in ("fma.rn.f64 ", "add.f64 ", "sqrt.approx.f64 ", "mul.rn.f32 ", "call.uni ", "cvt.rn.f32.f64 "):
        with pytest.raises(TypeError, match="a GPU would not get the CPU's bits by"):
            ptx.refuse_inexact(f"{text}\t{fault}\t%rd1, %rd2;\n")
