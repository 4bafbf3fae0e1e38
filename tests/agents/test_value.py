"""The value at the end of a plan: its inputs, its share in returns, its files."""

from __future__ import annotations

from typing import Any

import numpy as np

from agents.policies.icem import PlanSearch
from agents.policies.network import SHIPPED
from agents.policies.registry import find_policy, shipped_names
from agents.policies.value import UNIT, Value, ValuedSearch
from agents.settings import EnvSettings
from jackbox_env import Scene
from jackbox_env.simulators.agent_functions import observed
from tests.agents.untrained import layers_for, states_in

SMALL: dict[str, Any] = {"repeat": 5, "samples": 24, "elites": 4, "iterations": 2, "knots": 10}
EXACT = EnvSettings(contact="exact")


def test_the_ends_of_candidates_are_valued() -> None:
    weights = layers_for()
    value, scene, states = Value(EXACT, weights), Scene(drive=None), states_in(Scene(), 4)
    tried = np.random.default_rng(0).uniform(-1.0, 1.0, (4, 7, 10))
    plain, ends = PlanSearch("juggle", 0.02, **SMALL).evaluate(scene, states, tried)
    returns, same = ValuedSearch(value, "juggle", 0.02, **SMALL).evaluate(scene, states, tried)
    np.testing.assert_array_equal(same, ends)
    expected = np.array([value.of(last) for last in ends])
    np.testing.assert_array_equal(returns, plain + expected)
    seen = value.inputs(ends[1])
    np.testing.assert_array_equal(seen[:, :10], observed(scene, ends[1]))
    inner = np.tanh(seen @ weights[0][0].T + weights[0][1])
    np.testing.assert_allclose(expected[1], UNIT * (inner @ weights[1][0].T + weights[1][1])[:, 0], rtol=1e-5)


def search_in(**settings: Any) -> PlanSearch:
    """The search of the planner that the registry makes for an environment."""
    policy: Any = find_policy("planner", EnvSettings(**settings), 0).policy
    search: PlanSearch = policy.search
    return search


def test_the_planner_counts_the_value_where_one_was_made() -> None:
    assert "value" not in shipped_names("juggle")
    assert sum(path.stat().st_size for path in (SHIPPED / "juggle-value").iterdir()) < 150_000
    for search in (search_in(), search_in(contact="exact"), search_in(scene='{"drive": null}')):
        assert (isinstance(search, ValuedSearch), search.knots) == (True, 20)
    for search in (search_in(scene='{"gravity": 3.0}'), search_in(control_dt=0.05)):
        assert (isinstance(search, ValuedSearch), search.knots) == (False, 32)
