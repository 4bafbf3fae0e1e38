"""The runner of studies: parts, resumed trials, the record and the page, by a small study."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from scripts.studies import study

CALLS: list[tuple[str, int]] = []


def squared(number: int) -> int:
    CALLS.append(("squared", number))
    return number**2


def timed(number: int) -> dict[str, int]:
    CALLS.append(("timed", number))
    return {"seconds": number}


@dataclass(frozen=True)
class Arguments(study.Arguments):
    """Square."""

    number: int = 3
    """Numbers that are squared."""


def trials(arguments: Arguments) -> study.Trials:
    squares = [{"part": "squared", "number": number} for number in range(arguments.number)]
    return [{"part": "timed", "number": arguments.number}, *squares]


def filled(record: study.Record) -> dict[str, str]:
    return {"squares": ", ".join(map(str, record["squared"])), "seconds": str(record["timed"]["seconds"])}


SMALL = study.Study(
    "small", {"squared": squared, "timed": timed}, filled, Arguments, trials, frozenset({"timed"}), frozenset({"timed"})
)
Run = Callable[..., study.Record]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    (tmp_path / "small").mkdir()
    (tmp_path / "small" / "page.md").write_text("{squares}; {seconds}\n{made}\n")
    (tmp_path / "docs").mkdir()
    monkeypatch.setattr(study, "__file__", str(tmp_path / "study.py"))
    monkeypatch.chdir(tmp_path)
    CALLS.clear()

    def run(*words: str, of: study.Study = SMALL) -> study.Record:
        monkeypatch.setattr(sys, "argv", ["small.py", "--no-progress", *words])
        study.main(of, "")
        return of.read(Path("docs"))

    return run


def test_parts_are_measured_and_the_page_is_filled_from_the_record(run: Run) -> None:
    record = run()
    assert CALLS == [("squared", 0), ("squared", 1), ("squared", 2), ("timed", 3)]  # what is timed comes last
    assert record["squared"] == [0, 1, 4]
    assert record["timed"] == {"seconds": 3}
    assert "; number 3. " in record["made"]["timed"]
    assert "number" not in record["made"]["squared"]
    page = Path("docs/small.md").read_text()
    assert page.startswith("0, 1, 4; 3\n- ")
    assert page.count("`squared` at commit") == page.count("`timed` at commit") == page.count("\n- ") == 1


def test_one_part_is_measured_again_and_the_others_stay(run: Run) -> None:
    first = run()
    CALLS.clear()
    record = run("--parts", "timed", "--number", "7", "--runs", "again")
    assert CALLS == [("timed", 7)]
    assert (record["squared"], record["timed"]) == ([0, 1, 4], {"seconds": 7})
    assert record["made"]["squared"] == first["made"]["squared"]
    CALLS.clear()
    assert run("--render") == record
    assert CALLS == []


def test_an_interrupted_study_continues_and_one_with_other_arguments_does_not(
    run: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(number: int) -> int:
        if number == 2:
            raise KeyboardInterrupt
        return squared(number)

    with pytest.raises(SystemExit) as stopped:
        run("--runs", "cut", of=replace(SMALL, parts={**SMALL.parts, "squared": interrupted}))
    assert stopped.value.code == 130
    assert "--runs" in capsys.readouterr().err
    record = run("--runs", "cut")
    assert CALLS == [("squared", 0), ("squared", 1), ("squared", 2), ("timed", 3)]
    assert record["squared"] == [0, 1, 4]
    with pytest.raises(SystemExit):
        run("--runs", "cut", "--number", "4")
    assert "begun with other arguments" in capsys.readouterr().err


def test_a_failed_trial_is_named_and_nothing_is_stored(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    def failing(number: int) -> int:
        return 1 // number

    with pytest.raises(SystemExit) as stopped:
        run(of=replace(SMALL, parts={**SMALL.parts, "squared": failing}))
    assert stopped.value.code == 2
    assert "1 of 3 trials failed" in capsys.readouterr().err
    assert not list(Path("docs").iterdir())


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--parts", "cubed"), "cubed"),
        (("--parts", "timed"), "parts must name squared too"),
        (("--render",), "parts must name squared and timed too"),
    ],
)
def test_parts_that_are_unknown_or_missing_are_refused(
    run: Run, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], sentence: str
) -> None:
    with pytest.raises(SystemExit):
        run(*words)
    assert sentence in capsys.readouterr().err
    assert CALLS == []


def test_a_machine_is_named_once_with_all_commits_of_its_trials() -> None:
    commits = ["one, commit b", "two, commit c", "one, commit a", "one, commit b"]
    rows = [{"part": "squared", "result": number, "made": made} for number, made in enumerate(commits)]
    assert study.by_part(SMALL, rows)["made"] == {"squared": "one, commit a, b; two, commit c."}
