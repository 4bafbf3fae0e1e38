"""Batches of random scenes and tasks, drawn by hypothesis, equal their single environments bit for bit."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from jackbox_env import JackInBoxEnv, JackInBoxVectorEnv, Task
from jackbox_env.simulators import CONTACT_MODELS, JackLostError
from tests.batches.several import assert_same, step_alone, unmarked
from tests.invariants.cases import HypothesisDraw, draw_scene, draw_start

STEPS, LIMIT = 15, 7  # control steps, and those of an episode


def height(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float, ...]:
    """How high the jack is, and what the torque costs."""
    return (state[4] - state[1]) / scene.box_half_width, -abs(torque) / scene.torque_limit


def knocks(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float, ...]:
    """Impacts, and the jack's energy of rotation."""
    turning = 0.5 * scene.jack_inertia * state[11] * state[11]
    return impulse / scene.jack_mass, math.sqrt(turning), scene.restitution if impulse > 0.0 else 0.0


TASKS = (Task(("height", "effort"), height), Task(("knock", "turning", "lossy"), knocks))


def scenes_of(draw: HypothesisDraw, dt: float, count: int) -> dict[str, Any]:
    """A scene for each environment, or one for all with ranges of some of its fields."""
    if draw.choice((True, False)):
        return {"scene": [draw_scene(draw, dt) for _ in range(count)]}
    scene = draw_scene(draw, dt)
    length = scene.box_half_width
    ranges = {"box_half_width": (length, length * draw.uniform(1.0, 2.0))}
    for name in ("box_mass", "jack_mass", "gravity", "torque_limit"):
        if draw.choice((True, False)):
            value = getattr(scene, name)
            ranges[name] = value * draw.uniform(0.5, 1.0), value * draw.uniform(1.0, 2.0)
    if draw.choice((True, False)):
        ranges["restitution"] = draw.uniform(0.0, 0.5), draw.uniform(0.5, 1.0)
    return {"scene": scene, "randomize": ranges}


def assert_the_same(batch: JackInBoxVectorEnv, singles: list[JackInBoxEnv], step: int, action: float | None) -> int:
    """Step both and compare all their outputs. Returns the impacts, -1 if both have lost a jack."""
    actions = None if action is None else action * np.linspace(-1.0, 1.0, len(singles))
    each = [None] * len(singles) if actions is None else actions.tolist()
    try:
        seen, rewards, _, ends, infos = batch.step(actions)
    except JackLostError:
        with pytest.raises(JackLostError):
            step_alone(singles, each, step, LIMIT)
        return -1
    assert_same((seen, rewards, ends, unmarked(infos)), step_alone(singles, each, step, LIMIT))
    assert_same(
        (batch.states, batch.scenes), (np.array([env.state for env in singles]), [env.scene for env in singles])
    )
    return int(infos["impacts"].sum())


@pytest.mark.parametrize("contact", CONTACT_MODELS)
def test_a_batch_of_random_scenes_with_a_custom_task_is_its_single_environments(contact: str) -> None:
    counted: Counter[str] = Counter()

    @settings(max_examples=settings.default.max_examples // 4)  # type: ignore[union-attr]
    @given(st.data())
    def is_the_same(data: st.DataObject) -> None:
        draw = HypothesisDraw(data.draw)
        dt, count = 10.0 ** draw.uniform(-2.0, -1.0), draw.randint(1, 4)
        asked = {"contact": contact, "task": draw.choice(TASKS), "control_dt": dt, **scenes_of(draw, dt, count)}
        try:
            batch = JackInBoxVectorEnv(count, LIMIT, with_infos=True, **asked)
            scenes = asked["scene"] if isinstance(asked["scene"], list) else [asked["scene"]] * count
            singles = [JackInBoxEnv(**{**asked, "scene": scene}) for scene in scenes]
        except ValueError as error:  # a scene that pymunk does not solve
            assume("couple the feet so strongly" not in str(error))
            raise
        seed = draw.randint(0, 1000)
        seen, _ = batch.reset(seed=seed)
        np.testing.assert_array_equal(seen, [env.reset(seed=seed + i)[0] for i, env in enumerate(singles)])
        starts = [draw_start(draw, scene, dt) for scene in batch.scenes]
        batch.set_states(np.array(starts), 0.0)
        for env, start in zip(singles, starts, strict=True):
            env.set_state(start, 0.0)
        for step in range(STEPS):
            hits = assert_the_same(batch, singles, step, draw.choice((None, draw.uniform(-1.0, 1.0))))
            if hits < 0:
                counted["lost"] += 1
                return
            counted["impacts"] += hits
        counted["drawn" if "randomize" in asked else "listed"] += 1

    is_the_same()
    assert counted["lost"] <= 0.2 * (counted["drawn"] + counted["listed"]), counted
    assert min(counted[name] for name in ("drawn", "listed", "impacts")) > 5, counted
