"""Run folders with damaged files: a damaged file is skipped and named, and the run still finishes."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agents.runs import EVALUATIONS, describe
from agents.training import best
from agents.training import ppo as training
from agents.training.best import read_evaluations
from agents.training.checkpoints import CHECKPOINTS, checkpoint_path, steps_of_checkpoints
from jackbox_env.sb3 import load_model
from jackbox_env.tools.files import new_folder
from jackbox_env.tools.model_files import BEST, MODEL, read_parameters
from tests.agents.killing import SMALL, check_finished, expected_steps, short_episodes, stop_after

STOPPED = 80  # steps done of the 96, two evaluations among them
NEWEST = f"{CHECKPOINTS}/ppo_{STOPPED}.zip"


@pytest.fixture(scope="module")
def originals(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was stopped on its way, and the same run finished."""
    folder = tmp_path_factory.mktemp("runs")
    new_folder(folder / "stopped", "test", lambda made: describe(made, SMALL))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(best, "make_vec_env", short_episodes)
        stop_after(STOPPED, SMALL, folder / "stopped")
        shutil.copytree(folder / "stopped", folder / "finished")
        training.train(SMALL, folder / "finished", progress=False)
    assert steps_of_checkpoints(folder / "stopped") == [80, 48, 16]
    return folder


@pytest.fixture
def runs(originals: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Copies of both."""
    monkeypatch.setattr(best, "make_vec_env", short_episodes)
    return Path(shutil.copytree(originals, tmp_path / "runs"))


def flipped(content: bytes) -> bytes:
    """The content with one bit changed, in the first tensor of a model, or in the middle."""
    position = content.find(b"policy.pth") + 2000 if b"policy.pth" in content else len(content) // 2
    return content[:position] + bytes([content[position] ^ 16]) + content[position + 1 :]


HARMS: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda content: b"",
    "half": lambda content: content[: len(content) // 2],
    "flipped": flipped,
}
EVERY_HARM = pytest.mark.parametrize("how", HARMS)


def harm(path: Path, how: str) -> None:
    path.write_bytes(HARMS[how](path.read_bytes()))


def goes_on_to_its_end(folder: Path) -> None:
    model = training.train(SMALL, folder, progress=False)
    assert model.num_timesteps == SMALL.total_steps
    with pytest.raises(FileExistsError, match="is finished"):
        training.train(SMALL, folder, progress=False)


def skipped(said: str, path: Path) -> bool:
    return any(line.startswith(f"Skipped: {path} is damaged: ") for line in said.splitlines())


@EVERY_HARM
@pytest.mark.parametrize(("run", "name"), [("stopped", NEWEST), ("finished", MODEL)])
def test_a_damaged_checkpoint_or_model_is_skipped_and_the_run_ends_as_undisturbed(
    run: str, name: str, how: str, runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    harm(runs / run / name, how)
    goes_on_to_its_end(runs / run)
    said = capsys.readouterr()
    assert skipped(said.err, runs / run / name)
    assert ("Continuing after 48 steps" in said.out) == (name == NEWEST)
    check_finished(runs / run)


def test_without_a_whole_checkpoint_the_run_begins_again(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stopped = runs / "stopped"
    first = read_evaluations(stopped, SMALL.eval_episodes)
    for steps in steps_of_checkpoints(stopped):
        harm(checkpoint_path(stopped, steps), "half")
    goes_on_to_its_end(stopped)
    said = capsys.readouterr()
    assert said.err.count("Skipped: ") == 3
    assert "Starting from the beginning" in said.out
    check_finished(stopped)
    assert read_evaluations(stopped, SMALL.eval_episodes).results[:2] == first.results  # from the same seed


@EVERY_HARM
@pytest.mark.parametrize("name", [EVALUATIONS, BEST])
def test_the_next_evaluation_replaces_damaged_evaluations_and_a_damaged_best_model(
    name: str, how: str, runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stopped = runs / "stopped"
    harm(stopped / name, how)
    goes_on_to_its_end(stopped)
    assert skipped(capsys.readouterr().err, stopped / name)
    timesteps = read_evaluations(stopped, SMALL.eval_episodes).timesteps
    assert timesteps == (expected_steps(SMALL) if name == BEST else [96])  # those before are lost
    evaluated = read_parameters(checkpoint_path(stopped, STOPPED))["policy"]  # at 96
    chosen = read_parameters(stopped / BEST)["policy"]
    assert all(bool((chosen[name] == value).all()) for name, value in evaluated.items())


def test_a_best_model_stays_where_those_to_come_do_worse(runs: Path) -> None:
    stopped = runs / "stopped"
    evaluations, best_file = read_evaluations(stopped, SMALL.eval_episodes), (stopped / BEST).read_bytes()
    better = evaluations._replace(results=[[1e6, 1e6], *evaluations.results[1:]])
    np.savez(stopped / EVALUATIONS, **better._asdict())
    goes_on_to_its_end(stopped)
    assert (stopped / BEST).read_bytes() == best_file


def test_a_checkpoint_of_other_settings_is_refused_and_not_skipped_as_damaged(runs: Path) -> None:
    stopped = runs / "stopped"
    with pytest.raises(ValueError, match=r"ppo_80.zip was made by other settings than its run's: Runtime") as refused:
        training.train(replace(SMALL, hidden_units=(4,)), stopped, progress=False)
    assert "\n" not in str(refused.value)
    assert not (stopped / MODEL).exists()


def test_a_run_with_a_damaged_best_model_loads_its_last_and_prints_a_message(
    runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    finished = runs / "finished"
    shutil.copy(checkpoint_path(finished, 16), finished / BEST)  # another than the last
    last, best = (load_model(finished / name)[0].get_parameters()["policy"] for name in (MODEL, BEST))
    assert any(bool((last[name] != best[name]).any()) for name in last)
    harm(finished / BEST, "half")
    loaded = load_model(finished)[0].get_parameters()["policy"]
    assert skipped(capsys.readouterr().err, finished / BEST)
    assert all(bool((last[name] == loaded[name]).all()) for name in last)
    harm(finished / MODEL, "half")
    with pytest.raises(ValueError, match="model.zip is no model of env.json beside it"):
        load_model(finished)
