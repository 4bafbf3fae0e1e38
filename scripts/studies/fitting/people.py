"""Recordings as people make them: boxes of 8 cm to 6 m, cameras of 30 to 240 frames a second, masses nobody knows.

The start of a fit has the masses wrong by up to a factor of 4, and restitution 1. Up to 2 % of the rows are bad: a
tracker lost the jack, or found something else. The recordings with ``verdict`` are others, drawn before anything was
tuned.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from jackbox_env import Fit, Recording, Scene, fit
from jackbox_env.fits.faults import DELAY, GAIN, spoilt
from jackbox_env.model.states import OMEGA_BOX, RATES, THETA_BOX, THETA_JACK, X_BOX, X_JACK, Y_BOX, Y_JACK, Array
from scripts.studies.fitting.measured import followed, thrown

RATES_OF_CAMERAS = (30.0, 60.0, 120.0, 240.0)  # frames a second
_FALL = 8.0  # frames in the fall of half a width, at least
WRONG = {"gravity": 1.01, "jack_arm": 1.01, "box_half_width": 1.01}  # in the start of a fit, times the true value
LATE = "torques 5 ms late"
WRONGS = *WRONG, "torques 3 % too large", LATE
_LARGE = 1.0  # [m] half width, above which a table is not tilted


def scene_of_people(rng: np.random.Generator, sizes: tuple[float, float]) -> Scene:
    """A box of any size, upright or on a tilted table, and a jack, in half of the scenes with an inertia of its own."""
    length = float(np.exp(rng.uniform(*map(np.log, sizes))))
    tilted = length < _LARGE and rng.random() < 0.5
    gravity = 9.81 * (np.sin(np.radians(rng.uniform(3.0, 12.0))) if tilted else 1.0)
    mass, arm = 0.5 * (length / 0.15) ** 2 * np.exp(rng.uniform(-0.5, 0.5)), length * rng.uniform(0.15, 0.4)
    jack_mass = mass * np.exp(rng.uniform(np.log(0.02), np.log(0.3)))
    return Scene(
        gravity=gravity, box_half_width=length, box_mass=mass, box_inertia=mass * length**2 * rng.uniform(0.5, 1.0),
        jack_mass=jack_mass, jack_arm=arm, restitution=rng.uniform(0.5, 0.98), drive=None,
        jack_inertia=jack_mass * arm**2 * rng.uniform(0.3, 1.0) if rng.random() < 0.5 else None,  # type: ignore[arg-type]
    )  # fmt: skip


def with_bad_rows(seen: Array, share: float, length: float, rng: np.random.Generator) -> Array:
    """Positions, (H + 1, 6), with a share of bad rows: other places, zeros, or nothing."""
    rows = np.flatnonzero(rng.random(len(seen)) < share)
    for row in rows[rows > 0]:
        kind = int(rng.integers(3))
        if kind == 0:
            angle, far = rng.uniform(0.0, 2.0 * np.pi), length * np.exp(rng.uniform(np.log(0.02), 0.0))
            seen[row, X_JACK : Y_JACK + 1] += far * np.array([np.cos(angle), np.sin(angle)])
        else:
            seen[row, X_JACK : THETA_JACK + 1] = 0.0 if kind == 1 else np.nan
    return seen


def recorded_by_people(
    seed: int, verdict: bool, sizes: tuple[float, float] = (0.08, 6.0), hardest: float = np.inf
) -> tuple[Scene, Scene, tuple[str, ...], Recording]:
    """A scene with a half width within sizes [m], the fit's start, the fields to fit, and a recording.

    A motor pushes by up to twice g / L, and of ``hardest`` [rad/s^2].
    """
    rng = np.random.default_rng((61, int(verdict), seed))
    scene = scene_of_people(rng, sizes)
    length, arm = scene.box_half_width, scene.jack_arm
    fall = np.sqrt(2.0 * length / scene.gravity)
    rate = float(rng.choice([one for one in RATES_OF_CAMERAS if fall * one >= _FALL] or RATES_OF_CAMERAS[-1:]))
    steps, pushed, box_seen = round(rng.uniform(4.0, 20.0) * rate), rng.random() < 0.5, rng.random() < 0.5

    def motor(state: Array) -> float:
        push = rng.uniform(-2.0, 2.0) * min(scene.gravity, hardest * length) / length
        return float(scene.box_inertia * (push - state[OMEGA_BOX] - state[THETA_BOX]))  # keeps it from spinning

    states, torques = followed(scene, thrown(scene, rng), rate, steps, motor if pushed else None)
    noise = length * np.exp(rng.uniform(np.log(5e-4), np.log(3e-3)))
    noises = np.array([noise, noise, np.radians(rng.uniform(0.1, 0.5))] * 2)  # [m], [rad]
    noises[THETA_JACK] = max(noises[THETA_JACK], 0.3 * noise / arm)
    seen = states[:, :RATES] + noises * rng.standard_normal((steps + 1, RATES))
    seen = with_bad_rows(seen, rng.uniform(0.0, 0.02) * rng.integers(2), length, rng)
    if not box_seen:
        seen[:, X_BOX : Y_BOX + 1] = np.nan
    rows = np.full((steps + 1, 12), np.nan)
    rows[:, :RATES] = seen
    fields = ("jack_mass", *(() if scene.derived else ("jack_inertia",)), "restitution")
    factors = np.exp(rng.uniform(-np.log(4.0), np.log(4.0)) + np.array([0.0, rng.uniform(-0.3, 0.3)]))
    wrong = {name: getattr(scene, name) * factor for name, factor in zip(fields[:-1], factors.tolist(), strict=False)}
    return scene, scene.changed(**wrong, restitution=1.0), fields, Recording(rows, torques, 1.0 / rate)


def spoilt_by(wrong: str, start: Scene, recording: Recording) -> tuple[Scene, Recording] | None:
    """The start with a wrong field, or the recording with wrong torques; None if no torque acts that could be wrong."""
    if not wrong:
        return start, recording
    if wrong in WRONG:
        return start.changed(**{wrong: WRONG[wrong] * getattr(start, wrong)}), recording
    if not np.any(recording.torques):
        return None
    return start, spoilt(recording, *((DELAY, 0.005) if wrong == LATE else (GAIN, 0.03)))


def fitted_by_people(seed: int, verdict: bool, true_start: bool, wrong: str = "") -> dict[str, Any] | None:
    """One fit: whether it converged, how far each field is from the truth in standard deviations, and its problems.

    ``wrong``: what else is wrong, one of ``WRONGS``; None if that cannot be.
    """
    scene, start, fields, recording = recorded_by_people(seed, verdict)
    spoilt_start = spoilt_by(wrong, scene if true_start else start, recording)
    if spoilt_start is None:
        return None
    began = time.process_time()
    try:
        estimate = fit(spoilt_start[1], fields, spoilt_start[0])
    except ValueError as error:  # no motion could be followed
        estimate = Fit(start, {}, np.zeros(0), (), problems=(str(error),))
    seconds, deviations = time.process_time() - began, dict[str, float]()
    for name, (low, high) in estimate.intervals.items():
        if np.isfinite(high) and (low, high) != (0.0, 1.0):
            deviations[name] = 3.92 * (getattr(estimate.scene, name) - getattr(scene, name)) / max(high - low, 1e-300)
    contain = [low <= getattr(scene, name) <= high for name, (low, high) in estimate.intervals.items()]
    return {
        "seed": seed, "verdict": verdict, "true_start": true_start, "wrong": wrong, "seconds": seconds,
        "contain": contain, "length": len(recording.states) * recording.dt, "converged": bool(estimate.converged),
        "problems": estimate.problems, "deviations": deviations, "left_out": estimate.left_out,
        "hidden": wrong in WRONG and estimate.converged and _hidden(wrong, fields, *spoilt_start),
    }  # fmt: skip


def _hidden(wrong: str, fields: tuple[str, ...], start: Scene, recording: Recording) -> bool:
    """Whether the wrong value agrees with the recording, too: it is in the interval of a fit of it with the others."""
    freed = fit(recording, (*fields, wrong), start)
    low, high = freed.intervals[wrong]
    return freed.converged and low <= getattr(start, wrong) <= high
