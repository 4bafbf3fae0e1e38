"""Features that a scene does not use run no code. Calls and lines are counted; the times are in docs/costs.md.

Each count comes with its negative control: with the feature, the same code runs.
"""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from jackbox_env.exact import compiler as _compiled
from jackbox_env.exact import run, workspace
from jackbox_env.exact.workspace import new_log
from jackbox_env.scene import Scene
from jackbox_env.simulators import make_simulator
from jackbox_env.vector_env import JackInBoxVectorEnv
from tests.studies.counting import (
    BATCH,
    EXACT,
    PROOFS,
    PYMUNK,
    Calls,
    Proof,
    calls_of,
    count_steps,
    times_called,
    uncompiled,
)

MID_AIR = np.array([0.0] * 3 + [0.5, 0.2, 0.3] + [0.0] * 3 + [1.0, -1.0, 2.0])
NEAR_A_WALL = np.array([0.0] * 3 + [5.0, 0.0, 0.3] + [0.0] * 3 + [6.0, -4.0, 2.0])
WEIGHTLESS, UNDRIVEN = Scene(gravity=0.0), Scene(drive=None)


def counted(contact: str, scene: Scene, state: Any, torque: float | None = 1e4) -> Calls:
    """Calls of one step of a simulator from ``state``, nothing compiled."""
    with uncompiled():
        simulator = make_simulator(scene, contact)
        simulator.reset(state)
        return calls_of(lambda: simulator.step(0.02, torque))


# -- functions --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("proof", PROOFS, ids=lambda proof: f"{proof.thing}, {proof.model}: {proof.what}")
def test_a_feature_runs_if_it_is_on_and_does_not_if_it_is_off(proof: Proof) -> None:
    without, having = proof.counts()
    assert without == 0
    assert having > 0


@pytest.mark.parametrize(("model", "solved"), [(PYMUNK, "Recorder.__call__"), (EXACT, "resolve"), (BATCH, "resolve")])
def test_the_steps_counted_have_impacts_with_weight_and_without(model: str, solved: str) -> None:
    for scene in (Scene(), WEIGHTLESS, UNDRIVEN):
        assert times_called(count_steps(model, scene=scene), solved) > 0


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
        batch = JackInBoxVectorEnv(4, contact="exact", num_threads=1, with_infos=True)
        batch.reset(options={"state": NEAR_A_WALL})
        assert (batch.step(np.zeros(4))[4]["impacts"] > 0).all()
        ((_, _, log),) = [call.memory for call in batch._batch._calls]  # type: ignore[attr-defined]
        assert len(log) == room
        assert log.any() == (room > 0)  # with room it would record


def test_no_renderer_is_loaded_unless_asked_for() -> None:
    code = """
import sys, gymnasium, jackbox_env
def stepped(**settings):
    for env in (gymnasium.make("JackInBox-v0", **settings), gymnasium.make_vec("JackInBox-v0", 2, **settings)):
        env.reset(seed=0)
        env.step(env.action_space.sample())
    return [name for name in ("jackbox_env.render.renderer", "pygame") if name in sys.modules]
print(stepped(contact="pymunk"), stepped(contact="exact"), len(stepped(render_mode="rgb_array")))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[] [] 2"


# -- the counters ------------------------------------------------------------------------------------------------------


def test_the_counters_count() -> None:
    counts = calls_of(lambda: [Scene().mass_diagonal for _ in range(2)])
    assert times_called(counts, "Scene.mass_diagonal") == 2
    assert times_called(counts, "diagonal") == 0
    with uncompiled():
        assert _compiled.compiled(run.run) is run.run
    assert _compiled.compiled(run.run) is not run.run
