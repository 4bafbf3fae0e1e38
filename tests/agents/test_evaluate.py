"""The command that evaluates: what it refuses before it computes, what it notes, and the pages it writes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from agents import evaluation, training
from agents.episodes import record_episode
from agents.models import derived_seed
from agents.network import SHIPPED
from agents.policies import baseline
from agents.settings import EnvSettings
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
