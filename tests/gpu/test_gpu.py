"""The kernel of a GPU, translated from PTX to C, computes the CPU's bits."""

from __future__ import annotations

import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import torch

import jackbox_env
from agents.policies.icem import PlanSearch
from jackbox_env import Scene, State, Task
from jackbox_env.gpu import device, ptx, row
from jackbox_env.jit.compiler import intermediate_code, kinds_of
from jackbox_env.model.scene import SceneNumbers
from jackbox_env.model.tasks import TASKS
from jackbox_env.planning import card
from scripts.studies.speed import gpu
from tests.gpu.translation import loaded

needs_gcc = pytest.mark.skipif(
    shutil.which("gcc") is None and "EXPECTED_GCC" not in os.environ,
    reason="there is no gcc to translate the code of GPUs by",
)
LARGER = re.compile(r"(%\S+) = fcmp ogt double (\S+), (\S+)\n +(\S+) = select i1 \1, double \2, double \3\n")
FMA = re.compile(r"(mul\.rn\.f64 \t(%rd\d+), (.*), (.*);\n\t)add\.rn\.f64 \t(%rd\d+), (%rd\d+), \2;")


def prepared(folder: Path, rows: int, code: str | None = None) -> list[tuple[str, int, int, int]]:
    """Results of both halves of the study, the second by the translated kernel."""
    gpu.prepare(folder, rows)
    kernel = loaded(code or (folder / "kernel.ptx").read_text())
    return list(gpu.compared(folder, device, kernel, "cpu"))


@needs_gcc
@pytest.mark.parametrize("rows", [3, pytest.param(125, marks=pytest.mark.slow)])
def test_the_translated_kernel_computes_the_bits_of_the_cpu(tmp_path: Path, rows: int) -> None:
    results = prepared(tmp_path, rows)
    assert [name for name, *_ in results] == list(gpu.CASES)
    for name, equal, played, left in results:
        assert (equal, played + left) == (played, rows), name
        assert left == 0 or name == "loss"


@needs_gcc
def test_contracted_products_are_refused_and_change_bits(tmp_path: Path) -> None:
    contracted, count = FMA.subn(r"\1fma.rn.f64 \t\5, \3, \4, \6;", ptx.ptx_of(gpu.TASK))
    assert count > 100
    with pytest.raises(TypeError, match=r"a GPU would not get the CPU's bits by fma\.rn\.f64"):
        ptx.refuse_inexact(contracted)
    assert any(equal < played for _, equal, played, _ in prepared(tmp_path, 3, contracted))


@pytest.mark.parametrize(
    "fault", ["add.f64", "sqrt.approx.f64", "mul.rn.f32", "call.uni", "cvt.rz.f32.f64", "rsqrt.rn.f64"]
)
def test_an_instruction_that_may_round_otherwise_is_refused(fault: str) -> None:
    with pytest.raises(TypeError, match=f"a GPU would not get the CPU's bits by {re.escape(fault)}"):
        ptx.refuse_inexact(f"{ptx.ptx_of(gpu.TASK)}\t{fault} \t%rd1, %rd2;\n")


# -- device="cuda" -----------------------------------------------------------------------------------------------------


@pytest.fixture
def without_card(monkeypatch: pytest.MonkeyPatch) -> None:
    """``device="cuda"`` plays by the translated kernel, in this machine's memory."""
    monkeypatch.setenv("JACKBOX_UNTRIED_GPU", "1")
    monkeypatch.setattr(device, "launcher", loaded)
    monkeypatch.setattr(device, "PLACE", "cpu")


def rows_with_loss() -> tuple[list[Scene], Any, Any]:
    """Ten rows of two scenes; in some feet come to rest, in one two feet land at once, in one side forces act."""
    scene, drawn = gpu.rows_of(0.6, 0.0, 5.0, 10)
    drawn["states"][0], drawn["torques"][0] = [0.0] * 5 + [np.pi / 4] + [0.0] * 6, 0.0
    pushed = scene.changed(drive=jackbox_env.Drive(force_x=lambda time: 50.0))
    return [scene] * 8 + [scene.changed(gravity=3.0), pushed], drawn["states"], drawn["torques"]


@needs_gcc
@pytest.mark.usefixtures("without_card")
@pytest.mark.parametrize("wanted", [{"energy": True, "impacts": True}, {"trajectories": False}])
def test_rollouts_on_a_card_are_those_of_the_cpu(wanted: dict[str, Any]) -> None:
    scenes, states, torques = rows_with_loss()
    played, cpu = (
        jackbox_env.rollout(scenes, states, torques, 0.02, repeat=4, rewards=gpu.TASK, device=one, **wanted)
        for one in ("cuda", None)
    )
    assert played.left_to_cpu == 7  # two feet at once are not among them
    for one, other in zip(played[:-1], cpu[:-1], strict=True):
        np.testing.assert_array_equal(one, other)
        assert other is None or (one.dtype, one.strides) == (other.dtype, other.strides)


@needs_gcc
@pytest.mark.usefixtures("without_card")
def test_tensors_are_played_and_returned_where_they_are() -> None:
    _, states, torques = rows_with_loss()
    given = torch.from_numpy(states), torch.from_numpy(torques[0])
    played = jackbox_env.rollout(None, *given, 0.02, rewards=gpu.TASK, device="cuda")
    cpu = jackbox_env.rollout(None, states, torques[0], 0.02, rewards=gpu.TASK)
    assert all(isinstance(one, torch.Tensor) for one in (played.trajectories, played.rewards, played.lengths))
    np.testing.assert_array_equal(played.trajectories, cpu.trajectories)
    np.testing.assert_array_equal(played.rewards, cpu.rewards)
    assert device.tensor(given[0]).data_ptr() == given[0].data_ptr()


@needs_gcc
@pytest.mark.usefixtures("without_card")
def test_rows_at_huge_angles_are_left_to_the_cpu_and_those_that_fail_raise_its_errors() -> None:
    states = np.zeros((3, 12))
    states[1, 2], states[2, 9] = 1e16, 1e14
    two: Any = None, states[:2], np.zeros(3), 0.02
    played, cpu = (jackbox_env.rollout(*two, rewards=gpu.TASK, device=place) for place in ("cuda", None))
    assert played.left_to_cpu == 1
    np.testing.assert_array_equal(played.trajectories, cpu.trajectories)
    for place in (None, "cuda"):
        with pytest.raises(jackbox_env.JackLostError, match=r"the jack of states\[2\] moves too fast"):
            jackbox_env.rollout(None, states, np.zeros(3), 0.02, rewards=gpu.TASK, device=place)


# -- tasks of one's own -----------------------------------------------------------------------------------------------


def worst(scene: SceneNumbers, state: State, torque: float, impulse: float) -> float:
    """Numbers that are NaN in flight and infinite or finite after impacts, in a maximum of each order.

    Without torque and impacts it divides by zero.
    """
    bad = state.vx_box * math.inf
    return (1.0 if max(bad, 0.25) > 0.0 else 0.5) + (2.0 if max(0.25, bad) > 0.0 else 0.25) / (torque - impulse)


def fallen(scene: SceneNumbers, state: State, torque: float, impulse: float) -> bool:
    return impulse > 0.0


@needs_gcc
@pytest.mark.slow
@pytest.mark.usefixtures("without_card")
def test_a_task_of_ones_own_has_the_bits_and_errors_of_the_cpu_unless_fmax_is_its_max(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    checked = Mock(wraps=ptx.checked)
    monkeypatch.setattr(ptx, "checked", checked)
    scene, drawn = gpu.rows_of(1.0, 0.0, 30.0, 5)
    task = Task(("worst",), worst, fallen)

    def played(place: str | None, torques: Any = drawn["torques"]) -> Any:
        return jackbox_env.rollout(scene, drawn["states"], torques, 0.02, rewards=task, device=place)

    cpu, by_card = played(None), played("cuda")
    assert by_card.left_to_cpu == 0
    assert (cpu.lengths < 50).any()
    np.testing.assert_array_equal(by_card.rewards, cpu.rewards)
    np.testing.assert_array_equal(by_card.lengths, cpu.lengths)
    for place in (None, "cuda"):
        with pytest.raises(ZeroDivisionError):
            played(place, np.zeros(3))

    code, *name_and_chip = checked.call_args.args
    code, count = LARGER.subn(r"\4 = call double @llvm.maxnum.f64(double \2, double \3)\n", code)
    assert count
    by_fmax = [f"{code}declare double @llvm.maxnum.f64(double, double)\n", *name_and_chip]
    with pytest.raises(TypeError, match=r"this one needs llvm\.maxnum\.f64"):
        checked(*by_fmax)
    monkeypatch.setattr(ptx, "refuse_more_than_arithmetic", Mock())
    monkeypatch.setattr(card, "code_of", Mock(return_value=checked(*by_fmax)))
    assert (played("cuda").rewards != cpu.rewards).any()


@pytest.mark.slow
def test_a_task_that_needs_more_than_arithmetic_is_refused() -> None:
    task = Task(("more",), lambda scene, state, torque, impulse: math.exp(state.y_jack))
    with pytest.raises(TypeError, match=r"runs functions of .* this one needs llvm\.exp\.f64"):
        card.code_of(task)


def test_a_remainder_is_refused() -> None:
    with pytest.raises(TypeError, match=r"runs functions of .* this one needs %"):
        ptx.emitted("define double @rollout(double %x) {\n  %y = frem double %x, 1.0\n  ret double %y\n}\n", "sm_80")


@needs_gcc
@pytest.mark.slow
def test_a_remainder_as_gpus_compute_it_changes_bits(tmp_path: Path) -> None:
    def rounded(x: float, y: float) -> float:
        return x - math.floor(x / y) * y

    code = intermediate_code(
        row.play, kinds_of(row.arguments()), **row.SUBSTITUTES, task_terms=TASKS[gpu.TASK].values, remainder=rounded
    )
    for chip in ("sm_80", "sm_90"):
        results = prepared(tmp_path, 20, ptx.checked(*code, chip, row.arguments()))
        assert [name for name, equal, played, _ in results if equal < played] == ["many turns"]


def test_the_half_on_a_card_needs_pytorch_alone() -> None:
    code = "import sys\nfor name in ('numba', 'pymunk', 'gymnasium', 'jackbox_env'): sys.modules[name] = None\n"
    code += "import gpu\ngpu.device_module().play"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(gpu.__file__).parent)


# -- refusals ----------------------------------------------------------------------------------------------------------


def test_a_card_is_refused_in_a_sentence() -> None:
    rows = None, np.zeros(12), np.zeros(3), 0.02
    with pytest.raises(RuntimeError, match='^device="cuda" has not run on a GPU yet, only its code has been checked;'):
        jackbox_env.rollout(*rows, device="cuda")
    with pytest.raises(ValueError, match="^device must be one of 'cuda', got 'cpu'"):
        jackbox_env.rollout(*rows, device="cpu")


@pytest.mark.parametrize(
    ("available", "kind", "sentence"),
    [
        (
            None,
            ImportError,
            r"""device="cuda" needs cuda-core, the extra 'gpu': in a checkout of jackbox, pip install -e""",
        ),
        (
            False,
            RuntimeError,
            'device="cuda" needs a GPU of NVIDIA and a driver for CUDA 12 or newer, PyTorch finds none',
        ),
        (True, RuntimeError, 'the driver cannot load the code of device="cuda", for CUDA 11.8 or newer: unsupported'),
    ],
    ids=["no cuda-core", "no driver", "old driver"],
)
def test_a_missing_driver_is_named(
    monkeypatch: pytest.MonkeyPatch, available: bool | None, kind: type[Exception], sentence: str
) -> None:
    core = Mock()
    core.ObjectCode.from_ptx.side_effect = RuntimeError("unsupported")
    monkeypatch.setitem(sys.modules, "cuda", core)
    monkeypatch.setitem(sys.modules, "cuda.core", None if available is None else core)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: available)
    monkeypatch.setattr(torch.cuda, "current_device", lambda: 0)
    with pytest.raises(kind, match="^" + re.escape(sentence)):
        device.launcher("")


def test_a_kernel_is_played_on_the_gpu_that_it_was_made_for(monkeypatch: pytest.MonkeyPatch) -> None:
    core, present = Mock(), Mock(return_value=0)
    monkeypatch.setitem(sys.modules, "cuda", core)
    monkeypatch.setitem(sys.modules, "cuda.core", core)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "current_device", present)
    first = device.launcher("code")
    present.return_value = 1
    assert device.launcher("code") is not first
    with pytest.raises(RuntimeError, match="^the present GPU must be number 0, got 1$"):
        first(0, 1)
    assert not core.launch.called


@pytest.mark.usefixtures("without_card")
def test_too_little_memory_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device, "launcher", Mock())
    monkeypatch.setattr(device, "play", Mock(side_effect=torch.cuda.OutOfMemoryError))
    with pytest.raises(MemoryError, match="^the GPU has too little memory for 1 rows of 3 steps: play fewer$"):
        jackbox_env.rollout(None, np.zeros(12), np.zeros(3), 0.02, rewards=gpu.TASK, device="cuda")


@needs_gcc
@pytest.mark.usefixtures("without_card")
def test_planners_use_a_card() -> None:
    plans, states = dict[str | None, Any](), np.zeros((1, 12))
    for place in ("cuda", None):
        search = PlanSearch(gpu.TASK, 0.02, repeat=5, knots=3, samples=8, elites=2, iterations=2, device=place)
        plans[place] = search.decide(Scene(), states, search.begin(1))[:2]
    for by_gpu, by_cpu in zip(plans["cuda"], plans[None], strict=True):
        np.testing.assert_array_equal(by_gpu, by_cpu)
