"""PPO across scenes: trained on one scene and on scenes that vary, both evaluated on a grid of scenes."""

from __future__ import annotations

import dataclasses
import json
from itertools import product
from pathlib import Path
from typing import Any

from agents.evaluation.returns import evaluate
from agents.policies.registry import find_policy
from agents.policies.scripted import LevelPolicy, Policy
from agents.settings import DEMO, TrainSettings
from agents.training.models import load_model
from agents.training.ppo import trained_in
from jackbox_env import Scene
from jackbox_env.recording.files import write_json

RESTITUTIONS = (1.0, 0.9, 0.8, 0.7)
MASSES = (2.0, 4.0, 8.0, 16.0)  # of the jack [kg]
RANGES = {"jack_mass": [MASSES[0], MASSES[-1]], "restitution": [RESTITUTIONS[-1], RESTITUTIONS[0]]}
TRAININGS: dict[str, TrainSettings] = {
    "one scene": DEMO,
    "varied scenes": dataclasses.replace(DEMO, randomize=json.dumps(RANGES)),
}


def grid() -> list[dict[str, float]]:
    """The scenes' fields."""
    return [{"restitution": restitution, "jack_mass": mass} for restitution, mass in product(RESTITUTIONS, MASSES)]


def across(kept: Path, episodes: int, seed: int) -> list[dict[str, Any]]:
    """What a level box and both trainings earn in each scene; the trainings and rows are kept in a folder."""
    policies: dict[str, Policy] = {}
    for name, settings in TRAININGS.items():
        run = kept / f"trained-on-{name.replace(' ', '-')}"
        trained_in(run, settings)
        policies[name] = load_model(run)
    rows = []
    for fields in grid():
        file = kept / f"across-{fields['restitution']:g}-{fields['jack_mass']:g}-{episodes}.json"
        if not file.exists():
            in_scene = dataclasses.replace(DEMO, scene=json.dumps(fields))
            level = find_policy("level", in_scene, seed).policy
            assert isinstance(level, LevelPolicy)
            earned = {
                name: evaluate(name, policy, in_scene.env_settings, episodes, seed).as_json()
                for name, policy in {"level": level, **policies}.items()
            }
            write_json(file, {"scene": fields, "earned": earned})
        rows.append(json.loads(file.read_text()))
        print(f"restitution {fields['restitution']:g}, jack of {fields['jack_mass']:g} kg", flush=True)
    return rows


def is_default(fields: dict[str, float]) -> bool:
    """Whether these are the default scene's values."""
    return Scene.of(dict(fields)) == Scene()
