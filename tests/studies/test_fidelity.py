"""The study of what a fidelity does to a learner, made small."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from agents.sweeps.results_log import LOG
from scripts.studies import fidelity

TINY = {"total_steps": 512, "num_envs": 4, "rollout_steps": 64, "batch_size": 64, "eval_steps": 512}
TINY |= {"eval_episodes": 2}
SMALL = ("--fidelities", "balanced", "exact", "--seeds", "2", "--episodes", "2", "--no-progress")


def test_every_model_runs_on_every_fidelity_and_nothing_runs_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(*given: str) -> str:
        command = ["fidelity.py", "--folder", str(tmp_path / "study"), "--train", json.dumps(TINY), *SMALL, *given]
        monkeypatch.setattr(sys, "argv", command)
        fidelity.main()
        return capsys.readouterr().out

    shown = run()
    logs = [tmp_path / "study" / name / LOG for name in ("trainings", "returns")]
    lines = [log.read_text().splitlines() for log in logs]
    assert [len(one) for one in lines] == [4, 8]  # two trainings on each of two fidelities, each run on both
    assert run() == shown
    assert [log.read_text().splitlines() for log in logs] == lines
    for given, said in ((("--seeds", "3"), "other arguments"), (("--fidelities", "{}"), "fidelities")):
        with pytest.raises(SystemExit):
            run(*given)
        assert said in capsys.readouterr().err


def test_the_table_has_means_and_intervals_over_the_trainings() -> None:
    rows = [("fine", "fine", 1.0), ("fine", "exact", 5.0), ("exact", "fine", 7.0), ("exact", "exact", 9.0)]
    rows += [(one, other, mean + 2.0) for one, other, mean in rows]
    # Two trainings 2 apart: a standard error of 1, and Student's t for one degree of freedom is 12.706.
    cells = [line.split("|")[2:4] for line in fidelity.table(rows).splitlines()[2:]]
    assert [[cell.strip() for cell in line] for line in cells] == [
        ["2.0 ± 12.7", "6.0 ± 12.7"],
        ["8.0 ± 12.7", "10.0 ± 12.7"],
    ]
