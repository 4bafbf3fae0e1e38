"""Games as text, which the page of ``jackbox play`` shares and the package replays to the last bit.

The text is a JSON object, or a link that ends in one after a ``#``, percent-encoded or not:

- ``version``: of this format, 1. ``package``: of the jackbox that wrote it, for information.
- ``task``: juggle (default), spin or rattle. ``dt``: control step [s], default 0.02, from 0.001 to 1.
- ``scene``: an object of jack_mass, jack_arm, restitution, gravity, torque_limit and box_mass, as far as they differ
  from the default scene. Inertias follow from masses and sizes.
- ``start``: the state in which the game starts, 12 numbers; or four strings of decimal digits, the words of a PCG64
  generator (state high and low, increment high and low) that draws it as :func:`jackbox_env.model.tasks.sample_start`.
- ``shares``: the torque of each run of steps as a share of the torque limit, float64, little-endian.
- ``counts``: the length of each run, uint16, little-endian. The low 15 bits are its number of steps. The top bit marks
  the scene's own drive; the run's share is then 0.
- ``checks``: a byte for each step, the top one of the hash after it. ``digest``: the last hash, 16 hexadecimal digits.

A game lasts 1,000 s at most, which is longer than any text of the page. So its chirp turns 450,000 times at most.

Shares, counts and checks are in base64url without padding. A start without steps has none of the last four. The hash is
FNV-1a over 64-bit words: the 12 numbers of the state after each step, from the first step on.
"""

from __future__ import annotations

import json
import re
from base64 import urlsafe_b64decode, urlsafe_b64encode
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any, NamedTuple
from urllib.parse import unquote

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jackbox_env import __version__
from jackbox_env.exact.pcg64 import WHOLE, generator_of
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import Array, as_start
from jackbox_env.model.tasks import TASKS, sample_start
from jackbox_env.simulators import JackLostError
from jackbox_env.simulators.agent_functions import make_functions
from jackbox_env.simulators.exact import ExactSimulator
from jackbox_env.simulators.plain_functions import ControlStep, Interface
from jackbox_env.tools import checks as check

VERSION = 1
LONGEST = 65_536  # characters of a text
MOST_SECONDS = 1000.0  # [s] of a game, at most
MOST_WORK = 5e7  # gap evaluations of a replay: 10 s, 150 s if all of them find impacts
FIELDS = ("jack_mass", "jack_arm", "restitution", "gravity", "torque_limit", "box_mass")  # of the scene
FARTHEST = 1e6  # numbers of a start, at most
_ARRAYS = {"shares": "<f8", "counts": "<u2", "checks": "u1"}
_KEYS = ("version", "package", "task", "scene", "dt", "start", *_ARRAYS, "digest")
_DRIVEN = 1 << 15  # the mark in a count; a run is shorter than this
_BASIS, _PRIME, _WORD = 0xCBF29CE484222325, 0x100000001B3, (1 << 64) - 1  # of the hash


class Game(NamedTuple):
    """A shared game, which starts at time 0.

    Attributes:
        task: juggle, spin or rattle.
        scene: of the game.
        dt: control step [s].
        start: the first state, shape (12,).
        shares: the torque of each step over the torque limit, from -1 to 1; None: the scene's drive.
        checks: the top byte of the hash after each step.
        digest: the hash after the last step.
    """

    task: str
    scene: Scene
    dt: float  # [s]
    start: Array
    shares: Sequence[float | None] = ()
    checks: bytes = b""
    digest: int = _BASIS


class PlayedStep(NamedTuple):
    """A simulated step of a game.

    Attributes:
        result: state and time at its end, mean torque, impacts and their impulse, reward.
        number: the hash after it.
    """

    result: ControlStep
    number: int


def read_game(text: str) -> Game:
    """Read a shared game from its text, or from a link that ends in it.

    Raises:
        ValueError: the text is no game, or has a value out of its range.
    """
    text = unquote(text.partition("#")[2] or text)
    if len(text) > LONGEST:
        raise ValueError(f"a game must have at most {LONGEST:,} characters, got {len(text):,}")
    values = check.from_json("a game", text, dict, finite=True)
    check.known_keys("a game", values, _KEYS)
    if values.get("version") != VERSION or values["version"] is True:
        version = check.shown(values.get("version"))
        raise ValueError(f"a game's version must be {VERSION}, which jackbox {__version__} reads, got {version}")
    try:
        scene = Scene.of(values.get("scene"))
        check.known_keys("a game's scene", values.get("scene") or (), FIELDS)
        task = check.choice("task", values.get("task", "juggle"), TASKS)
        dt = check.real("dt", values.get("dt", 0.02), at_least=0.001, at_most=1.0)
        game = Game(task, scene, dt, _start(scene, values.get("start")))
    except TypeError as error:
        raise ValueError(str(error)) from error
    return _with_steps(game, values) if {*_ARRAYS, "digest"} & {*values} else game


def replay_game(game: Game) -> tuple[int | None, list[PlayedStep]]:
    """Simulate a game by the exact model, and compare each state with the text's.

    Returns:
        The first step whose state differs, counted from 1, or None, and the steps before it. A difference changes the
        byte of its step in 255 of 256 cases, else that of a later step or the digest.

    Raises:
        JackLostError: a step cannot be followed, or the game needs more than 50,000,000 gap evaluations.
    """
    steps = list[PlayedStep]()
    for count, step in enumerate(_simulated(game), 1):
        if step.number >> 56 != game.checks[count - 1] or (count == len(game.shares) and step.number != game.digest):
            return count, steps
        steps.append(step)
    return None, steps


def write_game(
    scene: Scene | Mapping[str, Any] | None,
    start: ArrayLike,
    shares: Iterable[float | None] = (),
    task: str = "juggle",
    dt: float = 0.02,
) -> str:
    """Simulate a game by the exact model, and return its text, which the page of ``jackbox play`` shows too.

    Args:
        scene: differs from the default scene in jack_mass, jack_arm, restitution, gravity, torque_limit and box_mass
            at most.
        start: the state at time 0, shape (12,), every foot inside the box.
        shares: the torque of each step over the torque limit, from -1 to 1, or None for the scene's drive.
        task: juggle, spin or rattle.
        dt: control step [s], from 0.001 to 1.

    Raises:
        TypeError, ValueError: an unusable value, more than 1,000 s, or more than 65,536 characters: those of some
            4,400 steps if every torque is another.
        JackLostError: as :func:`replay_game`.
    """
    scene = Scene.of(scene)
    changes = {name: getattr(scene, name) for name in FIELDS if getattr(scene, name) != getattr(Scene(), name)}
    if Scene(**changes) != scene:
        raise ValueError(f"scene may differ from the default in {', '.join(FIELDS)} only, got {check.shown(scene)}")
    values = {"version": VERSION, "package": __version__, "task": task, "scene": changes, "dt": dt}
    values["start"] = as_start(scene, start).tolist()
    torques = [None if one is None else check.real("a share", one, at_least=-1.0, at_most=1.0) for one in shares]
    if torques:
        hashes = [step.number for step in _simulated(read_game(json.dumps(values))._replace(shares=torques))]
        alike = [list(group) for _, group in groupby(torques, key=repr)]  # which distinguishes -0.0 from 0.0
        runs = [run[begin : begin + _DRIVEN - 1] for run in alike for begin in range(0, len(run), _DRIVEN - 1)]
        counts = [len(run) | _DRIVEN * (run[0] is None) for run in runs]
        arrays = [0.0 if run[0] is None else run[0] for run in runs], counts, [number >> 56 for number in hashes]
        for (name, kind), array in zip(_ARRAYS.items(), arrays, strict=True):
            values[name] = urlsafe_b64encode(np.array(array, kind).tobytes()).decode().rstrip("=")
        values["digest"] = f"{hashes[-1]:016x}"
    text = json.dumps(values, separators=(",", ":"))
    read_game(text)  # refuses another task or dt, and too many steps
    return text


def _simulated(game: Game) -> Iterator[PlayedStep]:
    simulator, number, work = ExactSimulator(game.scene), _BASIS, 0.0
    functions = make_functions(game.scene, Interface(TASKS[game.task]), "exact")
    simulator.reset(game.start)
    for step, share in enumerate(game.shares, 1):
        try:
            torque = None if share is None else share * game.scene.torque_limit
            done = functions.step_and_score(simulator, game.dt, torque, False)
            work += simulator.evaluations
            if work > MOST_WORK:
                raise JackLostError(f"the game needs more than {MOST_WORK:,.0f} gap evaluations")
        except JackLostError as error:
            raise JackLostError(f"step {step:,} of {len(game.shares):,} cannot be followed: {error}") from error
        for word in done.state.view(np.uint64).tolist():
            number = (number ^ word) * _PRIME & _WORD
        yield PlayedStep(done, number)


def _start(scene: Scene, values: Any) -> Array:
    """The state that 12 numbers are, or the one that a generator draws."""
    kinds = {*map(type, values)} if isinstance(values, list) else {None}
    if kinds <= {int, float}:
        for value in values:
            check.real("a number of start", value, at_least=-FARTHEST, at_most=FARTHEST)
        return as_start(scene, values) + 0.0  # no -0, which JSON does not keep
    words = [int(one) for one in values if re.fullmatch("[0-9]{1,20}", one)] if kinds == {str} else []
    if not len(words) == WHOLE == len(values) or max(words) > _WORD or words[-1] % 2 == 0:
        expected = "12 numbers, or 4 words of a generator, each below 2^64 and the last one odd"
        raise ValueError(f"start must be a list of {expected}, got {check.shown(values)}")
    return as_start(scene, sample_start(scene, generator_of(np.array(words, np.uint64))))


def _with_steps(game: Game, values: Mapping[str, Any]) -> Game:
    shares, counts, checks = (_numbers(name, values.get(name), kind) for name, kind in _ARRAYS.items())
    lengths, driven = counts % _DRIVEN, counts >= _DRIVEN
    if not len(shares) == len(counts) > 0 or lengths.min() == 0 or lengths.sum() != len(checks):
        raise ValueError(
            "a game must have a count of at least 1 step for each share, and a check for each step, got "
            f"{len(shares):,} shares, {len(counts):,} counts of {lengths.sum():,} steps, and {len(checks):,} checks"
        )
    if len(checks) * game.dt > MOST_SECONDS:
        raise ValueError(f"a game must last at most {MOST_SECONDS:,.0f} s, got {len(checks) * game.dt:,.10g} s")
    for share in shares[~(np.abs(shares) <= ~driven)].tolist():
        raise ValueError(f"shares must be from -1 to 1, and 0 where the scene's drive acts, got {share}")
    if not re.fullmatch("[0-9a-f]{16}", str(values.get("digest"))):
        raise ValueError(f"digest must be 16 digits of 0-9 and a-f, got {check.shown(values.get('digest'))}")
    runs = zip(shares.tolist(), driven.tolist(), lengths.tolist(), strict=True)
    steps = [None if is_driven else share for share, is_driven, length in runs for _ in range(length)]
    return game._replace(shares=steps, checks=checks.tobytes(), digest=int(str(values["digest"]), 16))


def _numbers(name: str, text: Any, kind: str) -> NDArray[Any]:
    """The array in a text of base64url."""
    size = np.dtype(kind).itemsize
    if isinstance(text, str) and re.fullmatch("([A-Za-z0-9_-]{4})*([A-Za-z0-9_-]{2,3})?", text):
        raw = urlsafe_b64decode(text + "==")
        if len(raw) % size == 0:
            return np.frombuffer(raw, kind)
    raise ValueError(f"{name} must be base64url without padding, of {size} bytes a number, got {check.shown(text)}")
