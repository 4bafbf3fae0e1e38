"""What a study of transfer concludes from numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from scripts.studies.transfer.inference import Estimate, welch
from scripts.studies.transfer.verdict import EXACT, MARGIN, Comparison, Finding, compare, finding

# -- comparisons ------------------------------------------------------------------------------------------------------


def planted_runs(rng: np.random.Generator) -> dict[str, dict[str, dict[str, NDArray[np.float64]]]]:
    """Two statistics; ``coarse`` has the one 10 % higher, ``wide`` spreads the other twice as far."""

    def sample(mean: float = 1.0, spread: float = 0.2, other: float = 0.2) -> dict[str, NDArray[np.float64]]:
        return {"rate": rng.normal(mean, spread, 500), "speed": rng.normal(5.0, other, 500)}

    return {"noise": {"exact": sample(), "coarse": sample(1.1), "wide": sample(other=0.4), "exact again": sample()}}


def differing(rows: list[Comparison]) -> set[tuple[str, str]]:
    return {(row.setting, row.statistic) for row in rows if row.differs}


def test_comparisons_find_what_is_planted_and_nothing_else() -> None:
    rows = {(row.setting, row.statistic): row for row in compare(planted_runs(np.random.default_rng(5)))}
    assert len(rows) == 6
    assert differing(list(rows.values())) == {("coarse", "rate"), ("wide", "speed")}
    found = rows["coarse", "rate"]
    assert found.difference.low < 0.1 < found.difference.high
    assert found.exact == pytest.approx(1.0, abs=0.03)
    assert found.mean_probability < 0.001
    wide = rows["wide", "speed"]
    assert wide.shape_probability < 0.05 < wide.mean_probability  # means do not show a spread
    assert 0.03 < rows["exact again", "rate"].seen < 0.06  # 0.2 sqrt(2 / 500) (3.04 + 0.84)


def test_many_comparisons_raise_no_more_false_alarms_than_one() -> None:
    rng = np.random.default_rng(10)
    many = {name: {"rate": rng.normal(size=60)} for name in (EXACT, *map(str, range(60)))}
    alone = [welch(values["rate"], many[EXACT]["rate"])[1] for values in many.values()]
    assert sum(probability < 0.025 for probability in alone) >= 2  # what would be alarms by themselves
    assert differing(compare({"noise": many})) == set()


def test_counts_with_ties_raise_no_more_false_alarms_than_is_said() -> None:
    rng = np.random.default_rng(3)

    def alarms(mean: float, times: int) -> int:
        pairs = ({EXACT: rng.poisson(0.4, 100), "coarse": rng.poisson(mean, 100)} for _ in range(times))
        runs = ({"noise": {name: {"n": counts.astype(float)} for name, counts in pair.items()}} for pair in pairs)
        return sum(compare(run)[0].differs for run in runs)

    assert alarms(0.4, 200) <= 0.05 * 200 + 3.0 * math.sqrt(0.05 * 0.95 * 200)
    assert alarms(1.0, 20) >= 18  # and more than twice the count is seen


def test_the_distance_of_distributions_takes_ties_together() -> None:
    values = {EXACT: [0.0, 0.0, 1.0, 1.0], "coarse": [0.0, 1.0, 1.0, 1.0, 1.0]}
    (row,) = compare({"noise": {name: {"rate": np.array(sample)} for name, sample in values.items()}})
    assert row.distance == pytest.approx(0.3)  # 2 / 4 - 1 / 5


def test_episodes_without_a_number_are_left_out_of_its_comparison() -> None:
    runs = planted_runs(np.random.default_rng(6))
    runs["noise"]["coarse"]["rate"][:100] = math.nan
    row = next(row for row in compare(runs) if (row.setting, row.statistic) == ("coarse", "rate"))
    assert row.episodes == (500, 400)
    assert math.isfinite(row.difference.mean)


@pytest.mark.parametrize("survivors", [0, 1])
@pytest.mark.parametrize("left", [math.nan, None], ids=["NaN", "left out"])
def test_a_setting_that_loses_all_jacks_or_all_but_one_is_compared_without_a_crash(
    survivors: int, left: float | None
) -> None:
    rng = np.random.default_rng(13)
    runs = {"noise": planted_runs(rng)["noise"], "calm": planted_runs(rng)["noise"]}
    for name, values in runs["noise"]["coarse"].items():
        kept = values[:survivors]
        runs["noise"]["coarse"][name] = kept if left is None else np.append(kept, np.full(9, left))
    rows = compare(runs)
    lost = [row for row in rows if (row.condition, row.setting) == ("noise", "coarse")]
    assert [row.episodes for row in lost] == [(500, survivors)] * 2
    assert [math.isnan(row.difference.mean) for row in lost] == [survivors == 0] * 2
    assert all(row.difference.half_width == row.seen == math.inf for row in lost)
    # what the other settings came to is found nevertheless
    assert {(row.condition, row.setting) for row in rows if row.differs} == {
        ("noise", "wide"), ("calm", "coarse"), ("calm", "wide"),
    }  # fmt: skip
    assert all(math.isfinite(row.seen) for row in rows if row not in lost)


def test_where_exact_has_no_number_nothing_is_compared() -> None:
    runs = planted_runs(np.random.default_rng(15))
    runs["noise"]["exact"]["rate"] = np.array([])
    row = next(row for row in compare(runs) if (row.setting, row.statistic) == ("coarse", "rate"))
    assert math.isnan(row.exact)
    assert math.isnan(row.difference.mean)
    assert not row.differs


# -- verdicts ---------------------------------------------------------------------------------------------------------


def made_up(loss: tuple[float, float], shift: tuple[float, float] = (0.0, 1.0)) -> Finding:
    """On a return of 100, where the margin is 5."""
    return Finding("coarse", 100.0, [100.0] * 5, Estimate(*loss), Estimate(*shift))


@pytest.mark.parametrize(
    ("loss", "verdict"),
    [
        ((0.0, 4.9), "safe"),
        ((3.0, 7.9), "safe"),
        ((-2.0, 2.9), "safe"),  # worse, but surely by less than the margin
        ((-2.0, 3.1), "undecided"),
        ((0.0, 5.1), "undecided"),
        ((-4.0, 3.9), "worse"),
        ((-10.0, 4.9), "harmful"),
        ((-10.0, 5.1), "worse"),
        ((0.0, math.inf), "undecided"),
    ],
)
def test_what_is_safe_to_learn_on(loss: tuple[float, float], verdict: str) -> None:
    assert MARGIN == 0.05
    assert made_up(loss).learning == verdict
    assert made_up(loss)._replace(fidelity=EXACT).learning == "reference"


@pytest.mark.parametrize(
    ("shift", "verdict"),
    [
        ((2.0, 2.9), "honest"),
        ((-2.0, 2.9), "honest"),
        ((3.0, 2.9), "too high"),
        ((-3.0, 2.9), "too low"),
        ((2.0, 4.0), "undecided"),
        ((0.0, math.inf), "undecided"),
    ],
)
def test_what_is_honest_about_its_own_returns(shift: tuple[float, float], verdict: str) -> None:
    assert made_up((0.0, 1.0), shift).promise == verdict


def test_a_negative_return_has_a_margin_too() -> None:
    assert made_up((-2.0, 2.0))._replace(exact=-100.0).learning == "safe"


def test_findings_come_from_the_right_cells() -> None:
    rng = np.random.default_rng(7)

    def returns(mean: float) -> NDArray[np.float64]:
        return mean + rng.normal(size=(3, 64))

    # trained on coarse: 120 on itself, 80 on exact; trained on exact: 100 on exact
    trained = {
        "coarse": {"coarse": returns(120.0), "exact": returns(80.0)},
        "exact": {"coarse": returns(90.0), "exact": returns(100.0)},
    }
    found = finding(trained, "coarse")
    assert found.exact == pytest.approx(100.0, abs=1.0)
    assert found.trainings == pytest.approx([80.0] * 3, abs=1.0)
    assert found.loss.mean == pytest.approx(-20.0, abs=1.0)
    assert found.shift.mean == pytest.approx(40.0, abs=1.0)
    assert (found.learning, found.promise) == ("harmful", "too high")
    assert found.needed == 2  # seeds differ by about 1/8, the margin is 5
    assert found.starts == pytest.approx(1.998 * math.sqrt(2.0 / 3.0 / 64), rel=0.3)
