"""The cases of the sweep: seeded starts with the exact model as reference, and trajectories known to 60 digits."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from jackbox_env import Scene
from jackbox_env.measure.accuracy import Case, Reference, reference_of
from jackbox_env.simulators import Impact
from jackbox_env.states import Array
from jackbox_env.tasks import sample_start

KINDS = ("chirp", "held", "weightless")  # of seeded cases
DIGITS, LOSS = "60 digits", "60 digits, with loss"  # kinds of those with an independent reference
DT = 0.02  # control step [s]
STEPS = 500  # control steps of a seeded case: 10 s
WEIGHTLESS = Scene(gravity=0.0, drive=None)
_FILES = {DIGITS: ("exact_trajectories.json", "seed_scene.json"), LOSS: ("loss_trajectories.json",)}
_DATA = Path(__file__).parents[3] / "tests" / "data"


def seeded(kind: str, seed: int) -> Case:
    """A case of 10 s: under the chirp, under random torques, each held for a step, or weightless without torque.

    The first two start as the environment does. A weightless jack gets random rates, of standard deviation 5 m/s and
    5 rad/s, and its box 1 rad/s: nothing else would move them.
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


def with_references(kind: str, count: int) -> list[tuple[Case, Reference]]:
    """The cases of a kind: all that are known to 60 digits, or ``count`` seeded ones with the exact model's courses."""
    if kind in _FILES:
        return [_from_record(record) for file in _FILES[kind] for record in json.loads((_DATA / file).read_text())]
    cases = [seeded(kind, seed) for seed in range(count)]
    return [(case, reference_of(case)) for case in cases]


def _from_record(record: dict[str, Any]) -> tuple[Case, Reference]:
    """A trajectory of 3 to 10 s that was computed with 60 digits, independently of this project."""
    driven = record["drive"] != "none"
    scene = Scene(gravity=record["gravity"], restitution=record.get("restitution", 1.0)) if driven else WEIGHTLESS
    start = np.array(record["q"] + record["qdot"], dtype=np.float64)
    torques = None
    if record["drive"] == "held":
        torques = [scene.torque_limit * float(np.float32(action)) for action in record["actions"]]
    times = np.array([0.0] + [entry["time"] for entry in record["states"]])
    states = np.array([start] + [entry["state"] for entry in record["states"]])
    impacts = [Impact(hit["time"], hit["wall"], hit["foot"], hit["impulse"]) for hit in record["impacts"]]
    case = Case(record["name"], scene, start, round(record["T"] / DT), torques, DT)
    return case, Reference(times, states, impacts, len(impacts))
