"""Interrupts a batch on two threads at random moments: ``python -m tests.guarantees.interrupting SIGALRM 100000``.

It fails on any error but KeyboardInterrupt, if it hangs, if environments are half changed, or if results differ from an
uninterrupted batch's.
"""

from __future__ import annotations

import faulthandler
import os
import random
import signal
import sys
import time
from typing import Any

import numpy as np

from jackbox_env import JackInBoxVectorEnv, rollout

_ENVS, _HANGS, _CHECKED = 640, 60.0, 500  # environments; [s]; interrupts between two comparisons
_ACTIONS, _TORQUES = np.linspace(-1.0, 1.0, _ENVS), np.linspace(-9e4, 9e4, 5 * _ENVS).reshape(_ENVS, 5)


class Interrupts:
    """Raises KeyboardInterrupt at signals, as often as it is armed for, and counts."""

    def __init__(self) -> None:
        self.count, self._armed = 0, 0

    def __call__(self, *_: Any) -> None:
        """Handle a signal."""
        if self._armed:
            self._armed, self.count = self._armed - 1, self.count + 1
            raise KeyboardInterrupt

    def during(self, work: Any) -> bool:
        """Call ``work``, perhaps interrupted, in a quarter of the calls perhaps twice; return whether it ended."""
        try:
            try:
                self._armed = random.choice((1, 1, 1, 2))
                work()
            finally:
                self._armed = 0
        except KeyboardInterrupt:
            self._armed = 0
            return False
        return True


def send(name: str) -> int:
    """Send this process a signal about every 0.3 ms, by its timer or from a child, whose number is returned."""
    if name == "SIGALRM":
        signal.setitimer(signal.ITIMER_REAL, 0.00031, 0.00031)
        return 0
    parent, child = os.getpid(), os.fork()
    while child == 0:
        time.sleep(random.uniform(0.0, 0.0004))
        if os.getppid() != parent:
            os._exit(0)
        os.kill(parent, getattr(signal, name))
    return child


def made() -> JackInBoxVectorEnv:
    env = JackInBoxVectorEnv(_ENVS, 50, "SAME_STEP", num_threads=2, contact="exact", randomize={"gravity": (5.0, 15.0)})
    env.reset(seed=0)
    return env


def shown(env: JackInBoxVectorEnv) -> list[bytes]:
    return [values.tobytes() for values in (env.field("gravity"), env.states, env.times)]


def outcomes(env: JackInBoxVectorEnv, starts: Any) -> list[bytes]:
    """What an environment and a rollout return after a reset."""
    env.reset(seed=3)
    steps = [part for _ in range(3) for part in env.step(_ACTIONS)[:4]]
    return [part.tobytes() for part in [*steps, env.states, rollout(None, starts, _TORQUES, 0.02, num_threads=2)]]


def main(name: str, count: int) -> None:
    env, twin = made(), made()  # the twin is never interrupted
    starts, expected = env.states, outcomes(env, env.states)
    outcomes(twin, starts)
    calls = [
        *[lambda one: one.step(_ACTIONS)] * 15,
        lambda one: one.reset(seed=1),
        lambda one: one.reset(options={"reset_mask": _ACTIONS > 0.0}),
        lambda one: one.set_states(starts, 0.5, _ACTIONS > 0.0),
        *[lambda _: rollout(None, starts, _TORQUES, 0.02, num_threads=2)] * 4,
    ]
    interrupts, cut, checks = Interrupts(), 0, 0
    signal.signal(getattr(signal, name), interrupts)
    child = send(name)
    try:
        while interrupts.count < count:
            faulthandler.dump_traceback_later(_HANGS, exit=True)
            call, before = random.choice(calls), shown(env)
            ended = interrupts.during(lambda call=call: call(env))
            if ended or shown(env) != before:
                cut += not ended
                call(twin)
            assert shown(env) == shown(twin), f"half changed after {interrupts.count} interrupts"
            if interrupts.count >= _CHECKED * (checks + 1):
                checks += 1
                for one in (env, twin):
                    assert outcomes(one, starts) == expected, f"results differ after {interrupts.count} interrupts"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        if child:
            os.kill(child, signal.SIGKILL)
    print(f"{interrupts.count} interrupts by {name}, {cut} after the change, {checks} comparisons")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
