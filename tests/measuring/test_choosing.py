"""Named fidelities, and `cheapest`, which measures the cheapest setting within error bounds."""

from __future__ import annotations

import itertools
import math
from dataclasses import asdict
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from agents.settings import EnvSettings, setting_of
from jackbox_env import Scene, cheapest
from jackbox_env.measure import choosing
from jackbox_env.simulators.fidelity import Setting, resolve

WEIGHTLESS = {"gravity": 0.0, "drive": None}


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        ({}, Setting("pymunk", None)),
        ({"fidelity": "coarse"}, Setting("pymunk", 2)),
        ({"fidelity": "balanced"}, Setting("pymunk", 4)),
        ({"fidelity": "fine"}, Setting("pymunk", 64)),
        ({"fidelity": "exact"}, Setting("exact", None)),
        ({"fidelity": "fine", "contact": "pymunk", "substeps": np.int64(64)}, Setting("pymunk", 64)),
        ({"fidelity": "exact", "contact": "exact"}, Setting("exact", None)),
        ({"contact": "exact"}, Setting("exact", None)),
    ],
)
def test_a_name_stands_for_a_setting(arguments: dict[str, Any], meant: Setting) -> None:
    assert resolve(**{"fidelity": None, "contact": None, "substeps": None, **arguments}) == meant
    assert gym.make("JackInBox-v0", **arguments).unwrapped.contact == meant.contact  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("stored", "meant"),
    [
        ({}, Setting("exact")),
        ({"substeps": 8}, Setting("pymunk", 8)),
        ({"substeps": 4}, Setting("pymunk", 4)),
        ({"contact": "pymunk"}, Setting("pymunk", 4)),
        ({"contact": "exact", "fidelity": None}, Setting("exact")),
        ({"contact": "pymunk", "substeps": None}, Setting("pymunk", 4)),
        ({"contact": "pymunk", "fidelity": "fine"}, Setting("pymunk", 64)),
        ({"fidelity": "exact"}, Setting("exact")),
    ],
)
def test_stored_settings_are_read_again(stored: dict[str, Any], meant: Setting) -> None:
    settings = EnvSettings.of(stored)
    assert setting_of(settings.env_settings) == meant
    assert EnvSettings.of(asdict(settings)) == settings


# -- the helper --------------------------------------------------------------------------------------------------------


def test_tighter_bounds_choose_more_substeps_of_pymunk() -> None:
    bounds = (0.02, 0.003, 0.0002)  # one substep is a control step of 0.02 s: the first impact waits for its end
    arguments: dict[str, Any] = {"scene": {"restitution": 0.5}, "cases": 2, "contact": "pymunk"}
    chosen = [cheapest(**arguments, first_impact_error=bound) for bound in bounds]
    substeps = [choice.setting.substeps or 0 for choice in chosen]
    assert 1 == substeps[0] < substeps[1] < substeps[2]
    for choice, bound in zip(chosen, bounds, strict=True):
        assert 0.0 < choice.first_impact_error <= bound
        assert choice.microseconds > 0.0
    # a foot moves at about 10 m/s into the wall for up to h
    assert 0.05 < chosen[0].penetration < 1.0
    assert chosen[2].penetration < 0.02


def test_the_exact_model_is_chosen_where_nothing_else_will_do() -> None:
    for arguments in ({"scene": {"restitution": 0.5}, "first_impact_error": 1e-9}, {"penetration": 1e-9}):
        assert cheapest(**arguments, cases=2, steps=80).setting == Setting("exact", None)


def test_of_two_that_will_do_the_one_that_takes_less_time_is_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    loose: dict[str, Any] = {"first_impact_error": 0.02, "penetration": 1.0, "cases": 2}
    assert cheapest(**loose).setting == Setting("exact", None)  # some 8 times cheaper than any of pymunk
    monkeypatch.setattr(choosing, "_costs", lambda settings, cases: [float(one.contact == "exact") for one in settings])
    assert cheapest(**loose).setting == Setting("pymunk", 1)


def test_feet_that_touch_together_are_the_first_impact_in_any_order(monkeypatch: pytest.MonkeyPatch) -> None:
    # straight into a corner: pymunk lets one of four redundant contacts go without impulse
    start = np.zeros(12)
    start[[5, 9, 10]] = math.pi / 4.0, 3.0, 3.0
    scene = {**WEIGHTLESS, "torque_limit": 1e-9, "restitution": 0.9}
    monkeypatch.setattr(choosing, "sample_start", lambda scene, rng: start)
    chosen = cheapest(scene, cases=1, steps=200, contact="pymunk")
    assert chosen.setting == Setting("pymunk", 1)


def test_settings_that_lose_the_jack_or_hit_elsewhere_will_not_do_whatever_the_bounds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # 1000 times the torque: coarse substeps of pymunk lose the jack after their first impact, which is the right one
    wild = cheapest({"torque_limit": 9e7, "restitution": 0.5}, cases=1, steps=80, contact="pymunk")
    # a jack that turns by a quarter in each control step: dips into walls that no step of pymunk sees
    spinner = np.zeros(12)
    spinner[[3, 5, 11]] = 0.35, math.pi / 4.0, math.pi / 2.0 / 0.02
    scene = {**WEIGHTLESS, "box_half_width": 0.8, "jack_arm": 0.5, "torque_limit": 1e-9, "restitution": 0.99}
    monkeypatch.setattr(choosing, "sample_start", lambda scene, rng: spinner)
    for chosen, lost in ((wild, 2), (cheapest(scene, cases=1, steps=50, contact="pymunk"), 1)):
        assert (chosen.setting.substeps or 0) > lost
        assert math.isfinite(chosen.first_impact_error + chosen.penetration)


def test_the_exact_model_is_not_blamed_for_steps_too_long_to_inspect() -> None:
    chosen = cheapest(control_dt=1.0, cases=2, steps=20, penetration=0.01, first_impact_error=0.001)
    assert chosen.setting == Setting("exact", None)
    assert chosen.penetration < 1e-9


# -- several scenes ----------------------------------------------------------------------------------------------------


def test_one_setting_keeps_the_bounds_in_every_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    """The torques are negligible, so the cases of both scenes together are those of each alone."""
    scenes = [Scene(drive=None, torque_limit=1e-9, restitution=0.5, gravity=gravity) for gravity in (0.5, 9.81)]
    starts = [height * np.eye(12)[4] + 0.3 * np.eye(12)[5] for height in (-1.0, 0.5)]
    in_turn = {scene.gravity: itertools.cycle(starts) for scene in scenes}
    monkeypatch.setattr(choosing, "sample_start", lambda scene, rng: next(in_turn[scene.gravity]))
    settings: dict[str, Any] = {"penetration": 0.03, "contact": "pymunk"}
    coarse, fine = sorted((cheapest(scene, cases=2, **settings) for scene in scenes), key=lambda one: one.setting)
    assert coarse.setting != fine.setting
    for together in (scenes, scenes[::-1]):
        both = cheapest(together, cases=4, **settings)
        assert (both.setting, both.cases) == (fine.setting, 4)
        assert both.penetration == pytest.approx(fine.penetration, rel=1e-6)


def test_a_scene_that_pymunk_does_not_solve_leaves_the_exact_model_for_all() -> None:
    scenes = [{}, {"jack_inertia": 1e-6}]
    assert cheapest(scenes, cases=2).setting == Setting("exact", None)
