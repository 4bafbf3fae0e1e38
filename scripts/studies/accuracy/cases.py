"""The cases of the sweep: seeded starts with the exact model as reference, and trajectories known to 60 digits."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from jackbox_env import Scene
from jackbox_env.accuracy import Case, Reference, reference_of
from jackbox_env.simulators import Impact
from jackbox_env.states import Array
from jackbox_env.tasks import sample_start

KINDS = ("chirp", "held", "weightless")  # of seeded cases
DIGITS = "60 digits"  # the kind of those with an independent reference
DT = 0.02  # control step [s]
STEPS = 500  # control steps of a seeded case: 10 s
WEIGHTLESS = Scene(gravity=0.0, drive=None)
_DATA = Path(__file__).parents[3] / "tests" / "data"


def seeded(kind: str, seed: int) -> Case:
    """A case of 10 s: under the chirp, under held random torques, or weightless with neither torque nor gravity.

    The first two start as the environment does. A weightless jack starts with 5 m/s, 5 rad/s and a box at 1 rad/s as
    standard deviations: nothing else would move it.
    """
    rng = np.random.default_rng([KINDS.index(kind), seed])
    scene = WEIGHTLESS if kind == "weightless" else Scene()
    state: Array = sample_start(scene, rng)
    torques = None
    if kind == "held":
        torques = rng.uniform(-scene.torque_limit, scene.torque_limit, STEPS).tolist()
    if kind == "weightless":
        state[8:] = np.array([1.0, 5.0, 5.0, 5.0]) * rng.standard_normal(4)
    return Case(f"{kind} {seed}", scene, state, STEPS, torques, DT)


def seeded_with_references(kind: str, count: int) -> list[tuple[Case, Reference]]:
    """The first ``count`` seeded cases of a kind with the exact model's courses."""
    cases = [seeded(kind, seed) for seed in range(count)]
    return [(case, reference_of(case)) for case in cases]


def known_to_60_digits() -> list[tuple[Case, Reference]]:
    """Trajectories of 5 s (one of 10 s) that were computed with 60 digits, independently of this project."""
    records = [
        record
        for name in ("exact_trajectories", "seed_scene")
        for record in json.loads((_DATA / f"{name}.json").read_text())
    ]
    return [_from_record(record) for record in records]


def _from_record(record: dict[str, Any]) -> tuple[Case, Reference]:
    scene = Scene(gravity=record["gravity"]) if record["drive"] != "none" else WEIGHTLESS
    start = np.array(record["q"] + record["qdot"], dtype=np.float64)
    steps = round(record["T"] / DT)
    torques = None
    if record["drive"] == "held":
        torques = [scene.torque_limit * float(np.float32(action)) for action in record["actions"]]
    times = np.array([0.0] + [entry["time"] for entry in record["states"]])
    states = np.array([start] + [entry["state"] for entry in record["states"]])
    impacts = [Impact(hit["time"], hit["wall"], hit["foot"], hit["impulse"]) for hit in record["impacts"]]
    case = Case(record["name"], scene, start, steps, torques, DT)
    return case, Reference(times, states, impacts, len(impacts))
