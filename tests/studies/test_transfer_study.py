"""That a study is made, interrupted, resumed, refused and written down."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.checkpoints import model_file
from agents.evaluation import evaluate
from agents.models import make_ppo, make_vec_env
from agents.policies import baseline
from agents.settings import TrainSettings
from agents.storage import FolderInUseError, held
from jackbox_env import FIDELITIES, Scene
from scripts.studies.transfer import study as transfer
from scripts.studies.transfer.longrun import SETTINGS, STATISTICS, Episodes
from scripts.studies.transfer.page import page, read_data, write
from scripts.studies.transfer.study import StudySettings, cell, new_study, read_study, run_all, train_all
from scripts.studies.transfer.transfer import main

DATA = Path(__file__).parents[2] / "docs" / "learning.json"

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
    assert began == [f"juggle-{run}" for run in ("coarse-0", "exact-0", "exact-0", "coarse-1", "exact-1")]


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
    best = stand_in / "juggle-coarse-0" / "best_model.zip"
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
    with pytest.raises(ValueError, match=r'made with the fidelities "unknown", which are .* today'):
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
    fine = cell(tmp_path, settings, "juggle", "level", "fine")
    # the same starts: until chaos parts them returns differ little, much less than between starts
    assert np.abs(np.subtract(exact, fine)).min() < 0.2 * np.ptp(exact)
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


SMALL = "--tasks juggle --fidelities coarse exact --seeds 1 --total-steps 4096 --episodes 2 --long-episodes 4"


def check_small_study(folder: Path) -> str:
    """Check the files of such a study; return its page."""
    own, data = (folder / "learning.md").read_text(), read_data(folder / "learning.json")
    assert f"Made by `python scripts/studies/transfer/transfer.py --no-progress {SMALL}`" in own  # wherever
    assert "[^juggle]: Undecided. `coarse`: one training shows no spread." in own
    assert "After 1 trainings without a failure, up to 95 % of all trainings may still fail (95 % bound)." in own
    assert page(data) == own  # the file holds all that is on the page
    returns = data["returns"]["juggle"]["trained"]["coarse"]
    assert f"| PPO, coarse | {np.mean(returns['coarse']):.1f} ± inf |" in own
    assert np.shape(returns["exact"]) == (1, 2)
    assert {row["setting"] for row in data["comparisons"]} == set(SETTINGS) - {"exact"}
    assert data["training"]["total_steps"] == 4096
    assert (folder / "learning.png").stat().st_size > 10_000
    return own


def test_a_small_study_is_written_down_where_it_was_asked_for(
    tmp_path: Path, stand_in: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def few(setting: Any, torques: Any, rng: np.random.Generator, episodes: int, scene: Scene) -> Episodes:
        return Episodes({name: rng.normal(1.0, 0.1, episodes) for name in STATISTICS}, 0.01, 0)

    monkeypatch.setattr(transfer, "load_model", lambda run: baseline("level", Scene()).policy)
    monkeypatch.setattr("scripts.studies.transfer.longrun.run_episodes", few)
    place = tmp_path / "elsewhere"
    (place / "docs").mkdir(parents=True)
    (place / "whole.zip").write_bytes((tmp_path / "whole.zip").read_bytes())
    monkeypatch.chdir(place)
    command(monkeypatch, *SMALL.split(), "--folder", "study")
    assert not list((place / "docs").iterdir())  # a trial leaves the published page alone
    own = check_small_study(place / "study")
    command(monkeypatch, "--resume", "study", "--out", "docs")
    assert (place / "docs" / "learning.md").read_text() == own
    (place / "study" / "learning.md").unlink()
    command(monkeypatch, "--page-from", "study/learning.json")
    assert (place / "study" / "learning.md").read_text() == own


@pytest.mark.slow
def test_a_small_study_from_end_to_end_and_its_page_again_without_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    command(monkeypatch, *SMALL.split(), "--folder", "study")
    own = check_small_study(tmp_path / "study")
    weights = {path: path.stat().st_mtime_ns for path in (tmp_path / "study").rglob("*.zip")}
    assert len(weights) >= 4
    command(monkeypatch, "--resume", "study")
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "study").rglob("*.zip")} == weights
    assert (tmp_path / "study" / "learning.md").read_text() == own


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
        began = stand_in / "began.txt"
        while not (began.exists() and began.read_text().count("\n") == 2) and time.monotonic() < deadline:
            pass
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(transfer, "_start", remember)
        patched.setattr(time, "sleep", interrupt)
        command(patched, "--resume", str(stand_in), status=130)
    assert f"Go on with: python scripts/studies/transfer/transfer.py --resume {stand_in}" in capsys.readouterr().err
    assert len(started) == 2
    for process in started:
        process.wait(30.0)
    assert all(process.returncode != 0 for process in started)
    assert not list(stand_in.rglob("model.zip"))


def test_every_policy_is_run_on_every_fidelity(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = StudySettings(("juggle",), ("coarse", "exact"), seeds=2, episodes=3)
    kept = {"coarse-0": 0.123, "coarse-1": 1.0, "exact-0": 2.0, "exact-1": 3.0, "zero": 4.0, "level": 5.0, "chirp": 6.0}
    monkeypatch.setattr(
        transfer, "cell", lambda folder, given, task, policy, on: [kept[policy], 10.0 * (on == "exact"), 0.0]
    )
    found = run_all(tmp_path, settings, "juggle", progress=False)
    assert found["trained"] == {
        "coarse": {"coarse": [[0.12, 0.0, 0.0], [1.0, 0.0, 0.0]], "exact": [[0.12, 10.0, 0.0], [1.0, 10.0, 0.0]]},
        "exact": {"coarse": [[2.0, 0.0, 0.0], [3.0, 0.0, 0.0]], "exact": [[2.0, 10.0, 0.0], [3.0, 10.0, 0.0]]},
    }
    assert found["baselines"] == {
        name: {"coarse": [kept[name], 0.0, 0.0], "exact": [kept[name], 10.0, 0.0]}
        for name in ("zero", "level", "chirp")
    }


def test_refusals_of_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "broken.json").write_text("{")
    (tmp_path / "other.json").write_text('{"settings": {}}')
    old = {**json.loads(DATA.read_text()), "settings": {"fidelities": ["fast", "exact"]}}
    (tmp_path / "old.json").write_text(json.dumps(old))
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    for arguments, refusal in (
        ("--resume study --episodes 7", "--resume and --page-from use the settings of the study named"),
        ("--page-from other.json --seeds 2", "--resume and --page-from use the settings of the study named"),
        ("--page-from other.json --resume docs", "--resume and --page-from use the settings of the study named"),
        ("--resume study --folder new", "--resume and --page-from use the settings of the study named"),
        ("--resume docs", "docs is no study: it has no study.json"),
        ("--page-from no.json", "no.json cannot be used: No such file or directory"),
        ("--page-from broken.json", "broken.json is damaged (JSONDecodeError: Expecting property name"),
        ("--page-from other.json", "other.json holds no data of a study: 'fidelities' is missing"),
        ("--page-from old.json", "fidelities must be one of 'coarse', 'balanced', 'fine', 'exact', got 'fast'"),
        ("--out no", "no is no folder to write a page in"),
        ("--folder docs", "docs exists, and runs are never overwritten"),
        ("--folder new --processes 0", "processes must be a whole number from 1 to 1000, got 0"),
    ):
        command(monkeypatch, *arguments.split(), status=2)
        assert refusal in capsys.readouterr().err
        assert sorted(tmp_path.rglob("*")) == before  # nothing was made


# -- with loss ---------------------------------------------------------------------------------------------------------


def test_a_study_with_loss_trains_and_runs_everything_in_its_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = StudySettings(("juggle",), ("balanced", "exact"), restitution=0.9)
    run = settings.run_settings("juggle", "exact", 0)
    assert run.scene_fields == {"restitution": 0.9}
    assert settings.scene == Scene(restitution=0.9)
    assert read_study(new_study(tmp_path / "study", settings)) == settings
    assert StudySettings().run_settings("juggle", "exact", 0).scene == TrainSettings.scene
    asked: list[Any] = []

    def evaluated(name: str, actor: Any, env_settings: dict[str, Any], episodes: int, seed: int) -> Any:
        asked.append(env_settings["scene"])
        return evaluate(name, actor, env_settings, episodes, seed=seed)

    def runs(folder: Path, policies: Any, episodes: int, progress: bool, scene: Scene, runner: Any) -> Any:
        asked.append(scene)

    monkeypatch.setattr(transfer, "evaluate", evaluated)
    few = replace(settings, episodes=2)
    lossy = cell(tmp_path / "lossy", few, "juggle", "zero", "exact")
    elastic = cell(tmp_path / "elastic", replace(few, restitution=1.0), "juggle", "zero", "exact")
    assert asked == [{"restitution": 0.9}, {}]
    assert lossy != elastic
    monkeypatch.setattr(transfer, "run_long", runs)
    monkeypatch.setattr(transfer, "load_model", lambda path: None)
    transfer.run_statistics(tmp_path, settings, False)
    assert asked[2] == Scene(restitution=0.9)


@pytest.mark.parametrize("restitution", [-0.1, 1.1, float("nan")])
def test_a_study_of_no_restitution_is_refused(restitution: float) -> None:
    with pytest.raises(ValueError, match="restitution must be"):
        StudySettings(restitution=restitution)


def test_a_study_with_loss_leaves_the_elastic_page_alone(tmp_path: Path) -> None:
    data = read_data(DATA)
    data["settings"]["restitution"] = 0.9
    text = write(data, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"learning_loss.{end}" for end in ("json", "md", "png")]
    assert text.startswith("# What a fidelity does to a learner, at restitution 0.9\n")
    assert "| juggle | balanced | safe |" in text
    assert "(learning_loss.png)" in text
