"""An interruption of a batch in which every jack lies still, so that a step takes long: heard soon, nothing changed."""

from __future__ import annotations

import math
import signal
import threading
from typing import Any

import numpy as np
import pytest

from jackbox_env import JackInBoxVectorEnv, Scene
from jackbox_env.batches import exact, threads
from jackbox_env.compiled import compiler, glide, loop
from jackbox_env.compiled.status import Status
from scripts.studies.laws.interruptions import same

COUNT = 300 * glide.WIDEST  # environments: more than one thread takes without a pause


def resting(num_threads: int) -> JackInBoxVectorEnv:
    """Jacks that lie on two feet each, after a step."""
    scene = Scene(restitution=0.5, drive=None)
    env = JackInBoxVectorEnv(COUNT, contact="exact", scene=scene, num_threads=num_threads, with_infos=True)
    env.reset(seed=0)
    states = np.zeros((COUNT, 12))
    states[:, 3], states[:, 4] = np.linspace(-4.0, 4.0, COUNT), math.sqrt(0.5) - scene.box_half_width
    states[:, 5] = math.pi / 4.0
    env.set_states(states, 0.0)
    return env


def told(env: JackInBoxVectorEnv) -> list[Any]:
    """All that decides the future of a batch in which no episode ends."""
    held = env._batch.held
    return [held.states, held.times, held.column(glide.STEPS), held.over, env.observations]


@pytest.mark.parametrize("num_threads", [1, 2])
def test_an_interruption_among_jacks_at_rest_is_heard_soon_and_changes_nothing(
    num_threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Compiled code hears nothing. So it has to come back after a part of the step, and is then not called again.
    env, compiled = resting(num_threads), compiler.compiled
    calls, main = list[int](), threading.get_ident()

    def watched(function: Any) -> Any:
        ready = compiled(function)
        if function is not loop.step_blocks:
            return ready

        def call(*given: Any) -> Any:
            ended, number, finished = ready(*given)
            calls.append(ended)
            if threading.get_ident() == main:
                signal.raise_signal(signal.SIGINT)  # as Ctrl-C while it worked
            return ended, number, finished

        return call

    before = told(env)
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores the signal
    try:
        with monkeypatch.context() as patch:
            patch.setattr(exact, "compiled", watched)
            with pytest.raises(KeyboardInterrupt):
                env.step(np.zeros(COUNT))
    finally:
        signal.signal(signal.SIGINT, handler)
    if num_threads == 1:
        assert calls == [Status.PAUSED]
    assert not threads._AT_WORK
    assert same(told(env), before)
