"""Ctrl-C in a batch, or while code is compiled: nothing has changed, or all has; nothing hangs, no thread writes later.

``JACKBOX_INTERRUPTS=100000`` interrupts as often at random moments, not 250 times, and compiling 100 times, not 2.
"""

from __future__ import annotations

import contextlib
import copy
import itertools
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from itertools import product
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np
import pytest

from jackbox_env import Chirp, JackInBoxVectorEnv, Scene, make_simulator, simulators
from jackbox_env.envs import compiled_batch as exact
from jackbox_env.envs import vector
from jackbox_env.exact import run, workspace
from jackbox_env.exact import threads as batch_threads
from jackbox_env.exact.geometry import cos_sin
from jackbox_env.exact.workspace import Status
from jackbox_env.jit import compiler
from jackbox_env.simulators import CONTACT_MODELS, Simulator, contacts
from jackbox_env.tools.signals import uninterrupted
from tests.guarantees import interrupting_compiler
from tests.states import WEIGHTLESS, at, lying, started

INTERRUPTS = int(os.environ.get("JACKBOX_INTERRUPTS", "250"))
ACTIONS = np.array([-0.5, 1.0])


def made(contact: str = "exact", num_envs: int = 2, **settings: Any) -> JackInBoxVectorEnv:
    """Environments of which every step ends the episode and draws another scene."""
    settings["randomize"] = {"gravity": (1.0, 9.0)}
    return started(JackInBoxVectorEnv(num_envs, 1, "SAME_STEP", num_threads=2, contact=contact, **settings), seed=0)


def shown(env: JackInBoxVectorEnv) -> list[bytes]:
    return [values.tobytes() for values in (env.states, env.times, env.observations, env.field("gravity"))]


CALLS: dict[str, Callable[[JackInBoxVectorEnv], Any]] = {
    "step": lambda env: env.step(ACTIONS),
    "reset": lambda env: env.reset(seed=5, options={"scene": [None, {"restitution": 0.5, "drive": None}]}),
    "reset of some": lambda env: env.reset(seed=6, options={"reset_mask": ACTIONS > 0.0, "time": 2.0}),
    "set_states": lambda env: env.set_states(np.zeros(12), 0.5, ACTIONS > 0.0),
}
ENVS = str(Path(vector.__file__).parent)


def interrupted(call: Callable[[], Any], lines: int, folder: str = ENVS) -> bool:
    """Call with a KeyboardInterrupt at the last of so many lines run in a folder; return whether it came to that."""

    def trace(frame: Any, event: str, _: Any) -> Any:
        nonlocal lines
        if not frame.f_code.co_filename.startswith(folder):
            return None
        lines -= event == "line"
        if lines == 0:
            raise KeyboardInterrupt
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        call()
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(before)
    return False


@pytest.mark.parametrize(
    ("contact", "observation", "name"),
    [*product(["exact", "pymunk"], ["state"], CALLS), ("exact", "pixels-16x16x2", "step")],
)
def test_a_call_interrupted_at_any_line_changes_nothing_or_all(contact: str, observation: str, name: str) -> None:
    begun, call, lines, results = made(contact, observation=observation), CALLS[name], 0, [0, 0]
    begun.step(ACTIONS)
    done = copy.deepcopy(begun)
    call(done)
    expected = [played(copy.deepcopy(begun)), played(done)]
    assert expected[0] != expected[1]
    while True:
        env, lines = copy.deepcopy(begun), lines + 1
        if not interrupted(lambda env=env: call(env), lines):  # type: ignore[misc]
            break
        result = played(env)
        assert result in expected, f"half changed by an interruption at line {lines} of the call"
        results[expected.index(result)] += 1
    assert all(results), results


@pytest.mark.parametrize("contact", CONTACT_MODELS)
def test_a_simulators_step_interrupted_at_any_line_changes_nothing_or_all(contact: str) -> None:
    scene = Scene(jack_arm=2.0, restitution=0.3)
    begun = started(make_simulator(scene, contact), at(theta_jack=0.3, vx_jack=6.0, omega_jack=2.0))
    while not begun.impacts:  # the next steps have more
        begun.step(0.02, 2e4)

    def seen(run: Simulator) -> list[Any]:
        after = [run.step(0.02, -2e4) for _ in range(2)]
        return [(state.tobytes(), *rest) for state, *rest in after]

    ends, file = [seen(copy.deepcopy(begun))], str(Path(simulators.__file__).with_name(f"{contact}.py"))
    done = copy.deepcopy(begun)
    done.step(0.02, 1e4)
    ends.append(seen(done))
    for lines in itertools.count(1):
        run = copy.deepcopy(begun)
        if not interrupted(lambda run=run: run.step(0.02, 1e4), lines, file):  # type: ignore[misc]
            break
        assert seen(run) in ends, f"half changed by an interruption at line {lines} of the step"
    assert lines > 10


def test_an_interruption_while_the_engine_calls_back_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    simulator = started(make_simulator(WEIGHTLESS, "pymunk"), 0.1 * np.eye(12)[5] + 300.0 * np.eye(12)[9])
    monkeypatch.setattr(contacts, "Impact", interrupt)
    with pytest.raises(KeyboardInterrupt):
        simulator.step(0.02)
    assert simulator.time == 0.0


def played(env: JackInBoxVectorEnv) -> list[Any]:
    """All that can be read now, the scenes first, as nothing may write them before; and after each of two steps."""
    result: list[Any] = []
    for steps in range(3):
        if steps:
            env.step(ACTIONS)
        result += [env.scenes, env.field("gravity").tolist(), env.field("restitution").tolist(), *shown(env)]
    return result


SCENES = [Scene(restitution=0.5, drive=None), Scene(drive=Chirp(start_frequency=4e6, rate=0.0))]


@pytest.mark.parametrize(
    ("scene", "count"), [*zip(SCENES, (300 * workspace.WIDEST, 50), strict=True)], ids=["rest", "chirp"]
)
def test_an_interruption_of_a_long_step_is_noticed_soon(
    scene: Scene, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Jacks at rest cost most, and 80,000 turns of a chirp within a step, computed for each row because their times
    # differ. Compiled code checks for no signal: it has to return after a part of the step, the chirp's of a block.
    env = started(JackInBoxVectorEnv(count, contact="exact", scene=scene, num_threads=1), seed=0)
    states = np.tile(np.zeros(12) if scene.drive else lying(), (count, 1))
    states[:, 3] = np.linspace(-4.0, 4.0, count)
    env.set_states(states, np.linspace(0.0, 1.0, count))
    loop, ends = compiler.compiled(run.run), list[int]()

    def interrupted_step(*arguments: Any) -> Any:
        returned = loop(*arguments)
        if returned[0] == Status.UNCOMPILED:  # feet at rest: it is called again
            return returned
        ends.append(returned[0])
        raise KeyboardInterrupt

    monkeypatch.setattr(exact, "compiled", lambda _: interrupted_step)
    with pytest.raises(KeyboardInterrupt):
        env.step(None)
    assert ends == [Status.PAUSED]
    np.testing.assert_array_equal(env.states, states)


def test_a_thread_that_outlives_a_second_interruption_changes_no_later_step(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    env, twin = made(num_envs=640), made(num_envs=640)
    main, begun, gate, ended = threading.get_ident(), threading.Event(), threading.Event(), threading.Event()
    loop = compiler.compiled(run.run)

    def late(*arguments: Any) -> Any:
        if threading.get_ident() == main:
            assert begun.wait(20.0)
            raise KeyboardInterrupt
        begun.set()
        assert gate.wait(20.0)
        returned = loop(*arguments)
        ended.set()
        return returned

    def interrupted_wait(*_: Any) -> None:
        raise KeyboardInterrupt

    before = shown(env)
    with monkeypatch.context() as patch:
        patch.setattr(exact, "compiled", lambda _: late)
        patch.setattr(batch_threads, "_gather", interrupted_wait)
        with pytest.raises(KeyboardInterrupt):
            env.step(None)
    assert shown(env) == before
    env.step(None), twin.step(None)
    gate.set()
    assert ended.wait(20.0)
    assert shown(env) == shown(twin)


@pytest.mark.parametrize("name", ["SIGALRM", "SIGINT"])
@pytest.mark.timeout(300 + INTERRUPTS // 20)
def test_interrupts_at_random_moments_neither_hang_nor_raise_other_errors(name: str) -> None:
    command = [sys.executable, "-m", "tests.guarantees.interrupting", name, str(INTERRUPTS)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    assert int(ran.stdout.split()[0]) >= INTERRUPTS, ran.stdout


def test_handlers_of_signals_wait_for_a_block_or_the_next_in_it_and_are_set_again() -> None:
    came, number = list[int](), signal.SIGUSR1
    before = signal.signal(number, lambda *_: came.append(len(came)))
    try:
        with contextlib.suppress(ValueError), uninterrupted():
            signal.raise_signal(number)
            assert came == []
            with uninterrupted():
                assert came == [0]
            signal.raise_signal(number)
            raise ValueError
        assert came == [0, 1]
        signal.raise_signal(number)
        assert came == [0, 1, 2]
    finally:
        signal.signal(number, before)


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_interrupts_at_random_moments_of_compiling_leave_nothing_broken(tmp_path: Path) -> None:
    expected, interrupts = interrupting_compiler.steps(), 0
    for seed in itertools.count():
        command = [sys.executable, "-m", "tests.guarantees.interrupting_compiler", str(seed)]
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / str(seed))}
        ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert ran.returncode == 0, f"seed {seed}: {ran.stderr}"
        count, digest = ran.stdout.split()
        assert digest == expected, seed
        interrupts += int(count)
        if interrupts >= min(100, INTERRUPTS // 100):
            break


class Interrupt:
    """Interrupts this process when a module is imported, once."""

    def __init__(self, name: str) -> None:
        self._name = name
        sys.meta_path.insert(0, self)

    def find_spec(self, name: str, *_: Any) -> None:
        """Find nothing."""
        if name == self._name:
            sys.meta_path.remove(self)
            signal.raise_signal(signal.SIGINT)


def compile_twice(name: str) -> None:
    """Print what compiled code returns after an interrupt at the import of a module of numba."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background processes ignore it
    Interrupt(name)
    with pytest.raises(KeyboardInterrupt):
        compiler.compiled(cos_sin)(0.3)
    again = compiler.compiled(cos_sin)
    print(again(0.3) == cos_sin(0.3) and not isinstance(again, FunctionType))


@pytest.mark.parametrize(
    "name", [pytest.param("numba.core.types.misc", marks=pytest.mark.slow), "numba.parfors.parfor"]
)
def test_an_interrupt_while_numba_is_imported_leaves_nothing_broken(name: str) -> None:
    code = f"from {__name__} import compile_twice; compile_twice({name!r})"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (ran.stdout, ran.stderr) == ("True\n", "")


def test_a_forked_process_steps_with_new_threads() -> None:
    env = made(num_envs=640)
    env.step(None)
    before = env.states
    process = os.fork()
    if process == 0:
        signal.alarm(20)  # ends the child if it waits for a thread
        env.step(None)
        os._exit(int((env.states == before).all()))
    assert os.waitpid(process, 0)[1] == 0


EXIT = """
import threading, jackbox_env
waiting, stepping = (jackbox_env.JackInBoxVectorEnv(2000, contact="exact", num_threads=2) for _ in range(2))
waiting.reset(seed=0), waiting.step(None), stepping.reset(seed=0)
threading.Thread(target=lambda: [stepping.step(None) for _ in range(10**6)], daemon=True).start()
"""


def test_a_process_ends_while_a_step_runs_and_threads_wait() -> None:
    ran = subprocess.run([sys.executable, "-c", EXIT], capture_output=True, text=True, timeout=60, check=False)
    assert ran.returncode == 0, ran.stderr
