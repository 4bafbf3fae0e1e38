"""The record and the page: failing rows show, a run of some rows leaves the others, and tests write nothing else."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest

from jackbox_env.simulators import CONTACT_MODELS
from tests.extremes import __main__ as command
from tests.extremes.page import (
    FAILS,
    HOLDS,
    PARTS,
    RECORD,
    REFUSED,
    TABLE,
    Bound,
    Finding,
    extreme,
    missing,
    noted,
    page,
    read,
    recorded,
    refuses,
    refuses_each,
    within,
)

TWO = TABLE[:2]
FOUND = Finding("error at most 1e-12 m", "error 1e-15 of 1e-12 m", HOLDS)


@pytest.fixture
def record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(RECORD, str(tmp_path / "findings.jsonl"))
    return tmp_path / "findings.jsonl"


def rows(text: str) -> list[str]:
    return [line for line in text.splitlines() if line.startswith(("| one impact", "| 4 s"))]


# -- what is recorded --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seen", [2e-12, float("nan"), float("inf")])
def test_a_case_over_its_bound_fails_and_its_record_says_so(seen: float, record: Path) -> None:
    with pytest.raises(AssertionError, match="one thing, exact: expected error at most 1e-12 m; seen error"):
        noted("one thing", "exact", lambda contact: within(Bound("error", seen, 1e-12, "m")))
    finding = read(record)["one thing", "exact"]
    assert finding == Finding("error at most 1e-12 m", f"error {seen:.0e} of 1e-12 m".replace("e-12", "e-12"), FAILS)


def test_a_case_that_holds_is_recorded(record: Path) -> None:
    noted("one thing", "exact", lambda contact: within(Bound("error", 1e-15, 1e-12, "m"), note="; no impact"))
    (found,) = read(record).values()
    assert found == Finding("error at most 1e-12 m; no impact", "error 1e-15 of 1e-12 m; no impact", HOLDS)


def test_a_case_that_raises_or_is_cut_short_does_not_vanish(record: Path) -> None:
    def raises(error: BaseException) -> Any:
        raise error

    with pytest.raises(RuntimeError):
        noted("one", "exact", lambda contact: raises(RuntimeError("the jack would leave")))
    with pytest.raises(KeyboardInterrupt):
        noted("other", "exact", lambda contact: raises(KeyboardInterrupt()))
    found = read(record)
    assert found["one", "exact"] == Finding("no error", "RuntimeError: the jack would leave", FAILS)
    assert found["other", "exact"].verdict == FAILS


def test_an_ordinary_run_writes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(RECORD, raising=False)
    monkeypatch.chdir(tmp_path)
    docs = {path: path.stat().st_mtime_ns for path in command.DOCS.glob("extremes*")}
    noted("one thing", "exact", lambda contact: FOUND)
    assert list(tmp_path.iterdir()) == []
    assert docs == {path: path.stat().st_mtime_ns for path in command.DOCS.glob("extremes*")}


# -- the page ----------------------------------------------------------------------------------------------------------


def test_the_page_shows_what_is_recorded() -> None:
    findings = read(command.DOCS / "extremes.jsonl")
    assert (command.DOCS / "extremes.jsonl").read_text() == recorded(findings)
    assert (command.DOCS / "extremes.md").read_text() == page(findings)


def test_rows_stand_in_the_tables_order_in_short_tables() -> None:
    found = {(what, contact): FOUND for what in reversed(TABLE) for contact in reversed(CONTACT_MODELS)}
    text = page(found)
    places = [text.index(f"\n| {what} |") for what in TABLE]
    assert places == sorted(places)
    parts = text.split("\n## ")[1:]
    assert [part.splitlines()[0] for part in parts] == list(PARTS.values())
    assert max(part.count("\n| ") for part in parts) <= 11  # ten rows and the head
    assert f"{len(TABLE)} extremes were given to both contact models: {2 * len(TABLE)} answers hold" in text
    assert rows(text)[0] == f"| {TABLE[0]} | holds: error 1e-15 of 1e-12 m | holds: error 1e-15 of 1e-12 m |"


def test_a_failing_row_shows_in_the_table_and_in_the_first_sentence() -> None:
    found = {(what, contact): FOUND for what in TWO for contact in CONTACT_MODELS}
    found[TWO[1], "pymunk"] = Finding("no error", "RuntimeError: the jack would leave\nthe | box", FAILS)
    text = page(found)
    assert rows(text)[1].startswith(f"| {TWO[1]} | FAILS: RuntimeError: the jack would leave the \\| box | holds: ")
    assert "and 1 FAIL." in text.split("\n\n")[1]


def test_a_row_that_was_never_run_is_missing_and_is_no_row() -> None:
    found = {(TWO[0], contact): FOUND for contact in CONTACT_MODELS} | {(TWO[1], "exact"): FOUND}
    assert missing(found, TWO) == [TWO[1]]
    del found[TWO[1], "exact"]
    assert len(rows(page(found))) == 1


def test_the_command_adds_what_was_run_to_the_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def ran(arguments: list[str], env: dict[str, str], check: bool) -> Any:
        assert arguments[-2:] == ["-k", "mass"]
        assert env["JACKBOX_EXTREMES"] == "full"
        Path(env[RECORD]).write_text(json.dumps([TWO[0], "exact", *FOUND]) + "\n")
        return type("Ended", (), {"returncode": 0})

    old = Finding("", "an older one", HOLDS)
    before = {(what, contact): old for what in TABLE for contact in CONTACT_MODELS}
    (tmp_path / "extremes.jsonl").write_text(recorded(before))
    monkeypatch.setattr(subprocess, "run", ran)
    assert command.main(["-k", "mass"], tmp_path) == 0
    assert read(tmp_path / "extremes.jsonl") == before | {(TWO[0], "exact"): FOUND}
    assert rows((tmp_path / "extremes.md").read_text())[0].endswith(
        "| holds: an older one | holds: " + FOUND.seen + " |"
    )
    (tmp_path / "extremes.jsonl").unlink()
    assert command.main(["-k", "mass"], tmp_path) == 1  # the other rows were never run
    assert sorted(os.listdir(tmp_path)) == ["extremes.jsonl", "extremes.md"]


# -- refusals ----------------------------------------------------------------------------------------------------------


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
    assert set(PARTS) <= set(TABLE)
    assert TABLE[0] in PARTS
