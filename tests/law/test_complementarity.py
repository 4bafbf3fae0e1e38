"""Several dependent contacts at once: the same answer on every processor."""

from __future__ import annotations

import hashlib
import math
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from jackbox_env import complementarity
from jackbox_env.compiled import impacts
from jackbox_env.compiled.workspace import STATE, new_workspace
from jackbox_env.mechanics import energy, gap_jacobian, gaps, impact_map, simultaneous_impact_map
from jackbox_env.scene import Scene
from jackbox_env.states import Array

FOUR = [(0, 0), (1, 1), (2, 2), (3, 3)]  # contacts of a wedged jack: of rank 3


def wedged(count: int) -> Iterator[tuple[Scene, Array]]:
    """States of a jack a little longer than the box's half width, with feet 0 to 3 at walls 0 to 3."""
    rng = np.random.default_rng(5)
    for case in range(count):
        arm = 6.0 * (1.0 + 10.0 ** rng.uniform(-4.0, -1.3))
        state = np.zeros(12)
        state[5] = math.acos(6.0 / arm)
        if case % 3 == 0:
            state[6:] = rng.standard_normal(6)
        elif case % 3 == 1:
            state[6:] = rng.integers(-2, 3, 6)  # ties
        else:
            state[9:] = rng.uniform(0.0, 0.2), rng.uniform(0.5, 1.5), -rng.uniform(0.5, 1.5)
        if case % 2:
            state[[2, 5]] += rng.uniform(-3.0, 3.0)
        yield Scene(gravity=0.0, drive=None, jack_arm=arm), state


def digest(count: int) -> str:
    """Digest of every bit of the law's results for such states."""
    words = []
    for scene, state in wedged(count):
        after, impulses = simultaneous_impact_map(scene, state, FOUR)
        rows = [gap_jacobian(scene, state, wall, foot) for wall, foot in FOUR]
        one, impulse = impact_map(scene, state, 0, 0)
        words += [after.tobytes(), impulses.tobytes(), gaps(scene, state).tobytes(), np.array(rows).tobytes()]
        words += [one.tobytes(), impulse.hex().encode()]
    return hashlib.sha256(b"".join(words)).hexdigest()


def kernels() -> list[str]:
    """Kernels of OpenBLAS that this processor can run."""
    flags = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    able = {"Prescott": " pni", "Haswell": " fma", "SkylakeX": " avx512f"}
    return [name for name, flag in able.items() if f"{flag} " in flags]


def test_the_law_has_the_same_bits_with_every_kernel_of_the_linear_algebra() -> None:
    command = [sys.executable, "-c", "from tests.law.test_complementarity import digest; print(digest(60))"]
    expected = digest(60)
    for kernel in kernels():
        surroundings = {**os.environ, "OPENBLAS_CORETYPE": kernel, "PYTHONPATH": os.pathsep.join(sys.path)}
        run = subprocess.run(command, env=surroundings, capture_output=True, text=True, check=True)
        assert run.stdout.strip() == expected, kernel


def compiled_law(scene: Scene, state: Array) -> Array:
    """The velocities after, by the exact contact model's own projection."""
    w = new_workspace()
    w[STATE, :12] = state
    impacts.resolve(scene.numbers, w, 1e-9, 0, 0)
    return w[STATE, 6:12].copy()


def test_a_wedged_jack_gets_the_velocities_of_the_exact_model_and_keeps_its_energy() -> None:
    several = 0
    for scene, state in wedged(200):
        after, impulses = simultaneous_impact_map(scene, state, FOUR)
        expected = compiled_law(scene, state)
        np.testing.assert_allclose(after[6:], expected, rtol=0.0, atol=1e-12 * max(1.0, np.abs(expected).max()))
        assert energy(scene, after) == pytest.approx(energy(scene, state), rel=1e-13)
        assert np.count_nonzero(impulses) <= 3
        several += int(np.count_nonzero(impulses) > 1)
    assert several > 100


def test_contacts_that_depend_on_those_that_push_stay_out(monkeypatch: pytest.MonkeyPatch) -> None:
    # Beside the contacts that push only rounding is left of their gradients. Let in, they share the impulse arbitrarily
    # or divide by 0.
    def most_pushing() -> int:
        rng, most = np.random.default_rng(18), 0
        for _ in range(60):
            state = np.array([0.0, 0.0, 0.0, 3.0, 4.0, math.pi / 4.0, *rng.integers(-2, 3, 6)])
            listed = [(int(place) // 4, int(place) % 4) for place in rng.permutation(16)[:10]]
            most = max(most, int(np.count_nonzero(simultaneous_impact_map(Scene(), state, listed)[1])))
        return most

    assert most_pushing() == 3
    monkeypatch.setattr(complementarity, "_spanned", lambda rows, row: False)
    with np.errstate(invalid="ignore", divide="ignore"):
        assert most_pushing() > 3


def test_the_order_of_a_corners_contacts_leaves_the_velocities() -> None:
    # Four contacts of rank 3: which three push is one choice of several, the velocities are the only ones.
    scene = Scene(gravity=0.0, drive=None)
    depth = 6.0 - math.sqrt(0.5)
    rng = np.random.default_rng(6)
    for _ in range(50):
        state = np.zeros(12)
        state[3:6] = depth, depth, math.pi / 4.0
        state[6:] = rng.integers(-2, 3, 6)
        contacts = [(0, 0), (0, 3), (1, 0), (1, 1)]
        expected = compiled_law(scene, state)
        for order in (contacts, contacts[::-1], [contacts[place] for place in rng.permutation(4)]):
            after, impulses = simultaneous_impact_map(scene, state, order)
            np.testing.assert_allclose(after[6:], expected, rtol=0.0, atol=1e-13)
            assert np.count_nonzero(impulses) <= 3
