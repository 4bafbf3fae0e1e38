"""The page of a study: sentences, tables and picture say what the numbers say, and docs/learning.md is one of them."""

from __future__ import annotations

import math
import re
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tyro
from matplotlib import pyplot as plt

from jackbox_env import FIDELITIES
from scripts.studies.transfer.inference import Estimate
from scripts.studies.transfer.page import (
    decision,
    footnote,
    long_table,
    page,
    page_with_loss,
    percent,
    picture,
    read_data,
    returns_table,
    too_short,
    verdict_table,
    write,
)
from scripts.studies.transfer.study import Returns, StudySettings, resolved_fidelities, settings_from
from scripts.studies.transfer.transfer import Arguments
from scripts.studies.transfer.verdict import EXACT, MARGIN, Comparison, Finding

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def made_up(loss: tuple[float, float], fidelity: str = "coarse", **known: Any) -> Finding:
    """On a return of 100, where the margin is 5."""
    found = Finding(fidelity, 100.0, [101.0, 95.0, 104.0], Estimate(*loss), Estimate(20.0, 3.0))
    return found._replace(**known)


SAFE, HARMFUL, WORSE, OPEN = (made_up(loss) for loss in ((0.0, 2.0), (-10.0, 2.0), (-6.0, 5.0), (0.0, 9.0)))


# -- sentences --------------------------------------------------------------------------------------------------------


def test_one_sentence_decides() -> None:
    fine, balanced = SAFE._replace(fidelity="fine"), OPEN._replace(fidelity="balanced")
    assert decision("juggle", [HARMFUL, fine]) == (
        "On `juggle`, learning on `fine` is safe too; training on `coarse` costs return."
    )
    assert decision("juggle", [WORSE, balanced]) == (
        "On `juggle`, stay with `exact`: no other fidelity is shown to be safe; training on `coarse` costs return."
        "[^juggle]"
    )
    assert decision("spin", [SAFE, fine, balanced]) == "On `spin`, learning on `coarse`, `fine` is safe too.[^spin]"


@pytest.mark.parametrize(
    ("known", "words"),
    [
        ({"trainings": [1.0] * 5, "needed": 12}, "5 trainings are too few to tell; about 12 would be needed."),
        ({"trainings": [1.0] * 5, "needed": 4}, "5 trainings are too few to tell; about 6 would be needed."),
        ({"trainings": [1.0] * 5}, "5 trainings are too few to tell; more than 1,000 would be needed."),
        ({"starts": 5.1}, "more episodes are needed first: the starts alone make the interval wider than the margin."),
        ({"trainings": [1.0]}, "one training shows no spread."),
    ],
)
def test_the_footnote_says_what_would_settle_what_is_open(known: dict[str, Any], words: str) -> None:
    assert footnote("juggle", [OPEN._replace(**known)]) == [f"[^juggle]: Undecided. `coarse`: {words}", ""]
    both = footnote("juggle", [SAFE, OPEN._replace(**known), OPEN._replace(fidelity="fine", **known)])
    assert both[0] == f"[^juggle]: Undecided. `coarse`, `fine`: {words}"


def test_what_is_decided_has_no_footnote() -> None:
    assert footnote("juggle", [SAFE, HARMFUL, WORSE, OPEN._replace(fidelity=EXACT)]) == []


@pytest.mark.parametrize(
    ("estimate", "of", "words"),
    [
        ((2.0, 3.0), 200.0, "+1.0 % (-0.5 to +2.5)"),
        ((2.0, 3.0), -200.0, "+1.0 % (-0.5 to +2.5)"),
        ((2.0, 3.0), 0.0, "+2 (-1 to +5)"),
        ((2.0, math.inf), 200.0, "+1.0 % (-inf to +inf)"),
    ],
)
def test_differences_in_percent(estimate: tuple[float, float], of: float, words: str) -> None:
    assert percent(Estimate(*estimate), of) == words


# -- tables -----------------------------------------------------------------------------------------------------------


def test_the_verdict_table_holds_what_was_found() -> None:
    lines = verdict_table({"juggle": [HARMFUL, SAFE._replace(fidelity=EXACT)]})
    assert lines[2:] == [
        "| juggle | coarse | harmful | -10.0 % (-12.0 to -8.0) | 95.0 | too high | +20.0 % (+17.0 to +23.0) |",
        "| juggle | exact | reference | 100.0 | 95.0 |  |  |",
    ]


def test_the_table_of_returns_has_rows_trained_on_and_columns_run_on() -> None:
    trained = {
        "coarse": {"coarse": [[1.0, 1.0], [3.0, 3.0]], "exact": [[5.0, 5.0], [5.0, 5.0]]},
        "exact": {"coarse": [[6.0, 6.0], [6.0, 6.0]], "exact": [[7.0, 7.0], [7.0, 7.0]]},
    }
    baselines = {"zero": {"coarse": [8.0, 8.0], "exact": [9.0, 9.0]}}
    assert returns_table("juggle", {"trained": trained, "baselines": baselines}) == [
        "| juggle, trained on \\ run on | coarse | exact |",
        "| --- | --- | --- |",
        "| PPO, coarse | 2.0 ± 12.7 | 5.0 ± 0.0 |",  # t_1 = 12.706, error 1
        "| PPO, exact | 6.0 ± 0.0 | 7.0 ± 0.0 |",
        "| zero (scripted) | 8.0 ± 0.0 | 9.0 ± 0.0 |",
    ]


def test_the_long_run_says_where_a_setting_differs_how_deep_it_goes_and_what_it_lost() -> None:
    def row(setting: str, statistic: str, difference: float, probability: float, seen: float = 0.2) -> dict[str, Any]:
        estimate = Estimate(difference, 0.1 if math.isfinite(difference) else math.inf)
        found = Comparison("noise", setting, statistic, 2.0, estimate, 0.1, probability, 1.0, seen, (9, 9))
        return found._asdict()

    rows = [row("coarse", "rate", 0.5, 0.01), row("coarse", "speed", -1.0, 0.04), row("coarse", "spin", 1.9, 0.06)]
    rows += [row("fine", "rate", 0.5, 1.0, 0.4), row("fine", "speed", 0.5, 1.0), row("fine", "spin", math.nan, 1.0)]
    depth, lost = {"exact": -1e-9, "coarse": 0.25, "fine": 0.0012}, {"exact": 0, "coarse": 3, "fine": 0}
    assert long_table({"comparisons": rows, "depth": {"noise": depth}, "lost": {"noise": lost}}) == [
        "| setting | differs | in | most | mm deep, noise | lost |",
        "| --- | --- | --- | --- | --- | --- |",
        "| exact | reference |  |  | 0 | 0 |",
        "| coarse | 2 of 3 | rate, speed | -50.0 % (-55.0 to -45.0) | 250 | 3 |",
        "| fine | 0 of 2 |  | 10.0 to 20.0 % would have been seen | 1.2 | 0 |",
    ]


# -- picture ----------------------------------------------------------------------------------------------------------


def test_the_picture_shows_trainings_intervals_margin_and_verdicts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept: list[Any] = []
    monkeypatch.setattr(plt, "close", kept.append)
    single = OPEN._replace(fidelity="fine", loss=Estimate(-3.0, math.inf))  # one training has no interval
    picture({"juggle": [HARMFUL, single, SAFE._replace(fidelity=EXACT)], "spin": [SAFE]}, tmp_path / "p.png")
    assert (tmp_path / "p.png").stat().st_size > 10_000
    panel, other = kept[0].axes
    monkeypatch.undo()
    plt.close(kept[0])
    assert (panel.get_title(loc="left"), other.get_title(loc="left")) == ("juggle", "spin")
    assert [text.get_text() for text in panel.texts] == ["harmful", "undecided", "reference"]
    assert [label.get_text() for label in panel.get_yticklabels()] == [
        "trained on coarse", "trained on fine", "trained on exact",
    ]  # fmt: skip
    across = [np.asarray(line.get_xdata(), dtype=float).tolist() for line in panel.lines]
    assert [1.0, -5.0, 4.0] in across  # in percent of the return of 100
    assert [-100.0 * MARGIN] * 2 in across
    bars = [container.lines[2][0].get_segments()[0][:, 0].tolist() for container in panel.containers]
    assert bars == [[-12.0, -8.0], [-3.0, -3.0], [0.0, 0.0]]


# -- docs/learning.md -------------------------------------------------------------------------------------------------


def test_the_committed_page_is_what_its_data_say() -> None:
    assert page(read_data(DOCS / "learning.json")) == (DOCS / "learning.md").read_text()


def test_the_page_is_written_again_from_its_data_alone(tmp_path: Path) -> None:
    data = read_data(DOCS / "learning.json")
    assert write(data, tmp_path) == (DOCS / "learning.md").read_text()
    for name in ("learning.md", "learning.json"):
        assert (tmp_path / name).read_bytes() == (DOCS / name).read_bytes()
    assert (tmp_path / "learning.png").stat().st_size > 10_000


def test_other_numbers_make_another_page() -> None:
    data = read_data(DOCS / "learning.json")
    lowered = np.subtract(data["returns"]["juggle"]["trained"]["balanced"]["exact"], 50.0).tolist()
    data["returns"]["juggle"]["trained"]["balanced"]["exact"] = lowered
    text = page(data)
    assert "On `juggle`, stay with `exact`: no other fidelity is shown to be safe; training on `balanced` costs" in text
    assert "| juggle | balanced | harmful | -20.6 %" in text


def test_the_committed_page_is_of_todays_fidelities_and_margin() -> None:
    text = (DOCS / "learning.md").read_text()
    assert read_data(DOCS / "learning.json")["fidelities"] == resolved_fidelities()
    assert set(re.findall(r"^\| juggle \| (\w+)", text, re.MULTILINE)) == set(FIDELITIES)
    assert f"stays above -{100 * MARGIN:.0f} %" in text
    assert f"within {100 * MARGIN:.0f} %" in text


def test_the_committed_page_opens_with_the_answer_and_has_short_tables() -> None:
    text = (DOCS / "learning.md").read_text()
    opening = re.sub(r"<!--.*?-->\n", "", text).split("\n\n")[1]
    assert len(re.findall(r"\.(?:\[\^\w+\])?$", opening, re.MULTILINE)) == 3
    assert "undecided" not in opening
    assert text.index("![") < text.index("| ---")
    tables = re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE)
    assert len(tables) == 4
    assert all(len(table.splitlines()) <= 12 for table in tables)  # ten rows below a header and its line


def test_pictures_and_links_of_the_committed_page_are_there() -> None:
    links = re.findall(r"\]\(([\w./]+)\)", (DOCS / "learning.md").read_text())
    assert set(links) == {"learning.png", "learning.json", "learning_loss.md"}
    assert all((DOCS / link).is_file() for link in links)


def test_trainings_that_earn_less_than_a_script_are_called_short() -> None:
    for earned, short in ((100.0, True), (200.0, False)):
        returns: Returns = {
            "trained": {"exact": {"exact": [[earned, earned]]}},
            "baselines": {"level": {"exact": [149.0, 151.0]}},
        }
        assert ("the scripted `level` earns 150.0" in too_short("juggle", returns)) is short


def test_the_page_with_loss_is_written_from_its_data_and_names_its_size() -> None:
    data, text = read_data(DOCS / "learning_loss.json"), (DOCS / "learning_loss.md").read_text()
    assert page_with_loss(data, "learning_loss.png") == text
    settings = settings_from(data["settings"])
    assert f"- Trainings: {settings.seeds} of each task and fidelity, {settings.total_steps[0]:,} steps on" in text
    assert f"at restitution {settings.restitution:g}" in text.splitlines()[0]
    assert "--folder" not in text
    assert (DOCS / "learning_loss.png").is_file()


def test_the_command_on_the_page_makes_the_study_and_is_that_of_make() -> None:
    made = re.search(r"Made by `(.*?)`", (DOCS / "learning.md").read_text())
    assert made is not None
    words = shlex.split(made[1])
    assert words[:2] == ["python", "scripts/studies/transfer/transfer.py"]
    settings = settings_from(read_data(DOCS / "learning.json")["settings"])
    assert tyro.cli(Arguments, args=words[2:]) == Arguments(settings, out=Path("docs"))
    assert replace(settings, seeds=3, total_steps=StudySettings.total_steps) == StudySettings()
    assert f"/{made[1]}\n" in (ROOT / "Makefile").read_text()
