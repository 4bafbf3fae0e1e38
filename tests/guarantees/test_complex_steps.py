"""Derivatives of single steps with impacts against complex steps in long double, for random scenes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from jackbox_env import Scene, linearize, make_simulator
from jackbox_env.exact import tangents
from tests.states import Array, inside

FIELDS = tangents.FIELDS
Complex = NDArray[np.clongdouble]
Exact = dict[str, Complex]  # a scene's numbers


def turned(cosine: Complex, sine: Complex, quarters: NDArray[np.int64]) -> tuple[Complex, Complex]:
    """Cosine and sine of an angle and so many quarter turns."""
    q = quarters % 4
    return (np.choose(q, [cosine, -sine, -cosine, sine]), np.choose(q, [sine, cosine, -sine, -cosine]))


def flown(scene: Exact, q: Complex, torque: Complex, s: Complex) -> Complex:
    """States (n, 12) after free flight for ``s``."""
    after, alpha = q.copy(), torque / scene["box_inertia"]
    after[:, :6] += s[:, None] * q[:, 6:]
    after[:, 2] += alpha * s * s / 2
    after[:, 8] += alpha * s
    after[:, 4] -= scene["gravity"] * s * s / 2
    after[:, 10] -= scene["gravity"] * s
    return after


def contact(scene: Exact, q: Complex, pairs: NDArray[np.int64]) -> tuple[Complex, Complex]:
    """Gap and its gradient (n, 6), from the position of the foot and the wall's normal."""
    wall, foot = pairs.T
    nx, ny = turned(np.cos(q[:, 2]), np.sin(q[:, 2]), wall)
    ox, oy = turned(np.cos(q[:, 5]), np.sin(q[:, 5]), foot)
    ox, oy = scene["jack_arm"] * ox, scene["jack_arm"] * oy
    x, y = q[:, 3] - q[:, 0] + ox, q[:, 4] - q[:, 1] + oy
    gap = scene["box_half_width"] - nx * x - ny * y
    return gap, np.stack([nx, ny, ny * x - nx * y, -nx, -ny, nx * oy - ny * ox], axis=1)


def bounced(scene: Exact, q: Complex, pairs: NDArray[np.int64]) -> Complex:
    """The law of impact, with the masses as a matrix."""
    _, row = contact(scene, q, pairs)
    masses = np.stack(
        [scene[name] for name in ("box_mass",) * 2 + ("box_inertia",) + ("jack_mass",) * 2 + ("jack_inertia",)], axis=1
    )
    push = -(1 + scene["restitution"]) * (row * q[:, 6:]).sum(1) / (row * row / masses).sum(1)
    after = q.copy()
    after[:, 6:] += push[:, None] * row / masses
    return after


def stepped(scene: Exact, q: Complex, torque: Complex, dt: float, impacts: Array) -> Complex:
    """States after a step with the impacts (n, m, 3) whose time, wall and foot are known roughly, refined by Newton."""
    since = np.zeros(len(q), np.clongdouble)
    for hit in impacts.transpose(1, 0, 2):
        s, pairs = hit[:, 0] - since, hit[:, 1:].astype(int)
        for _ in range(6):
            there = flown(scene, q, torque, s)
            gap, row = contact(scene, there, pairs)
            s = s - gap / (row * there[:, 6:]).sum(1)
        q, since = bounced(scene, flown(scene, q, torque, s), pairs), since + s
    return flown(scene, q, torque, dt - since)


def complex_steps(scenes: Sequence[Scene], states: Array, torques: Array, dt: float, impacts: Array) -> Array:
    """Derivatives (n, 12, 13 + fields) of a step: imaginary parts of steps from states that are moved by 1e-30 i."""
    columns, tiny = 13 + len(FIELDS), np.longdouble(1e-30)
    derivatives = np.empty((len(states), 12, columns))
    for column in range(columns):
        q, torque = states.astype(np.clongdouble), torques.astype(np.clongdouble)
        numbers = {name: np.array([getattr(one, name) for one in scenes]).astype(np.clongdouble) for name in FIELDS}
        moved = q[:, column] if column < 12 else torque if column == 12 else numbers[FIELDS[column - 13]]
        moved += 1j * tiny
        derivatives[:, :, column] = (stepped(numbers, q, torque, dt, impacts).imag / tiny).astype(float)
    return derivatives


def random_scene(rng: np.random.Generator) -> Scene:
    box, jack = 10.0 ** rng.uniform(-1.0, 3.0, 2)
    arm = rng.uniform(0.05, 0.9)
    return Scene(
        box_half_width=1.0, jack_arm=arm, box_mass=box, jack_mass=jack, box_inertia=box * rng.uniform(0.3, 2.0),
        jack_inertia=jack * arm**2 * rng.uniform(0.3, 2.0), gravity=rng.uniform(0.0, 20.0),
        restitution=rng.choice([1.0, rng.uniform(0.2, 1.0)]), drive=None,
    )  # fmt: skip


@pytest.mark.skipif(bool(np.finfo(np.longdouble).eps > 1e-18), reason="long double is no wider than double here")
def test_random_steps_with_impacts_equal_complex_steps_in_long_double(cases: Any) -> None:
    rng, dt, wanted = np.random.default_rng(0), 0.1, cases(10_000)
    made: dict[int, list[tuple[Scene, Array, float, Array]]] = {}
    while sum(map(len, made.values())) < wanted:
        scene = random_scene(rng)
        simulator, torque = make_simulator(scene, contact="exact"), scene.box_inertia * rng.uniform(-20.0, 20.0)
        for _ in range(20):
            start = inside(scene, rng, 3.0)
            simulator.reset(start)
            simulator.step(dt, torque)
            hits = np.array([(hit.time, hit.wall, hit.foot) for hit in simulator.impacts])
            if 0 < len(hits) <= 6:
                made.setdefault(len(hits), []).append((scene, start, torque, hits))
    smooth, errors = 0, []
    for chosen in made.values():
        scenes, states, torques, impacts = map(list, zip(*chosen, strict=True))
        lin = linearize(scenes, np.array(states), np.array(torques)[:, None], dt, fields=FIELDS)
        is_smooth = lin.smooth[:, 0]
        every = np.concatenate([lin.A[:, 0], lin.B[:, 0, :, None], lin.P[:, 0]], axis=2)
        assert (np.isfinite(every).all(axis=(1, 2)) == is_smooth).all()
        assert (np.isnan(every).all(axis=(1, 2)) == ~is_smooth).all()
        smooth += is_smooth.sum()
        if is_smooth.any():
            followed = [one for one, use in zip(scenes, is_smooth, strict=True) if use]
            rows, held, hits = (np.array(values)[is_smooth] for values in (states, torques, impacts))
            expected = complex_steps(followed, rows, held, dt, hits)
            largest = abs(expected[:, :, :12]).max(axis=(1, 2))
            error = abs(every[is_smooth] - expected).max(axis=1) / abs(expected).max(axis=1)
            errors += list(zip(error.max(axis=1), largest, strict=True))
    relative, largest = np.array(errors).T
    assert smooth > 0.99 * wanted
    assert (relative <= 5e-13 * np.maximum(1.0, largest)).all()
    assert np.median(relative) < 1e-14
