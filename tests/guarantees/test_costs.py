"""Features that a scene does not use run no code. Calls are counted; the times are in docs/speed.md.

Counts, unlike times, are the same on every machine. Each of ``PROOFS`` names a function that is called with a feature
and is not called without it. The exact model's code is plain Python that is compiled, so it is counted uncompiled.
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from types import FrameType, FunctionType
from typing import Any, NamedTuple

import numpy as np
import pytest

from jackbox_env.envs.single import JackInBoxEnv
from jackbox_env.envs.vector import JackInBoxVectorEnv
from jackbox_env.exact import run, workspace
from jackbox_env.exact.workspace import new_log
from jackbox_env.jit import compiler as _compiled
from jackbox_env.jit.names import reachable_names, used_names
from jackbox_env.model.scene import Drive, Scene
from jackbox_env.simulators import make_simulator
from tests.states import started

PYMUNK, EXACT, BATCH = "pymunk", "exact", "exact, batch"
STEPS = 60  # counted
SIDE_BY_SIDE = 6  # environments in a batch that is counted
_START = [0.0] * 3 + [0.5, 0.2, 0.3] + [0.0] * 3 + [6.0, -4.0, 2.0]  # the jack moves, so that it bounces also unweighed

Calls = Counter[tuple[str, str]]  # of (caller, function): qualified names without the module
_COUNTED = dict[str, Calls]()  # of steps, by model and settings


def calls_of(run: Callable[[], object]) -> Calls:
    """Count the calls of functions, Python's and others, while ``run`` runs."""
    counts: Calls = Counter()

    def note(frame: FrameType, event: str, called: Any) -> None:
        if event == "call":
            by = frame.f_back
            while by and by.f_code.co_name == "__setattr__":  # pymunk's, which passes the call on
                by = by.f_back
            counts[by.f_code.co_qualname if by else "", frame.f_code.co_qualname] += 1
        elif event == "c_call":
            counts[frame.f_code.co_qualname, getattr(called, "__qualname__", str(called))] += 1

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        run()
    finally:
        sys.setprofile(before)
    return counts


@contextmanager
def uncompiled() -> Iterator[None]:
    """Run compiled functions as plain Python, in all that is made and stepped within the block."""

    def plain(function: FunctionType, instead: tuple[tuple[str, Any], ...], keep: bool) -> FunctionType:
        if reachable_names(function).isdisjoint(dict(instead)):
            return function
        called = {name: function.__globals__.get(name) for name in used_names(function.__code__)}
        ours = {name: plain(one, instead, keep) for name, one in called.items() if isinstance(one, FunctionType)}
        return FunctionType(function.__code__, {**function.__globals__, **ours, **dict(instead)})

    before = _compiled._compiled_once
    _compiled._compiled_once = plain  # type: ignore[assignment]
    try:
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # compiled generators wrap around
            yield
    finally:
        _compiled._compiled_once = before


def times_called(counts: Calls, function: str, caller: str = "") -> int:
    """How often a function was called, by ``caller`` or by any function; the front of a name may be left out."""
    return sum(
        count
        for (by, name), count in counts.items()
        if f".{name}".endswith(f".{function}") and f".{by}".endswith(f".{caller}" if caller else "")
    )


def count_once(model: str, **settings: Any) -> Calls:
    """The same as :func:`count_steps`, counted once for the same settings."""
    key = repr((model, settings))
    if key not in _COUNTED:
        _COUNTED[key] = count_steps(model, **settings)
    return _COUNTED[key]


def count_steps(model: str, driven: bool = False, frames: bool = False, **settings: Any) -> Calls:
    """Count ``STEPS`` control steps from a moving start under random actions, or under the drive.

    Args:
        model: ``PYMUNK``, ``EXACT`` or ``BATCH``.
        driven: whether the scene's drive acts in place of the actions.
        frames: whether a frame is drawn after each step.
        **settings: of the environment.
    """
    contact = "pymunk" if model == PYMUNK else "exact"
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (STEPS, SIDE_BY_SIDE))

    make: Any = partial(JackInBoxVectorEnv, SIDE_BY_SIDE) if model == BATCH else JackInBoxEnv
    with uncompiled():
        env = started(make(contact=contact, **settings), options={"state": np.array(_START)})

        def run() -> None:
            for action in actions:
                env.step(None if driven else action if model == BATCH else action[:1])
                if frames:
                    env.render()

        try:
            return calls_of(run)
        finally:
            env.close()


class Proof(NamedTuple):
    """A function that must run with a feature, and must not run without it."""

    thing: str
    model: str
    what: str  # the function does, in words
    function: str
    without: Mapping[str, Any] = {}
    having: Mapping[str, Any] = {}
    caller: str = ""

    def counts(self) -> tuple[int, int]:
        """Calls without the feature, and with it."""
        without = count_once(self.model, **self.without)
        having = count_once(self.model, **self.having)
        return times_called(without, self.function, self.caller), times_called(having, self.function, self.caller)


def _wave(time: float) -> float:
    return 4000.0 * math.sin(3.0 * time)


_WEIGHTLESS: dict[str, Any] = {"scene": Scene(gravity=0.0)}
_UNDRIVEN: dict[str, Any] = {"scene": Scene(drive=None), "driven": True}
_PUSHED: dict[str, Any] = {"scene": Scene(drive=Drive(force_x=_wave, force_y=_wave))}
_TURNED: dict[str, Any] = {"scene": Scene(drive=Drive(torque=_wave))}
_CHIRP: dict[str, Any] = {"driven": True}
_PICTURE: dict[str, Any] = {"render_mode": "rgb_array"}
_RESTARTS: dict[str, Any] = {"max_episode_steps": 50}
_RANDOM: dict[str, Any] = {**_RESTARTS, "randomize": {"jack_mass": (3.0, 5.0)}}
_CHOSEN: dict[str, Any] = {**_RESTARTS, "randomize": lambda rng: {"jack_mass": rng.uniform(3.0, 5.0)}}
PROOFS = (
    Proof("gravity", PYMUNK, "the engine is given a force", "Body.force", _WEIGHTLESS, {}, "_advance"),
    Proof("drive", PYMUNK, "the engine is given a torque", "Body.torque", _UNDRIVEN, _CHIRP, "_advance"),
    Proof("drive", PYMUNK, "the chirp is averaged", "Chirp.torque_means", {}, _CHIRP),
    Proof("drive", EXACT, "the chirp's powers are worked out", "chirp_piece", {}, _CHIRP),
    Proof("drive", EXACT, "a polynomial is integrated", "integrate", {}, _CHIRP),
    Proof("drive", EXACT, "a polynomial is evaluated", "horner", {}, _CHIRP),
    Proof("drive", EXACT, "a function is interpolated", "function_pieces", _TURNED, {**_TURNED, "driven": True}),
    Proof("drive", BATCH, "the chirp's powers are worked out", "chirp_piece", {}, _CHIRP),
    Proof("side forces", PYMUNK, "a force is averaged", "Drive._means", {}, _PUSHED),
    Proof("side forces", EXACT, "pieces of functions are followed", "function_piece", {}, _PUSHED),
    Proof("side forces", BATCH, "pieces of functions are followed", "function_piece", {}, _PUSHED),
    Proof("infos of a batch", BATCH, "infos are gathered", "ExactBatch._infos", {}, {"with_infos": True}),
    Proof("rendering", PYMUNK, "the renderer records a step", "Renderer.record", {}, _PICTURE),
    Proof("rendering", EXACT, "the renderer records a step", "Renderer.record", {}, _PICTURE),
    Proof("a frame", PYMUNK, "a frame is drawn", "Renderer.render", _PICTURE, {**_PICTURE, "frames": True}),
    Proof("another task", PYMUNK, "its reward is worked out", "rattle", {}, {"task": "rattle"}),
    Proof("another task", EXACT, "its reward is worked out", "rattle", {}, {"task": "rattle"}),
    Proof("drawn scenes", BATCH, "scenes are drawn", "draw_scenes", _RESTARTS, _RANDOM),
    Proof("drawn scenes", BATCH, "scenes are drawn by a function", "Randomization.draw", _RESTARTS, _CHOSEN),
    Proof("drawn scenes", BATCH, "new scenes are written", "SceneTable.set_scenes", _RESTARTS, _RANDOM),
)


MID_AIR = np.array([0.0] * 3 + [0.5, 0.2, 0.3] + [0.0] * 3 + [1.0, -1.0, 2.0])
NEAR_A_WALL = np.array([0.0] * 3 + [5.0, 0.0, 0.3] + [0.0] * 3 + [6.0, -4.0, 2.0])
WEIGHTLESS, UNDRIVEN = Scene(gravity=0.0), Scene(drive=None)


def counted(contact: str, scene: Scene, state: Any, torque: float | None = 1e4) -> Calls:
    """Calls of one step of a simulator from ``state``, nothing compiled."""
    with uncompiled():
        simulator = started(make_simulator(scene, contact), state)
        return calls_of(lambda: simulator.step(0.02, torque))


# -- functions --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("proof", PROOFS, ids=lambda proof: f"{proof.thing}, {proof.model}: {proof.what}")
def test_a_feature_runs_if_it_is_on_and_does_not_if_it_is_off(proof: Proof) -> None:
    without, having = proof.counts()
    assert without == 0
    assert having > 0


@pytest.mark.parametrize(
    ("model", "solved"), [(PYMUNK, "ContactRecorder.__call__"), (EXACT, "resolve"), (BATCH, "resolve")]
)
def test_the_steps_counted_have_impacts_with_weight_and_without(model: str, solved: str) -> None:
    for scene in (Scene(), WEIGHTLESS, UNDRIVEN):
        assert times_called(count_once(model, scene=scene), solved) > 0


@pytest.mark.parametrize(
    ("contact", "function"),
    [("pymunk", "Space.step"), ("exact", "bounds_of"), ("exact", "walls_in_reach"), ("exact", "box_frame")],
)
def test_no_wall_is_checked_in_mid_air(contact: str, function: str) -> None:
    assert times_called(counted(contact, Scene(), MID_AIR), function) == 0
    assert times_called(counted(contact, Scene(), NEAR_A_WALL), function) > 0


# -- what is built, stored and allocated ------------------------------------------------------------------------------


def test_a_batch_records_no_impacts(monkeypatch: pytest.MonkeyPatch) -> None:
    for room in (0, 8):
        monkeypatch.setattr(workspace, "new_log", lambda _, wide, room=room: new_log(room, wide))
        batch = started(
            JackInBoxVectorEnv(4, contact="exact", num_threads=1, with_infos=True), options={"state": NEAR_A_WALL}
        )
        assert (batch.step(np.zeros(4))[4]["impacts"] > 0).all()
        ((_, _, log),) = [call.memory for call in batch._batch._calls[0]]  # type: ignore
        assert len(log) == room
        assert log.any() == (room > 0)  # with room it would record


# -- the counters ------------------------------------------------------------------------------------------------------


def test_the_counters_count() -> None:
    counts = calls_of(lambda: [Scene().mass_diagonal for _ in range(2)])
    assert times_called(counts, "Scene.mass_diagonal") == 2
    assert times_called(counts, "diagonal") == 0
    with uncompiled():
        assert _compiled.compiled(run.run) is run.run
    assert _compiled.compiled(run.run) is not run.run
