"""A call with the exact sentence that refuses it, and the objects that it must leave unchanged."""

from __future__ import annotations

import atexit
import contextlib
import functools
import io
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from jackbox_env import JackInBoxEnv, JackInBoxVectorEnv, Scene, make_simulator
from jackbox_env.model.states import Array
from jackbox_env.simulators import Simulator
from tests.states import at as at

MAKERS: tuple[Any, ...] = (JackInBoxEnv, partial(JackInBoxVectorEnv, 2))
START = np.array([0.125, 0.25, 0.5, 0.5, -0.375, 0.25, 0.125, 0.0, 0.25, 3.0, 1.0, 2.0])


OUTSIDE = (
    "a start must have every foot inside the box (at most 1e-09 m outside), got a foot {:g} m outside; "
    "set_state restores states in contact"
)


class Subject(NamedTuple):
    """An object whose methods are called, its reset, and the values that show its state."""

    make: Callable[[], Any] = lambda: None
    start: Callable[[Any], object] = lambda _: None
    shown: Callable[[Any], Any] = lambda _: None


class Refusal(NamedTuple):
    """A call of something with a subject, its error and its whole sentence; ... is a text that depends on versions."""

    call: Any
    error: type[BaseException]
    sentence: str
    subject: Subject = Subject()


def flat(seen: Any) -> list[Any]:
    """Everything in nested results, as plain values that compare by ==."""
    if isinstance(seen, Mapping):
        return flat([(key, seen[key]) for key in sorted(seen)])
    if isinstance(seen, tuple | list):
        return [part for value in seen for part in flat(value)]
    plain = repr(seen) if isinstance(seen, Scene | float | int | str | bytes | np.generic) else type(seen).__name__
    return [str(seen.dtype), seen.shape, seen.tobytes()] if isinstance(seen, np.ndarray) else [plain]


@functools.cache
def made(make: Callable[[], Any]) -> Any:
    return make()


def assert_refused(row: Refusal) -> None:
    """The call raises its error with its sentence, or prints it and exits with 2, and leaves its subject as it was."""
    one, printed = made(row.subject.make), io.StringIO()
    row.subject.start(one)
    before = flat(row.subject.shown(one))
    with (
        contextlib.chdir(one) if isinstance(one, Path) else contextlib.nullcontext(),
        contextlib.redirect_stderr(printed),
        pytest.raises(row.error) as refused,
    ):
        row.call(one)
    lines = re.sub("jackbox compiles .*\n", "", printed.getvalue())
    said = lines[:-1] if isinstance(refused.value, SystemExit) else str(refused.value)
    assert (refused.type, getattr(refused.value, "code", 2), len(said) < 600) == (row.error, 2, True)
    assert re.fullmatch(re.escape(row.sentence).replace(r"\.\.\.", ".*"), said), said
    assert flat(row.subject.shown(one)) == before, "changed by what it refused"
    row.subject.start(one)
    assert flat(row.subject.shown(one)) == before, "not usable as before"


def rows(refusals: Iterable[Refusal]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("row", refusals, ids=lambda row: row.sentence[:70])


# -- subjects ----------------------------------------------------------------------------------------------------------


def start_simulator(one: Simulator) -> None:
    one.reset(START, 1.0)
    one.step(0.25, 1000.0)


def simulator(contact: str, **scene: Any) -> Subject:
    make = partial(make_simulator, {"gravity": 1.5, **scene}, contact=contact)
    return Subject(make, start_simulator, attrgetter("state", "time", "torque", "impacts"))


def start_single(env: JackInBoxEnv) -> None:
    env.reset(seed=4, options={"scene": {}})
    env.set_state(START, 1.0)


def single(**settings: Any) -> Subject:
    shown = attrgetter("state", "time", "np_random.bit_generator.state", "scene", "observation", "impacts")
    return Subject(partial(JackInBoxEnv, **settings), start_single, shown)


def start_several(env: JackInBoxVectorEnv) -> None:
    env.reset(seed=4, options={"scene": {}})
    env.set_states(START, 1.0)


def several(number: int = 3, **settings: Any) -> Subject:
    shown = attrgetter("states", "times", "np_random_seed", "scenes")
    make = partial(JackInBoxVectorEnv, number, **settings)
    return Subject(make, start_several, lambda envs: [shown(envs), *map(envs.impacts, range(number))])


def with_foot(outside: float, width: float = 6.0) -> Array:
    """A jack at rest with a foot so far outside a box of this half width [m]."""
    return at(x_jack=width - 1.0 + outside)


def put(env: Any, state: Any, time: float = 0.0) -> None:
    (env.set_states if isinstance(env, JackInBoxVectorEnv) else env.set_state)(state, time)


def begun(subject: Subject, *calls: Any) -> Subject:
    """The same, whose beginning is these calls."""
    return subject._replace(start=lambda env: [call(env) for call in calls])


def reset(**options: Any) -> Any:
    return lambda env: env.reset(seed=0, options=options)


def stepped(action: Any, times: int = 1) -> Any:
    return lambda env: [env.step(action) for _ in range(times)]


def second(where: str, value: Any, first: Any) -> Any:
    """A value of the one environment, or of the second of a batch."""
    return [first, value] if where else value


def of_both(contact: str, **settings: Any) -> tuple[tuple[Subject, str], ...]:
    """One environment and a batch of two, and what the batch adds to sentences."""
    one, two = single(contact=contact, **settings), several(2, contact=contact, **settings)
    return (one, ""), (two, ", in environment 1")


@functools.cache
def folder() -> Path:
    """One for all rows of this process, in which they work."""
    path = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, path)
    return path


def fill(path: Path, files: Mapping[str, str | bytes]) -> None:
    for old in path.iterdir():
        shutil.rmtree(old) if old.is_dir() else old.unlink()
    for name, content in files.items():
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (path / name).write_bytes(content if isinstance(content, bytes) else content.encode())


def contents(path: Path) -> dict[str, bytes]:
    paths = (one for one in path.rglob("*") if "__pycache__" not in one.parts)
    return {str(one.relative_to(path)): b"" if one.is_dir() else one.read_bytes() for one in paths}


def files(content: Mapping[str, str | bytes]) -> Subject:
    """A folder with these files."""
    return Subject(folder, partial(fill, files=content), contents)


def command(main: Callable[[], None], *words: str) -> Callable[[Any], None]:
    """A call of a command with these words."""

    def call(_: Any) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "argv", ["jackbox", *words])
            main()

    return call


def refused(call: Callable[[Any], None], sentence: str, content: Mapping[str, str | bytes] = {}) -> Refusal:
    """A command refuses in a folder with these files."""
    return Refusal(call, SystemExit, sentence, files(content))
