"""What a study of transfer concludes from numbers, and that it is made, interrupted, resumed and written down."""

from __future__ import annotations

import json
import math
import os
import shlex
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import tyro
from numpy.typing import NDArray

import jackbox_env  # noqa: F401
from agents.checkpoints import model_file
from agents.models import make_ppo, make_vec_env
from agents.policies import baseline
from agents.settings import TrainSettings
from agents.storage import FolderInUseError, held
from jackbox_env import FIDELITIES, Impact, Scene
from jackbox_env.tasks import sample_start
from scripts.studies.transfer import study as transfer
from scripts.studies.transfer.inference import Estimate, Floats, two_sided
from scripts.studies.transfer.longrun import (
    DT,
    SETTINGS,
    STATISTICS,
    STEPS,
    Episodes,
    acting,
    drive,
    random_torques,
    run_episodes,
    stored,
)
from scripts.studies.transfer.page import commands, fidelities_line, one_iteration, statistics_table
from scripts.studies.transfer.study import StudySettings, cell, new_study, read_study, resolved_fidelities, train_all
from scripts.studies.transfer.transfer import Arguments, main
from scripts.studies.transfer.verdict import (
    MARGIN,
    Finding,
    baseline_shift,
    compare,
    failures_sentence,
    finding,
    headline,
    sentence,
    statistics_sentence,
)

ROOT = Path(__file__).parents[1]

# -- comparisons ------------------------------------------------------------------------------------------------------


def planted_runs(rng: np.random.Generator) -> dict[str, dict[str, dict[str, NDArray[np.float64]]]]:
    """Two statistics; ``coarse`` has the one 10 % higher, ``wide`` spreads the other twice as far."""

    def sample(mean: float = 1.0, spread: float = 0.2, other: float = 0.2) -> dict[str, NDArray[np.float64]]:
        return {"rate": rng.normal(mean, spread, 500), "speed": rng.normal(5.0, other, 500)}

    return {"noise": {"exact": sample(), "coarse": sample(1.1), "wide": sample(other=0.4), "exact again": sample()}}


def test_comparisons_find_what_is_planted_and_nothing_else() -> None:
    rng = np.random.default_rng(5)
    rows = {(row.setting, row.statistic): row for row in compare(planted_runs(rng), rng)}
    assert {name for name, row in rows.items() if row.differs} == {("coarse", "rate"), ("wide", "speed")}
    found = rows["coarse", "rate"]
    assert found.difference.low < 0.1 < found.difference.high
    assert found.mean_probability < 0.001
    wide = rows["wide", "speed"]
    assert wide.shape_probability < 0.05 < wide.mean_probability
    same = rows["exact again", "rate"]
    assert not same.differs
    assert 0.03 < same.seen < 0.06  # 0.2 sqrt(2 / 500) (3.04 + 0.84)
    assert "differs from exact in 1 of 2 comparisons, most in rate under noise: +" in statistics_sentence(
        "coarse", list(rows.values())
    )
    nothing = statistics_sentence("exact again", list(rows.values()))
    assert "no difference from exact was found in 2 comparisons" in nothing
    assert "would have been seen with probability 0.8" in nothing


def test_many_comparisons_raise_no_more_false_alarms_than_one() -> None:
    rng = np.random.default_rng(10)
    many = {name: {"rate": rng.normal(size=60)} for name in ("exact", *map(str, range(60)))}
    rows = compare({"noise": many}, rng)
    assert sum(two_sided(row.difference) < 0.025 for row in rows) >= 2  # what would be alarms by themselves
    assert not any(row.differs for row in rows)


def test_episodes_without_a_number_are_left_out_of_its_comparison() -> None:
    rng = np.random.default_rng(6)
    runs = planted_runs(rng)
    runs["noise"]["coarse"]["rate"][:100] = math.nan
    row = next(row for row in compare(runs, rng) if (row.setting, row.statistic) == ("coarse", "rate"))
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
    rows = compare(runs, rng)
    lost = [row for row in rows if (row.condition, row.setting) == ("noise", "coarse")]
    assert [row.episodes for row in lost] == [(500, survivors)] * 2
    assert not any(row.differs for row in lost)
    assert all(row.difference.half_width == math.inf for row in lost)
    assert [row.absent.startswith("all lost") for row in lost] == [survivors == 0] * 2
    words = statistics_sentence("coarse", rows)
    assert ("all lost" in words) == (survivors == 0)
    assert f"differs from exact in 1 of {4 if survivors else 2} comparisons" in words
    # what the other settings came to is found nevertheless
    assert {(row.condition, row.setting) for row in rows if row.differs} == {
        ("noise", "wide"), ("calm", "coarse"), ("calm", "wide"),
    }  # fmt: skip
    assert all(math.isfinite(row.seen) for row in rows if row not in lost)


def test_the_table_says_all_lost_and_keeps_what_the_others_would_have_shown() -> None:
    rng = np.random.default_rng(14)
    name = "impacts [1/s]"
    runs: dict[str, dict[str, dict[str, Floats]]] = {
        "noise": {
            setting: {one: rng.normal(1.0, 0.2, 500) for one in STATISTICS} for setting in ("exact", "coarse", "b")
        }
    }
    runs["noise"]["coarse"] = {one: np.array([]) for one in STATISTICS}
    line = next(line for line in statistics_table("noise", compare(runs, rng)) if line.startswith(f"| {name}"))
    cells = line.split(" | ")
    assert cells[2] == "all lost"
    assert "nan" not in line
    assert 3.0 < float(cells[-1].split(" %")[0]) < 7.0


def test_where_exact_has_no_number_that_is_said() -> None:
    rng = np.random.default_rng(15)
    runs = planted_runs(rng)
    runs["noise"]["exact"]["rate"] = np.array([])
    row = next(row for row in compare(runs, rng) if (row.setting, row.statistic) == ("coarse", "rate"))
    assert row.absent == "all lost on exact"


# -- verdicts ---------------------------------------------------------------------------------------------------------


def made_up(loss: tuple[float, float], shift: tuple[float, float] = (0.0, 1.0)) -> Finding:
    """On a return of 100, where the margin is 5."""
    return Finding("juggle", "coarse", 100.0, 100.0, Estimate(*loss), Estimate(*shift))


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
    assert Finding("spin", "coarse", -100.0, 0.0, Estimate(-2.0, 2.0), Estimate(0.0, 1.0)).learning == "safe"


def test_findings_come_from_the_right_cells() -> None:
    rng = np.random.default_rng(7)

    def returns(mean: float) -> NDArray[np.float64]:
        return mean + rng.normal(size=(3, 64))

    # trained on fast: 120 on itself, 80 on exact; trained on exact: 100 on exact
    trained = {
        "coarse": {"coarse": returns(120.0), "exact": returns(80.0)},
        "exact": {"coarse": returns(90.0), "exact": returns(100.0)},
    }
    found = finding("juggle", trained, "coarse")
    assert found.exact == pytest.approx(100.0, abs=1.0)
    assert found.own == pytest.approx(120.0, abs=1.0)
    assert found.loss.mean == pytest.approx(-20.0, abs=1.0)
    assert found.shift.mean == pytest.approx(40.0, abs=1.0)
    assert (found.learning, found.promise) == ("harmful", "too high")
    assert (found.trainings, found.needed) == (3, 2)  # seeds differ by about 1/8, the margin is 5
    assert found.starts == pytest.approx(1.998 * math.sqrt(2.0 / 3.0 / 64), rel=0.3)
    assert baseline_shift({"coarse": returns(9.0)[0], "exact": returns(7.0)[0]}, "coarse").mean == pytest.approx(
        2, abs=0.6
    )


def test_verdicts_in_words() -> None:
    bad, good = made_up((-10.0, 2.0), (20.0, 3.0)), replace(made_up((1.0, 2.0)), fidelity="fine")
    assert sentence(bad).startswith(
        "`coarse` is not safe to learn on: run on exact, its policies earn -10.0 % (-12.0 to -8.0) against those"
    )
    assert "its own returns promise too much: +20.0 % (+17.0 to +23.0)" in sentence(bad)
    assert headline("juggle", [bad, good]) == (
        "**Learning `juggle` by shortcut**: safe on average `fine`; not safe `coarse`. Does a policy earn on exact "
        "what it earned on the shortcut it was trained on, within 5%? Yes `fine`; no `coarse`."
    )
    assert sentence(good).startswith("`fine` is safe on average to learn on: run on exact, its policies earn +1.0 %")


@pytest.mark.parametrize(
    ("known", "words"),
    [
        ({"trainings": 5, "needed": 12}, " (at least about 12 of each would): run"),
        ({"trainings": 5, "needed": 4}, " (at least about 6 of each would): run"),  # five were tried
        ({"trainings": 5}, " (more than 1,000 of each would be needed): run"),
        ({"trainings": 5, "starts": 5.1}, " (nor would any number: more episodes are needed, the starts alone"),
        ({"trainings": 1}, ": run"),
    ],
)
def test_what_would_settle_an_open_verdict(known: dict[str, Any], words: str) -> None:
    open_one = replace(made_up((0.0, 9.0)), **known)
    assert f"`coarse` is undecided for learning, so few trainings do not tell{words}" in sentence(open_one)


def test_trainings_that_may_fail_and_the_worst_of_each_fidelity() -> None:
    means = {"coarse": [100.0, 20.0, 110.0, 90.0, 80.0], "exact": [50.0, 50.0, 50.0, 50.0, 40.0]}
    trained = {name: {"exact": np.array([[mean, mean] for mean in row])} for name, row in means.items()}
    words = failures_sentence(trained)
    # 1 - 0.05^(1/5)
    assert "5 trainings cannot exclude that up to 45.1 % of trainings fail" in words
    assert words.endswith("`coarse` seed 1 -75.0 %, `exact` seed 4 -16.7 %.")
    single = {name: {"exact": row["exact"][:1]} for name, row in trained.items()}
    assert "1 training cannot exclude that up to 95.0 % of trainings fail" in failures_sentence(single)


# -- the long run -----------------------------------------------------------------------------------------------------


def test_statistics_of_made_up_impacts() -> None:
    # feet 0 and 1 in step 3 of 4, one at its very end; foot 1 twice in step 4
    impacts = [Impact(2.5 * DT, 0, 0, 4.0), Impact(3.0 * DT, 0, 1, 1.0)]
    impacts += [Impact(3.2 * DT, 1, 1, 2.0), Impact(3.3 * DT, 1, 1, 3.0)]
    speeds, rates = np.array([1.0, 2.0, 3.0, 4.0]), np.array([-1.0, 1.0, -3.0, 3.0])
    seconds = 4 * DT
    found = {name: measure(impacts, speeds, rates) for name, measure in STATISTICS.items()}
    expected = [4 / seconds, 1 / seconds, 10.0 / seconds, 2.5, 3.7, 2.5, 3.7, 2.0]
    assert list(found.values()) == pytest.approx(expected)
    assert math.isnan(STATISTICS["median impulse [N s]"]([], speeds, rates))


@pytest.mark.parametrize("setting", ["balanced", "exact"])
def test_an_episode_of_the_long_run_is_the_environments(setting: str) -> None:
    start = sample_start(Scene(), np.random.default_rng(8))
    found = run_episodes(SETTINGS[setting], drive, np.random.default_rng(8), 1)
    env: Any = gym.make("JackInBox-v0", fidelity=setting, torque="chirp")
    env.reset(options={"state": start})
    infos = [env.step(np.zeros(1, dtype=np.float32))[4] for _ in range(STEPS)]
    speeds = [math.hypot(*info["state"][9:11]) for info in infos]
    assert found.values["impacts [1/s]"][0] == pytest.approx(sum(info["impacts"] for info in infos) / 10.0)
    assert found.values["impulse [N s per s]"][0] == pytest.approx(sum(info["impulse"] for info in infos) / 10.0)
    assert found.values["mean speed of the jack [m/s]"][0] == pytest.approx(np.mean(speeds))
    assert found.lost == 0
    assert found.depth > 0.0 if setting == "balanced" else found.depth < 1e-9


def test_a_policy_acts_in_the_long_run_as_in_the_environment() -> None:
    level = baseline("level", Scene()).policy
    found = run_episodes(SETTINGS["balanced"], acting(Scene(), level), np.random.default_rng(9), 1)
    env: Any = gym.make("JackInBox-v0", fidelity="balanced")
    observation, _ = env.reset(options={"state": sample_start(Scene(), np.random.default_rng(9))})
    total = 0.0
    for _ in range(STEPS):
        observation, *_, info = env.step(level.predict(observation)[0])
        total += info["impulse"]
    assert found.values["impulse [N s per s]"][0] == pytest.approx(total / 10.0)


def test_a_jack_that_leaves_is_counted_and_not_measured() -> None:
    rng, light = np.random.default_rng(0), Scene(box_mass=0.01)
    found = run_episodes(SETTINGS["coarse"], random_torques(light, rng), rng, 4, light)
    assert found.lost + len(found.values["impacts [1/s]"]) == 4
    assert found.lost >= 1


def test_what_was_measured_is_read_again_from_its_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = Episodes({name: np.arange(3.0) + number for number, name in enumerate(STATISTICS)}, 0.25, 2)
    first = stored(tmp_path / "kept" / "x.npz", lambda: made)
    again = stored(tmp_path / "kept" / "x.npz", lambda: pytest.fail("measured twice"))
    path = tmp_path / "kept" / "x.npz"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    third = stored(path, lambda: made)
    assert f"Skipped: {path} is damaged" in capsys.readouterr().err
    assert path.read_bytes() == whole
    for found in (first, again, third):
        assert (found.depth, found.lost) == (0.25, 2)
        assert all(np.array_equal(found.values[name], made.values[name]) for name in STATISTICS)


# -- the study --------------------------------------------------------------------------------------------------------

# Stands for scripts/train.py: notes that it began and when, and finishes or fails as its environment says.
STAND_IN = """
import json, os, pathlib, sys, time
run = pathlib.Path(sys.argv[sys.argv.index("--resume") + 1])
(run.parent / "began.txt").open("a").write(run.name + chr(10))
json.loads((run / "settings.json").read_text())
if os.environ.get("FAILS") == run.name:
    sys.exit("it failed")
time.sleep(float(os.environ.get("LASTS", "0")))
(run / "model.zip").write_bytes((run.parent.parent / "whole.zip").read_bytes())
sys.exit(os.environ.get("ENDS"))
"""


@pytest.fixture
def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A study of two fidelities whose trainings take no time."""
    path = tmp_path / "train.py"
    path.write_text(STAND_IN)
    (tmp_path / "whole.zip").write_bytes(model_file(make_ppo(TrainSettings(), make_vec_env({}, 1, 0))))
    monkeypatch.setattr(transfer, "TRAIN", path)
    return new_study(tmp_path / "study", StudySettings(("juggle",), ("coarse", "exact"), 2))


def test_only_what_is_not_finished_is_trained(stand_in: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = read_study(stand_in)
    assert settings == StudySettings(("juggle",), ("coarse", "exact"), 2)
    monkeypatch.setenv("FAILS", "juggle-exact-0")
    with pytest.raises(RuntimeError, match="juggle-exact-0 ended with status 1; .*log.txt says why"):
        train_all(stand_in, settings, 1, progress=False)
    assert "it failed" in (stand_in / "juggle-exact-0" / "log.txt").read_text()
    monkeypatch.delenv("FAILS")
    train_all(stand_in, settings, 1, progress=False)
    train_all(stand_in, settings, 1, progress=False)
    began = (stand_in / "began.txt").read_text().split()
    # only the one that failed began twice
    assert began == [f"juggle-{run}" for run in ("fast-0", "exact-0", "exact-0", "fast-1", "exact-1")]


def test_a_training_whose_model_was_cut_short_is_not_finished(stand_in: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = read_study(stand_in)
    train_all(stand_in, settings, 2, progress=False)
    model = stand_in / "juggle-exact-1" / "model.zip"
    whole = model.read_bytes()
    for content in (b"", whole[:-1], whole[: len(whole) // 2]):
        model.write_bytes(content)
        monkeypatch.setenv("ENDS", "it was finished by another meanwhile")
        train_all(stand_in, settings, 2, progress=False)
        assert model.read_bytes() == whole
    best = stand_in / "juggle-fast-0" / "best_model.zip"
    best.write_bytes(whole[:-1])
    assert not transfer.finished(best.parent)
    assert (stand_in / "began.txt").read_text().split()[4:] == ["juggle-exact-1"] * 3


def test_a_training_that_goes_on_from_before_is_not_joined_by_another(stand_in: Path) -> None:
    run = stand_in / "juggle-exact-0"
    run.mkdir()
    with held(run), pytest.raises(FolderInUseError, match=f"juggle-exact-0 is in use by process {os.getpid()}"):
        train_all(stand_in, read_study(stand_in), 2, progress=False)
    assert not (stand_in / "began.txt").exists()
    train_all(stand_in, read_study(stand_in), 2, progress=False)


def test_a_study_is_held_by_one_process(
    stand_in: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with held(stand_in):
        command(monkeypatch, "--resume", str(stand_in), status=2)
    assert capsys.readouterr().err.startswith(f"{stand_in} is in use by process {os.getpid()}")
    assert not (stand_in / "began.txt").exists()


def test_runs_of_other_settings_are_refused(stand_in: Path) -> None:
    settings = read_study(stand_in)
    train_all(stand_in, settings, 2, progress=False)
    with pytest.raises(ValueError, match="juggle-coarse-0 was made by other settings than those of"):
        train_all(stand_in, replace(settings, total_steps=(5,)), 2, progress=False)


def test_a_study_keeps_what_its_fidelities_stood_for_and_is_refused_where_they_changed(stand_in: Path) -> None:
    path = stand_in / "study.json"
    kept = json.loads(path.read_text())
    assert kept["settings"]["coarse"] == [FIDELITIES["coarse"].contact, FIDELITIES["coarse"].substeps]
    assert kept["settings"]["exact"] == ["exact", None]
    kept["settings"]["coarse"] = ["pymunk", 7]
    path.write_text(json.dumps(kept))
    with pytest.raises(ValueError, match=r'made with the fidelities .*"coarse": \["pymunk", 7\].*, which are .* today'):
        read_study(stand_in)
    del kept["settings"]
    path.write_text(json.dumps(kept))
    with pytest.raises(ValueError, match=r"does not say which contact and substeps .*'settings' is missing"):
        read_study(stand_in)
    path.write_text(json.dumps(kept)[:-9])
    with pytest.raises(ValueError, match=r"study.json is damaged \(JSONDecodeError: "):
        read_study(stand_in)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"seeds": 0}, "seeds must be a whole number from 1 to 1000, got 0"),
        ({"episodes": 1}, "episodes must be a whole number >= 2, got 1"),
        ({"long_episodes": 3}, "long_episodes must be a whole number >= 4, got 3"),
        ({"total_steps": (0,)}, "total_steps must be a whole number >= 1, got 0"),
        ({"total_steps": (1, 2, 3)}, r"total_steps must be one number or 2, got \(1, 2, 3\)"),
        ({"fidelities": ("coarse", "slow", "exact")}, "fidelities must be one of .* got 'slow'"),
        ({"fidelities": ("coarse",)}, "fidelities must hold 'exact'"),
        ({"fidelities": ("exact", "exact")}, "fidelities must be different ones"),
        ({"tasks": ()}, "tasks must be different ones, at least one"),
    ],
)
def test_impossible_studies_are_refused(given: dict[str, Any], sentence: str) -> None:
    with pytest.raises((TypeError, ValueError), match=sentence):
        StudySettings(**given)


def test_steps_may_differ_between_tasks() -> None:
    settings = StudySettings(("juggle", "rattle"), total_steps=(3000, 7))
    runs = [settings.run_settings(*run) for run in settings.runs()]
    assert {(run.task, run.total_steps, run.eval_steps) for run in runs} == {("juggle", 3000, 3000), ("rattle", 7, 7)}
    assert {run.seed for run in runs} == {0, 1, 2}
    # what is done first is a whole: each task and fidelity of one seed before the next
    assert [run.seed for run in runs] == [0] * 8 + [1] * 8 + [2] * 8


def test_cells_start_alike_on_every_fidelity_and_are_run_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = StudySettings(("juggle",), episodes=3)
    exact = cell(tmp_path, settings, "juggle", "level", "exact")
    accurate = cell(tmp_path, settings, "juggle", "level", "fine")
    # the same starts: until chaos parts them returns differ little, much less than between starts
    assert np.abs(np.subtract(exact, accurate)).min() < 0.2 * np.ptp(exact)
    path = tmp_path / "cells" / "juggle-level-on-exact.json"
    path.write_text("[1.0, 2.0, 3.0]")
    assert cell(tmp_path, settings, "juggle", "level", "exact") == [1.0, 2.0, 3.0]
    path.write_text("[1.0, 2.")
    assert cell(tmp_path, settings, "juggle", "level", "exact") == exact
    assert f"Skipped: {path} is damaged" in capsys.readouterr().err
    with pytest.raises(ValueError, match="holds 3 episodes instead of 4"):
        cell(tmp_path, replace(settings, episodes=4), "juggle", "level", "exact")


def command(monkeypatch: pytest.MonkeyPatch, *arguments: str, status: int = 0) -> None:
    """Run the command line in this process, which has loaded torch already."""
    monkeypatch.setattr(sys, "argv", ["transfer.py", "--no-progress", *arguments])
    if status == 0:
        main()
        return
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == status


def test_a_small_study_from_end_to_end_and_its_page_again_without_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = "--tasks juggle --fidelities fast exact --seeds 1 --total-steps 4096 --episodes 2 --long-episodes 4"
    (tmp_path / "docs").mkdir()
    monkeypatch.chdir(tmp_path)
    command(monkeypatch, *small.split(), "--folder", "study")
    assert not list((tmp_path / "docs").iterdir())  # a trial leaves the published page alone
    own = (tmp_path / "study" / "learning.md").read_text()
    assert f"`python scripts/studies/transfer/transfer.py {small}` trains" in own
    assert "--out" not in own
    command(monkeypatch, "--resume", "study", "--out", "docs")
    page = (tmp_path / "docs" / "learning.md").read_text()
    assert f"`python scripts/studies/transfer/transfer.py {small} --out docs` trains" in page
    assert f"`one iteration` is {one_iteration()};" in page
    assert page.splitlines()[2] == fidelities_line()  # before any of the names
    # one training tells nothing
    assert page.splitlines()[4].startswith("**Learning `juggle` by shortcut**: undecided `coarse`. Does a policy")
    assert "- Safe means on average: 1 training cannot exclude that up to 95.0 % of trainings fail" in page
    data = json.loads((tmp_path / "docs" / "learning.json").read_text())
    returns = data["returns"]["juggle"]["trained"]["coarse"]["exact"]
    assert f"| PPO, coarse | {np.mean(data['returns']['juggle']['trained']['coarse']['coarse']):.1f} ± inf |" in page
    assert np.shape(returns) == (1, 2)
    assert {row["setting"] for row in data["comparisons"]} == set(SETTINGS) - {"exact"}
    assert (tmp_path / "docs" / "learning_juggle.png").stat().st_size > 10_000
    weights = {path: path.stat().st_mtime_ns for path in (tmp_path / "study").rglob("*.zip")}
    assert len(weights) >= 4
    command(monkeypatch, "--resume", "study", "--out", "docs")
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "study").rglob("*.zip")} == weights
    assert (tmp_path / "docs" / "learning.md").read_text() == page


def test_an_interrupted_study_interrupts_its_trainings_and_says_how_to_go_on(
    stand_in: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("LASTS", "60")
    monkeypatch.setattr(transfer, "_PATIENCE", 2.0)
    (stand_in.parent / "docs").mkdir()
    monkeypatch.chdir(stand_in.parent)
    started: list[subprocess.Popen[bytes]] = []
    start = transfer._start

    def remember(*given: Any) -> subprocess.Popen[bytes]:
        started.append(start(*given))
        return started[-1]

    def interrupt(seconds: float) -> None:
        deadline = time.monotonic() + 60.0
        while not (stand_in / "began.txt").exists() and time.monotonic() < deadline:
            pass
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(transfer, "_start", remember)
        patched.setattr(time, "sleep", interrupt)
        command(patched, "--resume", str(stand_in), status=130)
    assert f"Go on with: python scripts/studies/transfer/transfer.py --resume {stand_in}" in capsys.readouterr().err
    assert len(started) == 2
    assert all(process.returncode != 0 for process in started)
    assert not list(stand_in.rglob("model.zip"))


def test_refusals_of_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "docs").mkdir()
    monkeypatch.chdir(tmp_path)
    before = list(tmp_path.iterdir())
    for arguments, refusal in (
        ("--resume study --episodes 7", "--resume goes on by the settings of its folder"),
        ("--resume docs", "docs is no study: it has no study.json"),
        ("--out no", "no is no folder to write a page in"),
        ("--folder docs", "docs exists, and runs are never overwritten"),
        ("--folder new --processes 0", "processes must be a whole number from 1 to 1000, got 0"),
    ):
        command(monkeypatch, *arguments.split(), status=2)
        assert refusal in capsys.readouterr().err
        assert list(tmp_path.iterdir()) == before  # nothing was made


# -- the page ---------------------------------------------------------------------------------------------------------


def test_the_page_says_what_the_names_stand_for(monkeypatch: pytest.MonkeyPatch) -> None:
    fast = FIDELITIES["coarse"]
    assert f"`coarse` ({fast.contact}, {fast.substeps} substeps)" in fidelities_line()
    assert "`exact` (exact, no substeps). Train elastic scenes on `exact`" in fidelities_line()
    assert one_iteration() == f"{fast.contact} with {fast.substeps} substeps and 1 solver iteration"
    monkeypatch.setitem(SETTINGS, "one iteration", {"contact": "pymunk", "substeps": 1, "iterations": 3})
    assert one_iteration() == "pymunk with 1 substep and 3 solver iterations"


def test_the_committed_page_is_of_todays_fidelities() -> None:
    data = json.loads((ROOT / "docs" / "learning.json").read_text())
    assert data["fidelities"] == resolved_fidelities()


@pytest.mark.parametrize(
    "settings",
    [
        StudySettings(),
        StudySettings(seeds=5, total_steps=(1_000_000, 500_000)),
        StudySettings(("spin",), ("coarse", "exact"), 2, (7,), 3, 4),
    ],
)
@pytest.mark.parametrize("out", [None, Path("docs")])
def test_the_command_on_the_page_makes_the_study_again(settings: StudySettings, out: Path | None) -> None:
    again, resume = commands(settings, out)
    words = shlex.split(again)
    assert words[:2] == ["python", "scripts/studies/transfer/transfer.py"]
    assert tyro.cli(Arguments, args=words[2:]) == Arguments(settings, out=out)
    assert ("--out docs" in resume) == (out is not None)


def test_make_transfer_is_the_one_that_writes_to_docs() -> None:
    again, _ = commands(StudySettings(seeds=5, total_steps=(1_000_000, 500_000)), Path("docs"))
    assert again == "python scripts/studies/transfer/transfer.py --seeds 5 --total-steps 1000000 500000 --out docs"
    assert f"/{again}\n" in (ROOT / "Makefile").read_text()
