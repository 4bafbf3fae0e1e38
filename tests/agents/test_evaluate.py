"""The command that evaluates: what it refuses before it computes, what it notes, and the pages it writes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from agents import evaluation, training
from agents.episodes import page_names, record_episode
from agents.models import derived_seed, load_model
from agents.network import SHIPPED
from agents.policies import baseline
from agents.runs import describe
from agents.settings import EnvSettings, TrainSettings
from jackbox_env import Scene
from tests.agents.small_run import TINY
from tests.agents.test_commands import script


def data_of(page: Path) -> dict[str, Any]:
    data: dict[str, Any] = json.loads(page.read_text().split('id="data">')[1].split("</script>")[0])
    return data


# -- pages -------------------------------------------------------------------------------------------------------------


def test_a_page_shows_the_scene_that_was_drawn(tmp_path: Path) -> None:
    varied = '{"box_half_width": [3.0, 9.0], "gravity": [1.0, 20.0]}'
    arguments = ["--policy", "level", "--episodes", "1", "--randomize", varied, "--html", "pages"]
    script("evaluate", *arguments, cwd=tmp_path)
    data = data_of(tmp_path / "pages" / "level.html")
    settings = EnvSettings(randomize=varied).env_settings
    scene = record_episode(baseline("level", Scene()), settings, derived_seed("evaluation", 0)).scene
    assert data["halfWidth"] == scene.box_half_width != 6.0
    assert dict(data["facts"])["gravity"] == f"{scene.gravity:g} m/s\u00b2"


def test_pages_have_short_names_of_their_own() -> None:
    long = "y" * 300
    names = page_names(["a/b/run", "a_b_run", "c/run", "c/RUN", "..", ".hidden", long, f"{long}z", "zero", "sp\u00e4t"])
    assert list(names.values())[:4] == ["run.html", "a_b_run.html", "run-2.html", "RUN-3.html"]
    assert names["zero"] == "zero.html"
    assert len({name.lower() for name in names.values()}) == len(names)
    for name in names.values():
        assert len(name) < 100
        assert not name.startswith(".")
        assert name.isascii()


def test_an_error_leaves_no_pages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from agents import episodes

    def full(*given: Any) -> None:
        raise OSError(28, "No space left on device", "pages/level.html")

    monkeypatch.setattr(episodes, "write_page", full)
    done = script("evaluate", "--policy", "level", "--episodes", "1", "--html", "pages", cwd=tmp_path, status=2)
    assert done.stderr.splitlines()[-1].endswith("pages/level.html cannot be used: No space left on device")
    assert not list(tmp_path.iterdir())


# -- refusals and notes ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--policy"], "policy must name at least one policy, got none"),
        (["--html", "/dev/null/pages"], "/dev/null/pages cannot be made: /dev/null is no folder"),
        (["--html", "/proc/pages"], "/proc cannot be written to: "),
        (["--film", "/proc/film.GIF"], "/proc cannot be written to: "),
        (["--json", "/proc/out.json"], "/proc cannot be written to: "),
    ],
)
def test_it_refuses_before_it_computes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], sentence: str
) -> None:
    monkeypatch.setattr(evaluation, "evaluate", None)  # it is not reached
    done = script("evaluate", *arguments, cwd=tmp_path, status=2)
    assert sentence in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_weights_are_given_by_their_folder_and_an_empty_file_is_no_model(tmp_path: Path) -> None:
    shutil.copytree(SHIPPED / "juggle-ppo", tmp_path / "ok")
    (tmp_path / "empty.zip").touch()
    done = script("evaluate", "--policy", "ok/weights.npz", cwd=tmp_path, status=2)
    assert done.stderr == "ok/weights.npz holds weights alone: give its folder, ok\n"
    done = script("evaluate", "--policy", "empty.zip", "--trust", cwd=tmp_path, status=2)
    assert done.stderr.startswith("empty.zip is no model of Stable-Baselines3: ")
    assert len(done.stderr.splitlines()) == 1


def test_shipped_networks_are_noted_that_were_trained_elsewhere(tmp_path: Path) -> None:
    done = script("evaluate", "--policy", "ppo", "zero", "--episodes", "1", cwd=tmp_path)
    assert "Note: ppo was trained in another environment (task juggle, contact exact)" in done.stderr
    done = script("evaluate", "--policy", "ppo", "--contact", "exact", "--episodes", "1", cwd=tmp_path)
    assert "Note:" not in done.stderr


def test_a_planner_among_varied_scenes_is_noted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from agents.evaluation import Returns

    monkeypatch.setattr(evaluation, "evaluate", lambda name, *rest, **more: Returns(name, (1.0, 2.0)))
    varied = ["--policy", "planner", "level", "--contact", "exact", "--randomize", '{"jack_mass": [2, 6]}']
    done = script("evaluate", *varied, cwd=tmp_path)
    assert done.stderr == "Note: planner plans in the scene that is given, not in those that randomize draws\n"


def test_lookahead_says_its_whole_range() -> None:
    for given in (-1, 3, 5000):
        with pytest.raises(ValueError, match=r"lookahead must be .*0.* 4096, got"):
            TrainSettings(lookahead=given, hold=5)
    with pytest.raises(ValueError, match="lookahead must be 0 or from 8 to 4096, got 3"):
        TrainSettings(lookahead=3, hold=5)


# -- training ----------------------------------------------------------------------------------------------------------


def test_an_exported_policy_is_not_trained_over(tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(SHIPPED / "juggle-ppo", copy)
    before = {path.name: path.read_bytes() for path in copy.iterdir()}
    done = script("train", "--resume", "copy", cwd=tmp_path, status=2)
    assert done.stderr == "copy is no training run: it has no run.json, so there is nothing to resume\n"
    with pytest.raises(FileExistsError, match="holds an exported policy, which cannot be trained on"):
        training.train(TINY, copy, progress=False)
    assert {path.name: path.read_bytes() for path in copy.iterdir()} == before


def test_an_error_in_training_is_told_on_a_line_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    from agents import checkpoints

    def full(*given: Any) -> None:
        raise OSError("the disk is full")

    (tmp_path / "run").mkdir()
    describe(tmp_path / "run", TINY)
    monkeypatch.setattr(checkpoints, "write_bytes", full)
    with pytest.warns(match="rich is experimental"), pytest.raises(OSError, match="the disk is full"):
        training.train(TINY, tmp_path / "run", progress=True)
    assert capfd.readouterr().out.endswith("\n")
    with pytest.raises(FileNotFoundError, match="holds no model"):
        load_model(tmp_path / "run")
