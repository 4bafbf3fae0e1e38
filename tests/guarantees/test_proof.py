"""Proofs by interval arithmetic contain the 60-digit references, refute wrong results and give reasons."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flint import arb, ctx, fmpq

from jackbox_env.exact import bounds, search
from jackbox_env.model.scene import Chirp, Drive, Scene
from jackbox_env.simulators import Impact
from tests import proof, proving
from tests.proof import EVERY_PAIR, FreeFlight, prove, turn_of
from tests.proving import Case, Computed, Tally, simulated
from tests.simulators.exact_runs import plain_step
from tests.states import inside, load, lying

RECORDS = [*load("exact_trajectories"), *load("loss_trajectories"), *load("seed_scene")]


# -- contained ---------------------------------------------------------------------------------------------------------


def decimal(number: float) -> arb:
    """The shortest decimal that reads as a float, to more digits than any proof here needs."""
    with ctx.workprec(1024):
        return arb(fmpq(*Fraction(repr(number)).as_integer_ratio()))


def in_decimals(record: dict[str, Any]) -> Scene:
    """The scene of a reference: 9.81 and 0.9 themselves, not the float64 numbers next to them."""
    drive = Chirp() if record["drive"] == "chirp" else None
    scene = Scene(gravity=record["gravity"], restitution=record.get("restitution", 1.0), drive=drive)
    for part, name in ((scene, "gravity"), (scene, "restitution"), (drive, "rate")):
        if part is not None:
            object.__setattr__(part, name, decimal(getattr(part, name)))
    return scene


def assert_contained(ball: arb, rounded: float) -> None:
    """A ball contains a number of which the nearest float64 is known."""
    assert arb(rounded, 0.5 * math.ulp(rounded)).contains(ball), (ball, rounded)


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record["name"])
def test_the_60_digit_references_lie_inside_their_enclosures(record: dict[str, Any]) -> None:
    steps, precision = round(record["T"] / 0.02), ctx.prec
    torques = [90000.0 * action for action in record["actions"]] if record["drive"] == "held" else [None] * steps
    proven = prove(in_decimals(record), record["q"] + record["qdot"], torques, decimal(0.02))  # type: ignore[arg-type]
    assert proven.decided, proven.why
    assert ctx.prec == precision
    assert [(hit.wall, hit.foot) for hit in proven.impacts] == [(hit["wall"], hit["foot"]) for hit in record["impacts"]]
    for hit, known in zip(proven.impacts, record["impacts"], strict=True):
        assert_contained(hit.time, known["time"])
        assert_contained(hit.impulse, known["impulse"])
    for known in record["states"]:
        for ball, number in zip(proven.states[round(known["time"] / 0.02)], known["state"], strict=True):
            assert_contained(ball, number)


@pytest.mark.parametrize("chirp", [False, True])
def test_taylor_forms_contain_the_gaps_and_rates_within_their_interval(chirp: bool) -> None:
    rng, tightest = np.random.default_rng(3), math.inf
    with ctx.workprec(128):
        for _ in range(100):
            state = [arb(number) for number in inside(Scene(), rng).tolist()]
            flight = FreeFlight(
                Scene(), state, turn_of(Scene(), None if chirp else 9e4, arb(0), arb(rng.uniform(0.0, 0.1)))
            )
            start, length = rng.uniform(0.0, 0.5), 10.0 ** rng.uniform(-6.0, -0.5)
            forms = flight.forms(arb(start).union(arb(start + length)), EVERY_PAIR)
            points = [flight.forms(arb(start + share * length), EVERY_PAIR) for share in (0.0, 0.2, 0.5, 0.8, 1.0)]
            for pair, form in forms.items():
                assert all(
                    form.gap.contains(point[pair].gap) and form.rate.contains(point[pair].rate) for point in points
                )
                spread = abs(points[0][pair].rate - points[-1][pair].rate)
                tightest = min(tightest, float(form.rate.rad() / spread.upper()))
    assert tightest < 0.6  # half at best


def test_the_proof_shares_only_the_scene_with_what_it_proves() -> None:
    tree = ast.parse(Path(proof.__file__).read_text())
    modules = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module}
    plain = {name.name for node in ast.walk(tree) if isinstance(node, ast.Import) for name in node.names}
    assert {name for name in modules | plain if name.split(".")[0] in ("jackbox_env", "tests")} == {
        "jackbox_env.model.scene"
    }


# -- proven ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("regime", proving.REGIMES)
def test_no_step_of_any_regime_is_refuted(regime: str) -> None:
    tally = proving.tally_of(regime, seed=1, share=40)
    assert tally.refuted == []
    assert tally.proven > 0.5 * tally.steps


# -- refuted -----------------------------------------------------------------------------------------------------------


def with_impacts(steps: int) -> list[tuple[Case, Computed]]:
    """The steps with impacts among some of default play under the chirp."""
    cases = islice(proving.chirped(np.random.default_rng(5)), steps)
    return [(case, computed) for case in cases if (computed := simulated(case)).impacts]


def judged(steps: list[tuple[Case, Computed]]) -> Tally:
    """The tally of some steps, all proven."""
    tally = Tally()
    for case, computed in steps:
        tally.enter(case, computed)
    assert tally.proven == len(steps) > 0
    assert not tally.grazes
    assert not tally.ties
    return tally


@pytest.mark.parametrize(
    "forge",
    [
        lambda computed: computed._replace(impacts=computed.impacts[1:]),
        lambda computed: computed._replace(impacts=[hit._replace(time=hit.time + 1e-11) for hit in computed.impacts]),
        lambda computed: computed._replace(impacts=[hit._replace(foot=(hit.foot + 1) % 4) for hit in computed.impacts]),
        lambda computed: computed._replace(state=computed.state + 1e-8 * np.eye(12)[8]),
    ],
    ids=["an impact dropped", "a time moved", "another foot", "a state moved"],
)
def test_wrong_results_are_refuted(forge: Callable[[Computed], Computed]) -> None:
    steps = with_impacts(400)
    assert judged(steps).refuted == []
    assert len(judged([(case, forge(computed)) for case, computed in steps]).refuted) == len(steps)


def test_a_search_with_a_tenth_of_its_bound_is_refuted(monkeypatch: pytest.MonkeyPatch) -> None:
    def played() -> list[tuple[Case, Computed]]:
        runs = [(case, plain_step(case.scene, case.state, case.dt, None, case.time)) for case, _ in steps]
        return [
            (case, Computed([Impact(case.time + since, wall, foot, 1.0) for since, wall, foot in hits], after))
            for case, (_, after, hits) in runs
        ]

    def brazen(*arguments: Any) -> bounds.Bounds:
        centre, foot = honest(*arguments)
        return bounds.Bounds(0.1 * centre, 0.1 * foot)

    steps, honest = with_impacts(1000), bounds.bounds_of
    assert judged(played()).refuted == []
    monkeypatch.setattr(search, "bounds_of", brazen)
    assert len(judged(played()).refuted) > 0.2 * len(steps)


# -- undecided ---------------------------------------------------------------------------------------------------------

STILL = Scene(gravity=0.0, drive=None)
SLIDING = [0, 0, 0, 5.0, 0, 0, 0, 0, 0, 0, 1.0, 0]  # a foot that touches a wall and neither approaches nor leaves
ARRIVING = [0, 0, 0, 4.5, 0, 0, 0, 0, 0, 1.0, 0, 0]  # a foot half a metre from a wall
CORNERED = [0, 0, 0, 4.5, 4.5, 0, 0, 0, 0, 3.0, 3.0, 0]  # two feet, each half a metre from a wall
REASONS: list[tuple[str, Scene, Any, float]] = [
    ("an impact at a step's very end", STILL, ARRIVING, 0.5),
    ("an impact at a step's very end", STILL, ARRIVING, 10.5),  # the second: across the box at 1 m/s
    ("a tangency or rest", STILL, SLIDING, 0.5),
    ("feet at the limit of striking together", STILL, CORNERED, 0.2),
    ("an impact without restitution", STILL.changed(restitution=0.0), ARRIVING, 1.0),
    ("a drive of functions", Scene(drive=Drive(torque=math.sin)), ARRIVING, 0.5),
    ("a foot that approaches from within a wall", STILL, [0, 0, 0, 5.001, *ARRIVING[4:]], 0.5),
]


@pytest.mark.parametrize(("reason", "scene", "state", "dt"), REASONS)
def test_undecided_steps_have_a_reason(reason: str, scene: Scene, state: Any, dt: float) -> None:
    proof = prove(scene, state, [None], dt, most_bits=256)
    assert (proof.decided, proof.why) == (False, reason)


def test_feet_that_strike_at_exactly_the_same_time_strike_together() -> None:
    proof = prove(STILL, CORNERED, [None], 0.2, together=1e-13)
    assert proof.decided
    assert [(hit.wall, hit.foot) for hit in proof.impacts] == [(0, 0), (1, 1)]
    assert all(hit.time.overlaps(arb(1) / 6) for hit in proof.impacts)


def test_the_tolerance_decides_whether_two_feet_strike_together() -> None:
    # A jack that turns with nothing and falls on two feet, as float64 has 45 degrees: one is 1e-16 m lower.
    state = lying()
    state[4] += 0.5
    apart, together = (prove(Scene(drive=None), state.tolist(), [0.0], 0.5, together=within) for within in (0.0, 1e-13))
    assert apart.decided
    assert together.decided
    assert [hit.time.overlaps(together.impacts[0].time) for hit in together.impacts] == [True, True]
    assert apart.impacts[0].time < apart.impacts[1].time
    assert not apart.states[1][11].overlaps(together.states[1][11])
