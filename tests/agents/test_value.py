"""The value at a plan's end: what it sees, that it counts, and that nothing beside a plan changes it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from agents import evaluation
from agents.evaluation import evaluate, find_policy, shipped_names
from agents.network import SHIPPED, Layer
from agents.observing import observations
from agents.planner import Planner
from agents.settings import EnvSettings
from agents.value import INPUTS, UNIT, Value, ValuedSearch, read_value, write_value
from jackbox_env import Scene
from jackbox_env.observation import observe
from jackbox_env.plans import Search
from jackbox_env.storage import write_json
from tests.states import inside

SMALL: dict[str, Any] = {"piece": 5, "samples": 24, "elites": 4, "iterations": 2, "pieces": 10}
EXACT = EnvSettings(contact="exact")


def layers_for(width: int = 16, seed: int = 0) -> list[Layer]:
    rng = np.random.default_rng(seed)
    return [
        (rng.normal(size=(after, before)).astype(np.float32), rng.normal(size=after).astype(np.float32))
        for before, after in ((INPUTS, width), (width, 1))
    ]


def states_in(scene: Scene, count: int, seed: int = 3) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    return np.array([inside(scene, rng) for _ in range(count)])


def test_the_ends_of_candidates_are_valued() -> None:
    value, scene, states = Value(EXACT, layers_for()), Scene(drive=None), states_in(Scene(), 4)
    tried = np.random.default_rng(0).uniform(-1.0, 1.0, (4, 7, 10))
    plain, ends = Search("juggle", 0.02, **SMALL).play(scene, states, tried)
    returns, same = ValuedSearch(value, "juggle", 0.02, **SMALL).play(scene, states, tried)
    np.testing.assert_array_equal(same, ends)
    expected = np.array([value.of(own) for own in ends])
    np.testing.assert_array_equal(returns, plain + expected)
    weights = layers_for()
    seen = np.array([observe(scene, state.tolist()) for state in ends[1]])
    inner = np.tanh(value.inputs(ends[1]) @ weights[0][0].T + weights[0][1])
    np.testing.assert_allclose(value.inputs(ends[1])[:, :10], seen, atol=1e-6)
    np.testing.assert_allclose(expected[1], UNIT * (inner @ weights[1][0].T + weights[1][1])[:, 0], rtol=1e-5)


def test_a_value_changes_plans_and_nothing_of_nothing() -> None:
    seen = observations(Scene(), states_in(Scene(), 3))
    plain = Planner(Scene(), **SMALL).predict(seen)[0]
    nothing = Value(EXACT, [(np.zeros((1, INPUTS), np.float32), np.ones(1, np.float32))])
    np.testing.assert_array_equal(Planner(Scene(), **SMALL, value=nothing).predict(seen)[0], plain)
    valued = Planner(Scene(), **SMALL, value=Value(EXACT, layers_for())).predict(seen)[0]
    assert not np.array_equal(valued, plain)
    np.testing.assert_array_equal(Planner(Scene(), **SMALL, value=Value(EXACT, layers_for())).predict(seen)[0], valued)


def test_each_environment_is_planned_for_alone() -> None:
    planner = Planner(Scene(), **SMALL, value=Value(EXACT, layers_for(96)))
    seen = observations(Scene(), states_in(Scene(), 9))
    together, plans = planner.predict(seen)
    later, _ = planner.predict(seen, plans, np.arange(9) == 4)
    for number in range(9):
        alone, plan = planner.predict(seen[number])
        assert together[number] == alone
        assert later[number] == planner.predict(seen[number], plan, np.array([number == 4]))[0]


@pytest.mark.parametrize(
    ("layers", "sentence"),
    [
        ([], "the last layer must give 1 number, got no layer"),
        (layers_for()[:1], "the last layer must give 1 number, got 16"),
        (layers_for()[1:], r"a layer must take 21 numbers, got shapes \(1, 16\) and \(1,\)"),
        ([(weight * np.nan, bias) for weight, bias in layers_for()], "weights must be finite"),
    ],
)
def test_misfits_are_refused(layers: list[Layer], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        Value(EXACT, layers)


def test_only_a_value_is_taken_for_one() -> None:
    with pytest.raises(TypeError, match="value must be a Value or None, got 'good'"):
        Planner(Scene(), value="good")  # type: ignore[arg-type]


def test_it_is_written_and_read_and_damage_is_told(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"holds no value.json"):
        read_value(tmp_path)
    write_value(tmp_path, EXACT, layers_for())
    states = states_in(Scene(), 5)
    np.testing.assert_array_equal(read_value(tmp_path).of(states), Value(EXACT, layers_for()).of(states))
    (tmp_path / "weights.npz").write_bytes((tmp_path / "weights.npz").read_bytes()[:-100])
    with pytest.raises(ValueError, match=r"holds no value: "):
        read_value(tmp_path)
    write_value(tmp_path, EXACT, layers_for())
    damaged: list[tuple[Any, str]] = [
        ({"gravity": 3.0}, "settings takes only 'task', .* got 'gravity'"),
        ({"scene": 3}, "scene must be a JSON object, got 3"),
        ([], r"settings must be a JSON object, got \[\]"),
        ({"task": "dance"}, "task must be .* got 'dance'"),
        ({"contact": "box2d"}, "contact must be one of 'pymunk', 'exact', got 'box2d'"),
        ({"contact": "pymunk", "substeps": -1}, "substeps must be a whole number"),
        ({"control_dt": "soon"}, "control_dt must be a finite number above 0, got 'soon'"),
    ]
    for given, sentence in damaged:
        write_json(tmp_path / "value.json", given)
        with pytest.raises(ValueError, match=f"holds no value: {sentence}"):
            read_value(tmp_path)
    (tmp_path / "weights.npz").unlink()
    write_value(tmp_path, EXACT, layers_for())
    (tmp_path / "weights.npz").unlink()
    with pytest.raises(FileNotFoundError, match=r"holds no weights.npz"):
        read_value(tmp_path)


def test_the_planner_counts_the_value_where_one_was_made() -> None:
    def search_in(**given: Any) -> Search:
        planner = find_policy("planner", EnvSettings(**given), 0).policy
        assert isinstance(planner, Planner)
        return planner._search

    assert "value" not in shipped_names("juggle")
    assert sum(path.stat().st_size for path in (SHIPPED / "juggle-value").iterdir()) < 150_000
    assert isinstance(search_in(), ValuedSearch)
    assert isinstance(search_in(contact="exact"), ValuedSearch)
    assert search_in(scene='{"drive": null}').pieces == 20
    for given in ({"scene": '{"gravity": 3.0}'}, {"control_dt": 0.05}):
        search = search_in(**given)
        assert not isinstance(search, ValuedSearch)
        assert search.pieces == 32
    with pytest.raises(FileNotFoundError, match="a policy must be one of"):
        find_policy("value", EnvSettings(), 0)


def test_a_value_of_another_task_is_not_used_and_a_damaged_one_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(evaluation, "SHIPPED", tmp_path)
    (tmp_path / "juggle-value").mkdir()
    write_value(tmp_path / "juggle-value", EnvSettings(task="spin", contact="exact"), layers_for())
    planner = find_policy("planner", EnvSettings(), 0).policy
    assert isinstance(planner, Planner)
    assert not isinstance(planner._search, ValuedSearch)
    (tmp_path / "juggle-value" / "value.json").unlink()
    with pytest.raises(FileNotFoundError, match="holds no value.json"):
        find_policy("planner", EnvSettings(), 0)
    (tmp_path / "juggle-value" / "value.json").write_text("{")
    with pytest.raises(ValueError, match="holds no value: "):
        find_policy("planner", EnvSettings(), 0)


def test_short_plans_juggle_better_with_the_value() -> None:
    given: dict[str, Any] = {**SMALL, "samples": 64, "iterations": 1, "pieces": 20}
    value = read_value(SHIPPED / "juggle-value")
    with_it, without = (
        evaluate("planner", Planner(Scene(), **given, value=end), EXACT.env_settings, 4, 0) for end in (value, None)
    )
    assert with_it.mean > without.mean
