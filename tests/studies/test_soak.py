"""The soak command: it goes on where it ended, says which law was broken in which case, and its report stays small."""

from __future__ import annotations

import re
import sys

import pytest

from jackbox_env.simulators.exact import ExactSimulator
from scripts.studies.laws import soak
from scripts.studies.laws.laws import KEPT, Examination, examine
from scripts.studies.laws.random_cases import Case


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    """The command's exit status."""
    monkeypatch.setattr(sys, "argv", ["soak.py", "--no-progress", *arguments])
    with pytest.raises(SystemExit) as ended:
        soak.main()
    return int(ended.value.code or 0)


def test_an_interrupted_soak_tells_what_it_found_and_goes_on(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    examined: list[Case] = []

    def interrupted(case: Case) -> Examination:
        examined.append(case)
        if len(examined) == 6:  # within a case: one of the two models is done
            raise KeyboardInterrupt
        return examine(case)

    monkeypatch.setattr(soak, "examine", interrupted)
    assert run(monkeypatch, "--cases", "4") == 130
    assert capsys.readouterr().out.endswith("go on with --first 2\n")
    assert run(monkeypatch, "--cases", "2", "--first", "2") == 0
    assert capsys.readouterr().out.endswith("go on with --first 4\n")
    assert examined[4:6] == examined[6:8]  # the interrupted case is examined again
    assert len(examined) == 10


def test_a_broken_law_is_told_with_its_case_which_can_be_examined_again(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    step = ExactSimulator.step

    def gains(self: ExactSimulator, dt: float, torque: float | None = None) -> None:
        step(self, dt, torque)
        state = self.state
        state[8] += 1e-3
        self._present = self._present._replace(state=state)

    monkeypatch.setattr(ExactSimulator, "step", gains)
    assert run(monkeypatch, "--cases", "13", "--contact", "exact") == 1
    told = capsys.readouterr().out
    assert "cases that broke a law: 13" in told
    assert len(re.findall(r"^--first \d+ --cases 1 --contact exact: ", told, re.MULTILINE)) == KEPT
    again = next(line for line in told.splitlines() if line.startswith("--first 0 "))
    command, found = again.split(": ", 1)
    assert found.startswith("energy: ")
    assert run(monkeypatch, *command.split()) == 1
    assert found in capsys.readouterr().out
    monkeypatch.setattr(ExactSimulator, "step", step)
    assert run(monkeypatch, *command.split()) == 0
    assert "cases that broke a law: 0" in capsys.readouterr().out
