"""Interrupts a fresh process as it compiles the exact model: ``python -m tests.guarantees.interrupting_compiler SEED``.

It prints the number of interrupts, and the digest of steps after them.
"""

from __future__ import annotations

import random
import signal
import sys

from jackbox_env import make_simulator

_TIMES = [(0.0, 3.0), *[(0.0, 12.0)] * 4]  # [s] of processor time until an interrupt; at first numba is imported


def steps() -> str:
    """Digest of the first exact steps."""
    from tests.fingerprints import digest  # imports numba

    simulator = make_simulator(contact="exact")
    for _ in range(20):
        simulator.step(0.02, 3e4)
    return digest([simulator.state])


def main(seed: int) -> None:
    rng, interrupts = random.Random(seed), 0
    signal.signal(signal.SIGPROF, signal.default_int_handler)
    for least, most in _TIMES:
        try:
            signal.setitimer(signal.ITIMER_PROF, rng.uniform(least, most))
            make_simulator(contact="exact").step(0.02, 3e4)
            signal.setitimer(signal.ITIMER_PROF, 0.0)
        except KeyboardInterrupt:
            interrupts += 1
    print(interrupts, steps())


if __name__ == "__main__":
    main(int(sys.argv[1]))
