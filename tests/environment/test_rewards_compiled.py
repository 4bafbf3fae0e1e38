"""A user's reward in compiled code: nobody is paid another's, and a new environment reads the function anew."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import jackbox_env
from jackbox_env import JackInBoxEnv, JackInBoxVectorEnv, Task
from jackbox_env.compiled.compiler import _cache_folders

_PROCESS = """
import jackbox_env
from rewards import paid
env = jackbox_env.JackInBoxVectorEnv(2, contact="exact", task=jackbox_env.Task(("paid",), paid))
env.reset(seed=0)
print(env.step(None)[1][0])
"""


@pytest.mark.slow  # compiles anew
def test_two_processes_with_different_tasks_never_get_each_others_code(tmp_path: Path) -> None:
    """The same file, name and bytecode: only a global, or a helper in another file, differs."""
    found = []
    for number, (bonus, factor) in enumerate([(1.0, 1.0), (2.0, 1.0), (2.0, 5.0)]):
        folder = tmp_path / "work"
        folder.mkdir(exist_ok=True)
        (folder / "more.py").write_text(f"def more(value):\n    return {factor} * value\n")
        (folder / "rewards.py").write_text(
            "from more import more\n"
            f"BONUS = {bonus}\n\n\ndef paid(scene, state, torque, impulse):\n    return (more(BONUS),)\n"
        )
        environment = {
            **os.environ,
            "NUMBA_CACHE_DIR": os.environ.get("NUMBA_CACHE_DIR", str(tmp_path / "cache")),
            "PYTHONPATH": os.pathsep.join([str(folder), str(Path(jackbox_env.__file__).parents[1])]),
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        done = subprocess.run(
            [sys.executable, "-c", _PROCESS], env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        found.append(float(done.stdout.split()[-1]))
        assert number < 3
    assert found == [1.0, 2.0, 10.0]


_SCORES = """
import sys
import numpy as np
from jackbox_env.compiled.address import address_of
from jackbox_env.compiled.score import score_block, score_one
from jackbox_env.scene import Scene
from jackbox_env.scoring import compiled_for
from jackbox_env.tasks import TASKS
numbers, state, found = np.array(Scene().numbers), np.linspace(0.1, 0.5, 12), []
for name in sys.argv[1:]:
    terms = np.zeros(len(TASKS[name].terms))
    compiled_for(TASKS[name], score_one)(numbers, state, 5.0, 2.0, np.empty(10, np.float32), terms)
    assert terms.tolist() == list(TASKS[name].values(Scene().numbers, state, 5.0, 2.0)), name
    found.append(address_of(compiled_for(TASKS[name], score_block)))
again = [address_of(compiled_for(TASKS[name], score_block)) for name in sys.argv[1:]]
assert found == again and len(set(found)) == len(found), (found, again)
"""


def test_a_process_that_loads_what_others_have_kept_tells_their_tasks_apart(tmp_path: Path) -> None:
    """Each of the first processes compiles one task, so numba counts them alike; the last loads them all."""
    environment = {
        **os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(Path(jackbox_env.__file__).parents[1])
    }  # fmt: skip
    for names in (["juggle"], ["rattle"], ["spin"], ["juggle", "rattle", "spin"]):
        done = subprocess.run(
            [sys.executable, "-c", _SCORES, *names], env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, (names, done.stderr)


_PAID = """
import functools, sys
import numpy as np
from jackbox_env import JackInBoxEnv, JackInBoxVectorEnv, Task, tasks
def paid(task):
    env, batch = JackInBoxEnv(contact="exact", task=task), JackInBoxVectorEnv(2, contact="exact", task=task)
    env.reset(seed=0), batch.reset(seed=0)
    reward = float(batch.step(np.ones(2))[1][0])
    assert float(env.step(1.0)[1]) == reward
    return reward
def wrapped():
    @functools.wraps(tasks.juggle)
    def mine(scene, state, torque, impulse):
        return (-900.0,)
    return Task(("centre",), mine)
def named():
    def mine(scene, state, torque, impulse):
        return (-5.0,)
    mine.__name__, mine.__qualname__, mine.__module__ = "spin", "spin", "jackbox_env.tasks"
    return Task(("spin",), mine)
def put_in_its_place():
    tasks.juggle = wrapped().values
    tasks.TASKS["juggle"] = Task(("centre",), tasks.juggle)
    return "juggle"
def with_another_constant():
    tasks.EFFORT_COST = 99.0
    return "rattle"
def with_another_helper():
    tasks._calm = functools.wraps(tasks._calm)(lambda scene, state, limit: 1.0)
    tasks._calm.__module__ = "jackbox_env.tasks"
    return "rattle"
print(*[paid(eval(name)) for name in sys.argv[1:]])
"""


def test_a_later_process_is_never_paid_what_another_process_has_made_of_a_task(tmp_path: Path) -> None:
    reward_now(Task(("paid",), lambda scene, state, torque, impulse: (0.0,)))  # compiles the rest, which is kept
    for folder in _cache_folders():
        shutil.copytree(folder, tmp_path / folder.name, ignore=shutil.ignore_patterns("score*"))

    def paid(*names: str) -> list[float]:
        environment = {
            **os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(Path(jackbox_env.__file__).parents[1])
        }  # fmt: skip
        done = subprocess.run(
            [sys.executable, "-c", _PAID, *names], env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return [float(word) for word in done.stdout.split()]

    for name, reward in (
        ("wrapped()", -900.0), ("named()", -5.0), ("put_in_its_place()", -900.0), ("with_another_constant()", -99.0),
        ("with_another_helper()", -0.01),
    ):  # fmt: skip
        assert paid(name) == [reward], name
    centre, spun, knocked = paid("'juggle'", "'spin'", "'rattle'")
    assert (0.8 < centre < 1.0, spun, knocked) == (True, 0.0, -0.01)


def reward_now(task: Task) -> float:
    """What it pays in environments that are made now, alone and in a batch."""
    env, batch = JackInBoxEnv(contact="exact", task=task), JackInBoxVectorEnv(2, contact="exact", task=task)
    env.reset(seed=0)
    batch.reset(seed=0)
    played: Any = jackbox_env.rollout(None, batch.states, np.zeros((2, 1)), 0.02, rewards=task)
    reward = env.step(0.0)[1]
    assert reward == batch.step(np.zeros(2))[1][0] == played.rewards[0, 0]
    return reward


_READ = """
import numpy as np
WEIGHT, TABLE, PAIR = 1.0, np.array([10.0, 20.0]), (100.0, 200.0)
def helper(value): return 1000.0 * value
def paid(scene, state, torque, impulse, more=10000.0):
    def inner(value): return helper(value) + more
    return (WEIGHT + TABLE[0] + PAIR[0] + inner(1.0) + module.own(1.0),)
"""


def test_a_new_environment_sees_every_change_of_what_the_function_reads() -> None:
    module = ModuleType("module")
    exec("weight = 1e5\ndef own(value): return weight * value", module.__dict__)
    space: dict[str, Any] = {"module": module}
    exec(_READ, space)
    task = Task(("paid",), space["paid"])
    assert reward_now(task) == 111111.0
    changes: list[Any] = [
        lambda: space.update(WEIGHT=2.0), lambda: space["TABLE"].fill(20.0), lambda: space.update(PAIR=(200.0, 1.0)),
        lambda: exec("def helper(value): return 2000.0 * value", space),
        lambda: setattr(task.values, "__defaults__", (20000.0,)), lambda: setattr(module, "weight", 2e5),
    ]  # fmt: skip
    for number, change in enumerate(changes):
        change()
        assert reward_now(task) == float("111111"[: 5 - number] + "222222"[: number + 1])
    task.values.__code__ = (lambda scene, state, torque, impulse: (7.0,)).__code__
    assert reward_now(task) == 7.0


def test_functions_that_differ_only_in_what_they_hold_are_paid_apart() -> None:
    def holding(weight: float) -> Task:
        return Task(("paid",), lambda scene, state, torque, impulse: (math.copysign(weight + 1.0, weight),))

    assert [reward_now(holding(weight)) for weight in (0.0, -0.0, 1.0, 2, True)] == [1.0, -1.0, 2.0, 3.0, 2.0]
    tasks = [Task(("paid",), lambda scene, state, torque, impulse, by=by: (by,)) for by in (1.0, 2.0)]
    assert [reward_now(task) for task in tasks] == [1.0, 2.0]


def task_terms(scene: Any, state: Any, torque: float, impulse: float) -> float:
    return 0.25


def make_numbers(value: float) -> float:
    return 2.0 * value


def test_a_helper_named_as_one_of_ours_is_the_users() -> None:
    def helped(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float]:
        return (make_numbers(task_terms(scene, state, torque, impulse)),)

    assert reward_now(Task(("paid",), helped)) == 0.5


def test_an_environment_keeps_the_reward_that_it_was_made_with() -> None:
    space: dict[str, Any] = {"WEIGHT": 1.0}
    exec("def paid(scene, state, torque, impulse): return (WEIGHT,)", space)
    task, ranges = Task(("paid",), space["paid"]), {"jack_mass": (3.0, 5.0)}
    env = JackInBoxEnv(contact="exact", task=task, randomize=ranges)
    batch = JackInBoxVectorEnv(2, contact="exact", task=task, randomize=ranges)
    space["WEIGHT"] = 2.0
    env.reset()
    batch.reset()
    assert env.step(0.0)[1] == batch.step(np.zeros(2))[1][0] == 1.0


def test_nothing_of_a_users_task_is_kept_on_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from jackbox_env.compiled import kept

    written = []
    monkeypatch.setattr(kept, "_write", lambda path, content: written.append(path.name))
    task = Task(("a",), lambda scene, state, torque, impulse: (state[0],))
    JackInBoxVectorEnv(2, contact="exact", task=task)
    assert not [name for name in written if name.startswith("score")]
