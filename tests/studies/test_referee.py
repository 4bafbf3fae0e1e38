"""The referee: its scores of known outputs, its refusals, and the programs on the page of the reference."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jackbox_env.measure.accuracy import follow
from jackbox_env.mechanics import energy
from jackbox_env.model.states import THETA_BOX, THETA_JACK, VX_JACK, X_JACK, Array
from jackbox_env.simulators import Impact, make_simulator
from scripts import referee
from tests import reference
from tests.script import script

NODE = pytest.mark.skipif(shutil.which("node") is None, reason="Node is missing: apt-get install nodejs")


def played(name: str) -> tuple[referee.Known, Array, Array, list[Impact]]:
    """A case, and times, states and impacts of the exact model."""
    known = referee.reference()[name]
    course = follow(make_simulator(known[0].scene, "exact"), known[0], inspect=None)
    return known, known[0].dt * np.arange(len(course.states), dtype=float), course.states, course.impacts


def write(folder: Path, *names: str) -> tuple[Path, Path]:
    """Files of the exact model's states and impacts."""
    states, impacts = [",".join(referee.STATES)], [",".join(referee.IMPACTS)]
    for name in names:
        _, times, numbers, hits = played(name)
        rows = zip(times.tolist(), numbers.tolist(), strict=True)
        states += [",".join([name, *map(repr, (time, *row))]) for time, row in rows]
        impacts += [f"{name},{hit.time!r},{hit.wall},{hit.foot}" for hit in hits]
    files = folder / "states.csv", folder / "impacts.csv"
    for file, lines in zip(files, (states, impacts), strict=True):
        file.write_text("\n".join(lines) + "\n")
    return files


# -- scores ------------------------------------------------------------------------------------------------------------


def test_right_output_is_complete() -> None:
    for name in ("chirp-2", "held-e0.6", "corner", "flight"):
        score = referee.score(*played(name))
        assert score.complete
        assert score.correct == score.known == len(referee.reference()[name][1])
        assert not score.escaped
        assert score.penetration == 0.0
        assert max(score.errors or [0.0]) < 1e-10
        assert (score.imbalance is None) == (name in ("chirp-2", "held-e0.6"))
        assert score.imbalance is None or score.imbalance < 1e-13
        assert (score.pose or 0.0) < 1e-8
        assert (score.rate or 0.0) < 1e-8


@pytest.mark.parametrize(
    ("change", "correct"),
    [
        (lambda hits: [*hits[:3], hits[3]._replace(foot=(hits[3].foot + 1) % 4), *hits[4:]], 3),
        (lambda hits: [*hits[:2], *hits[3:]], 2),
        (lambda hits: [*hits[:5], hits[5]._replace(time=hits[5].time + 0.011), *hits[6:]], 5),
        (lambda hits: [*hits[:1], hits[0], *hits[1:]], 1),
    ],
    ids=["another foot", "one missing", "one late", "one twice"],
)
def test_impacts_count_until_the_first_wrong_one(change: Any, correct: int) -> None:
    known, times, states, impacts = played("chirp-2")
    score = referee.score(known, times, states, change(impacts))
    assert score.correct == correct
    assert score.complete is False


def test_impacts_reported_at_one_time_have_no_order_and_others_make_a_case_incomplete() -> None:
    known, times, states, (first, second) = played("two-feet")
    swapped = [second._replace(time=first.time), first]
    assert referee.score(known, times, states, swapped).complete
    assert not referee.score(known, times, states, [second, first._replace(time=second.time + 1e-6)]).correct
    more = referee.score(known, times, states, [first, second, second._replace(time=1.9)])
    assert (more.correct, more.complete) == (2, False)
    assert "2 of 2, and others" in referee.table_of([more])
    assert referee.score(known, times, states, None).correct is None


def test_states_are_scored_by_penetration_energy_and_escape() -> None:
    known, times, states, _ = played("graze-passes")
    deep = states.copy()
    deep[3, X_JACK] += 6.5
    inside, moved = referee.score(known, times, states, None), referee.score(known, times, deep, None)
    assert inside.penetration == 0.0
    assert not inside.escaped
    assert moved.escaped
    assert moved.penetration > 2.0
    faster = states.copy()
    faster[50:76, VX_JACK] *= 1.1
    gained = energy(known[0].scene, faster[50]) - energy(known[0].scene, states[50])
    assert referee.score(known, times, faster, None).imbalance == pytest.approx(
        gained / energy(known[0].scene, faster[50])
    )
    assert referee.score(known, times[:50], states[:50], None).escaped
    known, times, states, _ = played("bounce")  # which starts at rest
    assert referee.score(known, times[:1], states[:1], []) == ("bounce", 1, 0, False, [], 0.0, 0.0, True, None, None)


@pytest.mark.parametrize("name", ["bounce", "held-e0.6", "chirp-2", "flight", "corner"])
@pytest.mark.parametrize("with_impacts", [True, False])
def test_states_that_never_move_or_have_no_rates_are_errors(name: str, with_impacts: bool) -> None:
    known, times, states, impacts = played(name)
    reported = impacts if with_impacts else None
    still = referee.score(known, times, np.repeat(states[:1], len(states), axis=0), reported)
    assert still.complete is (True if with_impacts else None)  # with the right impacts
    assert (still.pose or 0.0) > 0.02
    resting = referee.score(known, times, np.where(np.arange(12) < 6, states, states[0]), reported)
    assert (resting.pose or 0.0) < 1e-8
    assert (resting.rate or 0.0) > 0.2


def test_the_motion_after_the_first_wrong_impact_does_not_count() -> None:
    known, times, states, impacts = played("chirp-2")
    late, wrong = times > impacts[3].time, [*impacts[:3], impacts[3]._replace(foot=(impacts[3].foot + 1) % 4)]
    other = np.where(late[:, None], states + 1.0, states)
    assert (referee.score(known, times, other, wrong).pose or 0.0) < 1e-8
    assert (referee.score(known, times, other, impacts).pose or 0.0) > 0.9
    assert referee.score(known, times, other, []).pose == referee.score(known, times, other, None).pose


@pytest.mark.parametrize("name", ["held-0", "flight", "spin", "derivatives-2"])
@pytest.mark.parametrize("least", [0.0, -np.pi])
def test_angles_may_wrap(name: str, least: float) -> None:
    known, times, states, impacts = played(name)
    wrapped = states.copy()
    angles = [THETA_BOX, THETA_JACK]
    wrapped[1:, angles] = (states[1:, angles] - least) % (2.0 * np.pi) + least
    plain, score = (referee.score(known, times, numbers, impacts) for numbers in (states, wrapped))
    for one, other in zip(plain[5:], score[5:], strict=True):
        assert one == pytest.approx(other, abs=1e-9)
    assert (wrapped != states).any()


def test_a_state_after_an_impact_at_a_step_end_counts() -> None:
    known, times, states, _ = played("bounce")
    twice = np.repeat(states, 2, axis=0)
    twice[::2, VX_JACK] = 100.0
    assert referee.score(known, np.repeat(times, 2), twice, None).imbalance == pytest.approx(0.0, abs=1e-12)


# -- the command -------------------------------------------------------------------------------------------------------


def test_the_command_prints_a_table_and_writes_scores_and_plot(tmp_path: Path) -> None:
    write(tmp_path, "bounce", "spin")
    printed = script("referee", "states.csv", "--impacts", "impacts.csv", "--folder", "out", cwd=tmp_path).stdout
    assert "38 of 40 cases are missing and not scored: flight, two-feet" in printed
    assert re.search(r"bounce +1 of 1 ", printed)
    written = json.loads((tmp_path / "out" / "scores.json").read_text())
    assert written["summary"]["known"] == 32
    assert [one["case"] for one in written["cases"]] == ["bounce", "spin"]
    assert written["cases"][1]["correct"] >= 11
    assert (tmp_path / "out" / "impacts.png").stat().st_size > 10_000
    assert "out" in script("referee", "states.csv", "--folder", "out", cwd=tmp_path, status=2).stderr


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("case,time,x_box", "case,t,x_box", r"must begin with the columns case,time,x_box.*, got 'case,t,x_box"),
        ("bounce,0.02,", "bonce,0.02,", "line 3: there is no case 'bonce' .did you mean 'bounce'"),
        (
            "bounce,0.02,0.0",
            "bounce,0.02,nan",
            "line 3: a case must be followed by 13 numbers below 1e\\+100, got '0.02,nan",
        ),
        (
            "bounce,0.02,0.0",
            "bounce,0.02,x",
            "line 3: a case must be followed by 13 numbers below 1e\\+100, got '0.02,x",
        ),
        ("bounce,0.02,0.0", "bounce,0.02,1e300", "line 3: .* below 1e\\+100, got '0.02,1e300"),
        ("bounce,0.0,", "bounce,-1,", "line 2: the time must be from 0 s to 2 s, got -1 s"),
        ("bounce,0.02,0.0", "bounce,0.02", "line 3: a case must be followed by 13 numbers below 1e\\+100, got '0.02"),
        (
            "bounce,0.04,",
            "bounce,0.01,",
            "line 4: the time must be from 0.02 s, that of the line before, to 2 s, got 0.01 s",
        ),
        (
            "bounce,2.0,",
            "bounce,2.1,",
            "line 102: the time must be from 1.98 s, that of the line before, to 2 s, got 2.1 s",
        ),
        ("bounce,0.02,", "bounce,0.03,", "bounce must have a state at t = 0.02 s, the end of a control step"),
        (",3,3\n", ",4,3\n", r"walls and feet of bounce must be 0, 1, 2 or 3, got \[4.0, 3.0\]"),
        ("bounce,1.11", "spin,1.11", "spin has impacts, so it must have states too"),
        (",3,3\n", ",3\n", "line 2: a case must be followed by 3 numbers below 1e\\+100, got '1.11"),
        ("bounce,0.02,", "bounce," + "1" * 200_000, "row 3: field larger than field limit"),
        ("bounce,0.02,", "bounce," + "1" * 100_000 + ",", r"line 3: a case must be followed by 13 .* got '1+\.\.\.$"),
        ("bounce,0.02,", "b" * 100_000 + ",0.02,", r"line 3: there is no case 'b+\.\.\.$"),
        ("\nbounce.*", "\n", "there is no case in the file of states"),
    ],
)
def test_bad_states_and_impacts_are_refused_in_a_sentence(tmp_path: Path, old: str, new: str, sentence: str) -> None:
    files = write(tmp_path, "bounce")
    texts = [file.read_text() for file in files]
    changed = [re.sub(old, new, text, count=1, flags=re.DOTALL) for text in texts]
    assert changed != texts
    for file, text in zip(files, changed, strict=True):
        file.write_text(text)
    command = "states.csv", "--impacts", "impacts.csv", "--folder", "out"
    (line,) = script("referee", *command, cwd=tmp_path, status=2).stderr.splitlines()
    assert re.search(sentence, line)
    assert not (tmp_path / "out").exists()


# -- the page ----------------------------------------------------------------------------------------------------------


@NODE
def test_the_engine_of_the_page_scores_what_the_page_says(tmp_path: Path) -> None:
    for name in ("cases.json", "engine.js"):
        shutil.copy(reference.FOLDER / name, tmp_path)
    subprocess.run(["node", "engine.js"], cwd=tmp_path, check=True)
    states = referee.read_table(tmp_path / "states.csv", referee.STATES)
    impacts = referee.read_table(tmp_path / "impacts.csv", referee.IMPACTS)
    scores = referee.scores_of(states, impacts, referee.TOLERANCE)
    total = referee.summary(scores)
    assert [one.case for one in scores if not one.complete] == ["spin", "graze-hits"]
    counted = f"{total['complete']} of its {total['cases']} cases complete"
    assert f"{counted}, and first impacts correct to {total['first_worst']:.2g} s" in reference.PAGE.read_text()
