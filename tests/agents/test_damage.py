"""Run folders with damaged files: a damaged file is skipped and named, and the run still finishes."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agents.runs import BEST, EVALUATIONS, MODEL, describe, read_parameters
from agents.training import best
from agents.training import ppo as training
from agents.training.best import read_evaluations
from agents.training.checkpoints import CHECKPOINTS, Checkpoint, checkpoint_path, steps_of_checkpoints
from agents.training.models import load_model
from jackbox_env.files import new_folder
from tests.agents.killing import SMALL, expected_steps, short_episodes

STOPPED = 80  # steps done of the 96, two evaluations among them
NEWEST = f"{CHECKPOINTS}/ppo_{STOPPED}.zip"


@pytest.fixture(scope="module")
def originals(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A run that was stopped on its way, and the same run finished."""
    stopped = tmp_path_factory.mktemp("runs") / "stopped"
    new_folder(stopped, "test", lambda made: describe(made, SMALL))

    class Interrupt(Checkpoint):
        def _on_step(self) -> bool:
            if self.num_timesteps > STOPPED:
                raise KeyboardInterrupt
            return True

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(best, "make_vec_env", short_episodes)
        patch.setattr(training, "Checkpoint", Interrupt)
        with pytest.raises(KeyboardInterrupt):
            training.train(SMALL, stopped, progress=False)
        patch.undo()
        patch.setattr(best, "make_vec_env", short_episodes)
        finished = stopped.with_name("finished")
        shutil.copytree(stopped, finished)
        training.train(SMALL, finished, progress=False)
    assert steps_of_checkpoints(stopped) == [80, 48, 16]
    return {"stopped": stopped, "finished": finished}


@pytest.fixture
def stopped(originals: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(best, "make_vec_env", short_episodes)
    return Path(shutil.copytree(originals["stopped"], tmp_path / "run"))


@pytest.fixture
def finished(originals: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(best, "make_vec_env", short_episodes)
    return Path(shutil.copytree(originals["finished"], tmp_path / "run"))


def cut_to(share: float) -> Callable[[bytes], bytes]:
    return lambda content: content[: int(share * len(content))]


def flipped(content: bytes, position: int | None = None) -> bytes:
    """The content with one bit changed, by default in the first tensor."""
    position = content.index(b"policy.pth") + 2000 if position is None else position
    return content[:position] + bytes([content[position] ^ 16]) + content[position + 1 :]


HARMS: dict[str, Callable[[bytes], bytes]] = {
    "empty": cut_to(0.0),
    "half": cut_to(0.5),
}


def harm(path: Path, how: str) -> None:
    path.write_bytes((flipped if how == "flipped" else HARMS[how])(path.read_bytes()))


def goes_on_to_its_end(folder: Path) -> None:
    model = training.train(SMALL, folder, progress=False)
    assert model.num_timesteps == SMALL.total_steps
    for name in (MODEL, BEST):
        read_parameters(folder / name)
    with pytest.raises(FileExistsError, match="is finished"):
        training.train(SMALL, folder, progress=False)


def skipped(said: str, path: Path) -> bool:
    return any(line.startswith(f"Skipped: {path} is damaged (") for line in said.splitlines())


@pytest.mark.parametrize("how", [*HARMS, "flipped"])
def test_a_damaged_checkpoint_is_skipped_for_the_one_before(
    how: str, stopped: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    harm(stopped / NEWEST, how)
    goes_on_to_its_end(stopped)
    said = capsys.readouterr()
    assert skipped(said.err, stopped / NEWEST)
    assert "Continuing after 48 steps" in said.out
    assert read_evaluations(stopped, SMALL.eval_episodes).timesteps == expected_steps(SMALL)


def test_without_a_whole_checkpoint_the_run_begins_again(stopped: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first = read_evaluations(stopped, SMALL.eval_episodes)
    for steps in steps_of_checkpoints(stopped):
        harm(checkpoint_path(stopped, steps), "half")
    goes_on_to_its_end(stopped)
    said = capsys.readouterr()
    assert said.err.count("Skipped: ") == 3
    assert "Starting from the beginning" in said.out
    again = read_evaluations(stopped, SMALL.eval_episodes)
    assert again.timesteps == expected_steps(SMALL)
    assert again.results[:2] == first.results  # from the same seed


@pytest.mark.parametrize("how", HARMS)
def test_damaged_evaluations_are_skipped(how: str, stopped: Path, capsys: pytest.CaptureFixture[str]) -> None:
    harm(stopped / EVALUATIONS, how)
    goes_on_to_its_end(stopped)
    assert skipped(capsys.readouterr().err, stopped / EVALUATIONS)
    assert read_evaluations(stopped, SMALL.eval_episodes).timesteps == [96]  # those before are lost


@pytest.mark.parametrize("how", [*HARMS, "flipped", "gone"])
def test_the_next_evaluation_replaces_a_damaged_best_model(
    how: str, stopped: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if how == "gone":
        (stopped / BEST).unlink()
    else:
        harm(stopped / BEST, how)
    goes_on_to_its_end(stopped)
    assert skipped(capsys.readouterr().err, stopped / BEST) == (how != "gone")
    evaluated = read_parameters(checkpoint_path(stopped, STOPPED))["policy"]  # at 96
    best = read_parameters(stopped / BEST)["policy"]
    assert all(bool((best[name] == value).all()) for name, value in evaluated.items())


def test_a_best_model_stays_where_those_to_come_do_worse(stopped: Path) -> None:
    evaluations, best_file = read_evaluations(stopped, SMALL.eval_episodes), (stopped / BEST).read_bytes()
    better = evaluations._replace(results=[[1e6, 1e6], *evaluations.results[1:]])
    np.savez(stopped / EVALUATIONS, **better._asdict())
    goes_on_to_its_end(stopped)
    assert (stopped / BEST).read_bytes() == best_file


@pytest.mark.parametrize("how", [*HARMS, "flipped"])
def test_a_damaged_model_is_not_the_end_of_a_run(how: str, finished: Path, capsys: pytest.CaptureFixture[str]) -> None:
    harm(finished / MODEL, how)
    goes_on_to_its_end(finished)
    assert skipped(capsys.readouterr().err, finished / MODEL)
    assert read_evaluations(finished, SMALL.eval_episodes).timesteps == expected_steps(SMALL)


def test_a_checkpoint_of_other_settings_is_refused_and_not_skipped_as_damaged(stopped: Path) -> None:
    with pytest.raises(ValueError, match=r"ppo_80.zip was made by other settings than its run's: Runtime") as refused:
        training.train(replace(SMALL, hidden_units=(4,)), stopped, progress=False)
    assert "\n" not in str(refused.value)
    assert not (stopped / MODEL).exists()


def test_a_run_with_a_damaged_best_model_loads_its_last_and_prints_a_message(
    finished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    last, best = (load_model(finished / name).get_parameters()["policy"] for name in (MODEL, BEST))
    assert any(bool((last[name] != best[name]).any()) for name in last)
    harm(finished / BEST, "half")
    loaded = load_model(finished).get_parameters()["policy"]
    assert skipped(capsys.readouterr().err, finished / BEST)
    assert all(bool((last[name] == loaded[name]).all()) for name in last)
    harm(finished / MODEL, "half")
    with pytest.raises(ValueError, match="model.zip is no model of the settings beside it"):
        load_model(finished)
