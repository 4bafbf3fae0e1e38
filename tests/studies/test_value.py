"""The script that makes the planner's value, made small."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from agents.settings import EnvSettings
from agents.value import Value
from jackbox_env.plans import Search
from scripts.studies import value


def test_a_value_is_made_of_what_searches_find(monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    small = {**value.JUDGING, "pieces": 8, "samples": 16, "iterations": 1}
    given: dict[str, Any] = {"EPISODES": 3, "DECISIONS": 8, "JUDGING": small, "EPOCHS": 2, "BATCH": 8, "TOGETHER": 7}
    for name, new in given.items():
        monkeypatch.setattr(value, name, new)
    rng, settings = np.random.default_rng(0), EnvSettings(contact="exact")
    search = value.Watched(Value(settings, value.NOTHING), "juggle", 0.02, **value.PLAYING)
    states = value.chosen(search, 20, rng)
    assert states.shape == (20, 12)
    worth = value.judged("juggle", states, np.random.default_rng(1))
    np.testing.assert_array_equal(worth, value.judged("juggle", states, np.random.default_rng(1)))
    first = Search("juggle", 0.02, seed=int(np.random.default_rng(1).integers(2**31)), **small)
    np.testing.assert_array_equal(worth[:7], first.decide(value.SCENE, states[:7], first.begin(7))[0].returns)
    layers = value.fitted(settings, states, worth)
    assert np.isfinite(Value(settings, layers).of(states)).all()
    assert "18 states, " in capsys.readouterr().out
