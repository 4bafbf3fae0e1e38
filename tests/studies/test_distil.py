"""The script that makes the policy `distilled`, made small."""

from __future__ import annotations

from collections import deque

import numpy as np
import pytest

from agents.landing import LandingPolicy
from agents.network import SHIPPED
from agents.value import read_value
from jackbox_env.states import Array
from scripts.studies import distil


def small_policy() -> LandingPolicy:
    return LandingPolicy(distil.FEWER, read_value(SHIPPED / "juggle-value").layers)


def test_states_are_worth_what_was_earned_and_the_value_of_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(distil, "COUNTED", 2)
    policy, rng = small_policy(), np.random.default_rng(0)
    seen: Array = np.array([distil.starts(3, rng) for _ in range(5)])
    earned, landed = rng.uniform(size=(4, 3)), np.array([1, -1, 2])
    states, worth = distil.counted(policy, seen, earned, landed)
    np.testing.assert_array_equal(states, [seen[1, 0], seen[2, 2], seen[2, 0], seen[3, 2]])
    end, factor = policy.value.of(seen[-1]), distil.DISCOUNT
    expected = earned[1, 0] + factor * (earned[2, 0] + factor * (earned[3, 0] + factor * end[0]))
    assert worth[0] == pytest.approx(expected, rel=1e-12)
    assert worth[3] == pytest.approx(earned[3, 2] + factor * end[2], rel=1e-12)


def test_fitting_comes_closer() -> None:
    value, rng = read_value(SHIPPED / "juggle-value"), np.random.default_rng(0)
    net = distil.network(value.layers)
    for one, other in zip(distil.layers_of(net), value.layers, strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])
    states = distil.starts(600, rng)
    kept = deque([(states, value.of(states) + 20.0)])
    first = distil.fit(net, value.inputs, kept, 1e-3)
    for _ in range(15):
        last = distil.fit(net, value.inputs, kept, 1e-3)
    assert first > 10.0
    assert last < 0.5 * first
