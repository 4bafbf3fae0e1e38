"""docs/speed.md and docs/costs.md show what is stored beside them, and the figures are what they are said to be."""

from __future__ import annotations

import importlib
import json
import re
import types
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pymunk
import pytest

from jackbox_env import Scene, make_simulator
from jackbox_env.simulators import exact
from scripts.studies import timing
from scripts.studies.costs import cost_steps
from scripts.studies.costs import page as costs
from scripts.studies.scaling import page as scaling
from scripts.studies.speed import measured
from scripts.studies.speed import page as speed
from tests.studies.counting import calls_of, times_called

DOCS = Path(__file__).parents[2] / "docs"
POOL_RATIO = "batch over EnvPool's CartPole-v1"
PAGES = [(speed, "speed"), (costs, "costs")]


def stored(name: str) -> Any:
    return json.loads((DOCS / f"{name}.json").read_text())


@pytest.mark.parametrize(("page", "name"), PAGES, ids=["speed", "costs"])
def test_a_page_shows_what_is_stored(page: Any, name: str) -> None:
    text = (DOCS / f"{name}.md").read_text()
    assert page.page(stored(name), f"{name}.png") == text


@pytest.mark.parametrize("name", ["speed", "costs"])
def test_a_page_opens_with_three_sentences_and_a_picture_and_its_tables_are_short(name: str) -> None:
    text = (DOCS / f"{name}.md").read_text()
    title, answer, picture, *_ = text.split("\n\n")
    assert title.startswith("# ")
    assert len(re.findall(r"[.](?: |$)", answer)) == 3
    assert (DOCS / re.fullmatch(r"!\[.+\]\((.+)\)", picture)[1]).is_file()  # type: ignore[index]
    for table in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
        assert table.count("\n") <= 12  # ten rows and the head


# -- figures -----------------------------------------------------------------------------------------------------------


def test_rates_are_taken_in_turn_and_ratios_within_a_round() -> None:
    order: list[str] = []

    def timed(name: str, rates: list[float]) -> timing.Timed:
        def run() -> float:
            order.append(name)
            return rates.pop(0)

        return run

    rates = timing.measure({"a": timed("a", [9.0, 1.0, 4.0]), "b": timed("b", [9.0, 2.0, 2.0])}, 2, progress=False)
    assert order == ["a", "b"] * 3
    assert rates == {"a": [1.0, 4.0], "b": [2.0, 2.0]}  # the first is the warm-up
    assert timing.ratios(rates, "a", "b") == [0.5, 2.0]
    assert timing.cells([3.0, 1.0, 2.0]) == "2 | 1 to 3"
    assert timing.cells([12345.6]) == "12,346 | "
    assert timing.rough(12345.6) == "12,300"


def test_a_rate_is_what_a_block_did_over_the_time_that_it_took() -> None:
    now = [0.0]

    def block() -> int:
        now[0] += 0.5
        return 10

    def prepare() -> None:
        now[0] += 100.0  # is not timed

    assert timing.repeat(block, 1.9, prepare, lambda: now[0])() == 20.0
    assert now[0] == 4 * 100.5


def test_differences_are_taken_within_passes_and_noise_is_told() -> None:
    # The machine is twice as slow in the second pass, and the difference stays a tenth; one pass is disturbed.
    ns = {"plain": [100.0, 200.0, 100.0] * 2, "with": [110.0, 220.0, 900.0, 110.0, 220.0, 50.0]}
    rates = {name: [1e9 / value for value in values] for name, values in ns.items()}
    assert costs.in_rounds(rates, 3, {"with": 1.0, "plain": -1.0}) == pytest.approx([20.0, 10.0])
    assert costs.cell([20.0, 10.0], 100.0) == "+15 ns (+15%)"
    assert costs.cell([-1.0, -2.0], 100.0) == "-1.5 ns (-1.5%)"
    assert costs.cell([-1.0, 2.0], 100.0) == "below noise"
    assert costs.cell([0.0, 2.0], 100.0) == "below noise"
    assert costs.cell(None, 100.0) == ""


def test_the_layers_of_a_step_are_the_whole_step() -> None:
    total: dict[str, float] = {}
    for weights in costs.LAYERS.values():
        for name, weight in weights.items():
            total[name] = total.get(name, 0.0) + weight
    assert {name: weight for name, weight in total.items() if weight} == {"plain": 1.0}
    assert {name for weights in costs.LAYERS.values() for name in weights} <= {"plain", *cost_steps.TAKEN_OUT}


def test_a_ratio_to_a_peer_that_is_not_installed_is_kept_from_the_run_that_had_it() -> None:
    rates = {measured.BATCH: [10.0], measured.POLES: [5.0], measured.POOL: [2.0]}
    first = {"ratios": speed.ratios_of("together", rates), "kept": {}, "made": "that day"}
    pool = POOL_RATIO
    assert first["ratios"] == {"batch over Gymnasium's own CartPole-v1": [2.0], pool: [5.0]}
    del rates[measured.POOL]
    for _ in range(2):  # also over several runs without it
        ratios = speed.ratios_of("together", rates)
        first = {"ratios": ratios, "kept": speed.kept_of(first, ratios), "made": "today"}
        assert first["kept"] == {pool: {"values": [5.0], "made": "that day"}}
    assert f"| {pool} | 5 |  |  |" in speed.ratio_table(first)
    assert f"Not installed here, and kept from an earlier run: {pool}. that day" in speed.ratio_table(first)


def test_a_page_without_any_figure_of_a_peer_is_written_without_it() -> None:
    results = stored("speed")
    whole = speed.page(results, "speed.png")
    for kind, name in (("rates", measured.POOL), *((kind, POOL_RATIO) for kind in ("ratios", "kept"))):
        results["together"][kind].pop(name, None)
    text = speed.page(results, "speed.png")
    assert "EnvPool" in whole.split("\n\n")[1]
    assert "EnvPool" not in text.split("\n\n")[1]


# -- what is timed -----------------------------------------------------------------------------------------------------


def test_the_bare_pymunk_loop_steps_the_scene_of_the_default(monkeypatch: pytest.MonkeyPatch) -> None:
    # From rest at the origin and under the same torques both reach the same state, before the first impact.
    space = pymunk.Space()
    monkeypatch.setattr(pymunk, "Space", lambda: space)
    monkeypatch.setattr(measured, "EPISODE", 40)
    measured.bare_pymunk(0.0)()
    box, jack = space.bodies
    monkeypatch.undo()
    simulator = make_simulator(Scene(), contact="pymunk")
    simulator.reset(np.zeros(12))
    for torque in np.random.default_rng(0).uniform(-90000.0, 90000.0, 40).tolist():
        simulator.step(0.02, torque)
    assert box.angular_velocity == pytest.approx(simulator.state[8], rel=1e-12)
    assert jack.velocity.y == pytest.approx(simulator.state[10], rel=1e-12)
    assert len(space.shapes) == 8


def test_a_batch_is_stepped_with_ever_new_actions_of_every_environment() -> None:
    seen: list[Any] = []

    class Counted:
        num_envs = 3
        action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float32)

        def reset(self) -> None:
            seen.clear()

        def step(self, actions: Any) -> None:
            seen.append(actions.copy())

    run = measured.many(Counted(), 0.0, steps=7)
    assert run() > 0.0
    assert [actions.shape for actions in seen] == [(3, 1)] * 7
    assert len({actions.tobytes() for actions in seen}) == 7


def test_envpool_is_timed_where_it_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, Any] = {}
    fake = types.SimpleNamespace(make=lambda *given, **settings: asked.update(settings, env=given))
    monkeypatch.setattr(importlib, "import_module", lambda name: fake)
    assert list(measured.envpool()) == [measured.POOL]
    assert asked["env"] == ("CartPole-v1",)
    assert asked["num_envs"] == measured.TOGETHER
    assert asked["num_threads"] == 1


def test_a_process_of_its_own_prints_its_processor_time_and_its_failure() -> None:
    assert 0.05 < measured.printed(measured._SECONDS) < 60.0
    with pytest.raises(RuntimeError, match="(?s)a process of its own failed:.*no such thing"):
        measured.printed("raise ValueError('no such thing')")


@pytest.mark.slow
def test_only_the_unguarded_search_loses_impacts_and_feet() -> None:
    found = measured.lost()
    assert found["certified"] == 0
    assert found["missed"] > 10
    assert found["escaped"] > 10


@pytest.mark.parametrize(("contact", "score"), [("pymunk", "PlainScore"), ("exact", "CompiledScore")])
def test_what_is_taken_out_of_a_step_does_not_run(contact: str, score: str) -> None:
    given = cost_steps.moments(1, 50)
    plain = calls_of(cost_steps.stepped(contact, given, 0.0, "plain"))
    assert times_called(plain, "JackInBoxEnv.step") == 10
    for kind, function in {
        "contact": "JackInBoxEnv.step",
        "_score": f"{score}.__call__",
        "_info": "JackInBoxEnv._info",
        "checks": "real",
        "bare": "OrderEnforcing.step",
    }.items():
        assert times_called(plain, function) >= 10
        calls = calls_of(cost_steps.stepped(contact, given, 0.0, kind))
        assert times_called(calls, function) == 0
        assert times_called(calls, f"{contact.capitalize()}Simulator.step") == 10  # the rest does


@pytest.mark.parametrize("contact", ["pymunk", "exact"])
def test_each_kind_of_step_is_timed(contact: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    usual, far = cost_steps.moments(2, 100), cost_steps.moments(2, 100, cost_steps.LONG)
    for kind in cost_steps.KINDS:
        assert cost_steps.stepped(contact, far if kind == "long arm" else usual, 0.0, kind)() > 0.0
    assert cost_steps.asked(contact) > 3.0


@pytest.mark.parametrize(
    ("kind", "restarts", "draws"), [("own scenes", 0, 0), ("restarted", 2, 0), ("redrawn", 2, 2), ("own task", 0, 0)]
)
def test_each_kind_of_step_of_a_batch_is_what_its_row_says(
    kind: str, restarts: int, draws: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, make_vec = list[Any](), gym.make_vec

    def kept(*given: Any, **settings: Any) -> Any:
        made.append(make_vec(*given, **settings))
        return made[-1]

    monkeypatch.setattr(gym, "make_vec", kept)
    given = cost_steps.moments(cost_steps.TOGETHER, 250)  # two moments of each
    plain, this = (cost_steps.batched("exact", given, 0.0, **cost_steps.IN_BATCHES.get(one, {})) for one in ("", kind))
    plain()
    calls = calls_of(this)
    assert times_called(calls, "ExactBatch.restart") == restarts
    assert times_called(calls, "Randomization.table") == draws
    without, having = (env.unwrapped for env in made)
    assert len(set(having.scenes)) > 1 or kind == "own task"
    assert (having.task is cost_steps.IN_BATCHES["own task"]["task"]) == (kind == "own task")
    if not restarts:
        np.testing.assert_allclose(having.states, without.states, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("kind", cost_steps.LOSS)
def test_each_step_with_loss_is_what_its_row_says(kind: str) -> None:
    given = cost_steps.with_loss(kind, courses=24)
    few, most = {cost_steps.FLIGHT: (0, 0), cost_steps.BOUNCE: (1, 1), cost_steps.PILE: (10, 20)}.get(kind, (1, 4))
    assert few <= given.hits.min()
    assert given.hits.max() <= most
    scene, rests = cost_steps.LOSS[kind], kind.startswith("rest")
    simulator = make_simulator(scene, "exact")
    for state, hits in zip(given.states[:20, 0], given.hits[:20, 0], strict=True):
        simulator.reset(state)
        simulator.step(cost_steps.DT, 0.0)
        assert len(simulator.impacts) == hits
        held = {hit.foot for hit in simulator.impacts if hit.time == simulator.time}
        assert len(held) == (2 if rests else 0) or kind in (cost_steps.PILE, cost_steps.CORNER)
    for timed in (cost_steps.alone(scene, given, 0.0), cost_steps.batched("exact", given, 0.0, scene=scene)):
        assert timed() > 0.0


def test_a_table_of_loss_is_in_microseconds_and_against_a_flight() -> None:
    ns = dict.fromkeys(cost_steps.LOSS, 1000.0) | {cost_steps.LEVEL: 3100.0, cost_steps.CORNER: 5900.0}
    ns[cost_steps.TURNING] = 3300.0
    loss = {kind: {costs.EXACT: [value, 2.0 * value], costs.BATCH: [value / 10.0] * 2} for kind, value in ns.items()}
    lines = costs.loss_table(loss, dict.fromkeys(ns, 2.0))
    assert lines[2] == f"| {cost_steps.FLIGHT} | 2 | 1.5 µs | 1 | 0.1 µs | 1 |"
    assert lines[-1] == f"| {cost_steps.CORNER} | 2 | 8.85 µs | 5.9 | 0.59 µs | 5.9 |"
    assert costs.held_cost(loss) == "4 to 9 microseconds"


def test_the_exact_models_head_says_what_a_step_with_held_feet_was_measured_to_take() -> None:
    assert f"takes some {costs.held_cost(stored('costs')['loss']['steps'])}" in " ".join((exact.__doc__ or "").split())


# -- scaling -----------------------------------------------------------------------------------------------------------


def test_the_page_of_sweeps_shows_what_is_stored() -> None:
    assert scaling.page(stored("scaling")) == (DOCS / "scaling.md").read_text()


def test_short_trials_are_limited_by_handing_out_and_long_ones_by_cores() -> None:
    found = {"empty": {"2 workers": {"own": 0.003}}, "journal": 0.002}
    assert scaling.most_cores(found, 1.0) == pytest.approx(200.0)
    assert scaling.at_once(found, 0.1, 10) == pytest.approx(100.0)
    assert scaling.at_once(found, 0.1, 2000) == pytest.approx(200.0)
    assert scaling.at_once(found, 100.0, 200) == pytest.approx(2.0)
