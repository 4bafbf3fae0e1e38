"""The page itself: failing rows show, incomplete runs write nothing, shorter runs leave the longer ones' rows."""

from __future__ import annotations

from pathlib import Path

import pytest

from jackbox_env.simulators import CONTACT_MODELS
from tests.extremes.page import FAILS, HOLDS, REFUSED, Bound, Finding, Page, extreme, refuses, refuses_each, within

TWO = ("one thing", "another")


def noted(**answers: Finding) -> Page:
    """A complete page of two cases, all as expected but for those of exact that are given."""
    page = Page(TWO)
    for what in reversed(TWO):  # not the table's order
        for contact in reversed(CONTACT_MODELS):
            finding = answers.get(what.split()[0], within(Bound("error", 1e-15, 1e-12, "m")))
            page.findings[what, contact] = finding if contact == "exact" else within(Bound("error", 0.0, 1e-12, "m"))
    return page


def rows(folder: Path) -> list[str]:
    return [line for line in (folder / "extremes.md").read_text().splitlines() if line.startswith(("| one", "| anot"))]


def test_a_complete_run_writes_its_rows_in_the_tables_order(tmp_path: Path) -> None:
    assert noted().write(tmp_path, full=False)
    assert rows(tmp_path) == [
        "| one thing | pymunk | error at most 1e-12 m | 0 m | holds |",
        "| one thing | exact | error at most 1e-12 m | 1e-15 m | holds |",
        "| another | pymunk | error at most 1e-12 m | 0 m | holds |",
        "| another | exact | error at most 1e-12 m | 1e-15 m | holds |",
    ]
    assert [path.name for path in tmp_path.iterdir()] == ["extremes.md"]
    assert not noted().write(tmp_path, full=False)  # nothing new


@pytest.mark.parametrize("seen", [2e-12, float("nan"), float("inf")])
def test_a_case_over_its_bound_fails_and_its_row_says_so(seen: float, tmp_path: Path) -> None:
    page = noted()
    with pytest.raises(AssertionError, match="one thing, exact: expected error at most 1e-12 m; seen"):
        page.note("one thing", "exact", lambda contact: within(Bound("error", seen, 1e-12, "m")))
    assert page.write(tmp_path)
    assert (
        rows(tmp_path)[1]
        == f"| one thing | exact | error at most 1e-12 m | {Bound('', seen, 0.0).worded(seen)} m | FAILS |"
    )


def test_a_case_that_raises_fails_and_its_row_says_what(tmp_path: Path) -> None:
    def broken(contact: str) -> Finding:
        raise RuntimeError("the jack would leave\nthe | box")

    page = noted()
    with pytest.raises(RuntimeError):
        page.note("another", "pymunk", broken)
    assert page.write(tmp_path)
    assert (
        rows(tmp_path)[2] == "| another | pymunk | no error | RuntimeError: the jack would leave the \\| box | FAILS |"
    )


def test_a_case_cut_short_does_not_vanish() -> None:
    def cut_short(contact: str) -> Finding:
        raise KeyboardInterrupt

    page = Page(TWO)
    with pytest.raises(KeyboardInterrupt):
        page.note("another", "exact", cut_short)
    assert page.findings["another", "exact"].verdict == FAILS


def test_some_cases_alone_write_nothing(tmp_path: Path) -> None:
    page = noted()
    del page.findings["another", "exact"]
    assert not page.complete
    assert not page.write(tmp_path)
    assert not list(tmp_path.iterdir())


def test_without_a_folder_to_write_in_nothing_is_written(tmp_path: Path) -> None:
    assert not noted().write(tmp_path / "missing")
    (tmp_path / "extremes.md").mkdir()  # can not be replaced, whoever runs the test
    assert not noted().write(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["extremes.md"]


def test_a_shorter_run_that_holds_leaves_the_row_of_a_longer_one(tmp_path: Path) -> None:
    long, short = (Finding(f"over {steps} steps", "0 m", HOLDS, steps) for steps in (1000, 10))
    assert noted(one=short).write(tmp_path, full=False)  # there was none yet
    assert "over 10 steps" in rows(tmp_path)[1]
    assert noted(one=long).write(tmp_path, full=True)
    before = rows(tmp_path)
    assert "over 1000 steps" in before[1]
    assert not noted(one=short).write(tmp_path, full=False)
    other = within(Bound("error", 1e-13, 1e-12, "m"))
    assert noted(one=short, another=other).write(tmp_path, full=False)
    assert rows(tmp_path)[:3] == before[:3]
    assert "1e-13" in rows(tmp_path)[3]


def test_a_shorter_run_that_fails_replaces_the_row_and_only_a_longer_one_clears_it(tmp_path: Path) -> None:
    long, short = (Finding(f"over {steps} steps", "0 m", HOLDS, steps) for steps in (1000, 10))
    noted(one=long).write(tmp_path, full=True)
    assert noted(one=short._replace(verdict=FAILS)).write(tmp_path, full=False)
    assert "over 10 steps | 0 m | FAILS" in rows(tmp_path)[1]
    assert not noted(one=short).write(tmp_path, full=False)
    assert noted(one=long).write(tmp_path, full=True)
    assert "over 1000 steps | 0 m | holds" in rows(tmp_path)[1]


def test_refusals_are_sentences_that_match() -> None:
    def refuse() -> None:
        raise ValueError("mass must be above 0, got -1" + 200 * "!")

    assert refuses(refuse, "mass must be").verdict == REFUSED
    assert len(refuses(refuse, "mass must be").seen) == 150
    assert refuses(refuse, "length must be").verdict == FAILS
    assert refuses(lambda: None, "").verdict == FAILS
    both = refuses_each({"one": (refuse, "mass"), "other": (lambda: None, ".*")})
    assert (both.verdict, both.seen) == (FAILS, "1 of 2, e.g. other: taken without a word")
    assert refuses_each({"one": (refuse, "mass")}).verdict == REFUSED


def test_a_case_without_a_place_in_the_table_is_refused() -> None:
    with pytest.raises(ValueError, match="'a third' has no place in the table"):
        extreme("a third")
    with pytest.raises(ValueError, match="'a third' has no place in the table"):
        Page(TWO).note("a third", "exact", lambda contact: within())
