"""The evaluate command: refusals before it computes, its notes, and its pages."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from stable_baselines3.common.evaluation import evaluate_policy

from agents.evaluation.episodes import page_names, record_episode
from agents.evaluation.provenance import note_other_environment
from agents.policies.models import ENV_KEYWORDS
from agents.policies.registry import find_policy
from agents.settings import PER_POLICY, EnvSettings
from agents.training.models import derived_seed
from jackbox_env.sb3 import load_model, make_sb3_vec_env, save_model
from jackbox_env.simulators.fidelity import KEYWORDS
from jackbox_env.tools import user_code
from tests.agents.test_sweep import MINE
from tests.commands.test_samples import data_of
from tests.script import script


def test_it_writes_an_episode_of_each_policy_as_a_page_of_the_scene_that_was_drawn(tmp_path: Path, run: Path) -> None:
    varied = '{"box_half_width": [3.0, 9.0], "gravity": [1.0, 20.0]}'
    arguments = ["--policy", "level", "chirp", str(run), "--episodes", "1", "--task", "spin", "--randomize", varied]
    arguments += ["--fidelity", "exact", "--html", "--folder", "pages"]
    done = script("evaluate", *arguments, "--json", "out.json", cwd=tmp_path)
    names = sorted(page.name for page in (tmp_path / "pages").iterdir())
    assert len(names) == 3
    assert {"chirp.html", "level.html"} < set(names)
    for row in json.loads((tmp_path / "out.json").read_text())["results"][:2]:  # the first episode that was counted
        assert f"{row['policy']}.html: return {row['mean']:.1f}" in done.stdout
    settings = EnvSettings(randomize=varied)
    start = derived_seed("evaluation", 0)
    scene = record_episode(find_policy("level", settings), settings.env_settings, start).motion.scene
    data = data_of(tmp_path / "pages" / "level.html")
    assert data["held"]
    assert data["halfWidth"] == scene.box_half_width != 6.0
    assert {"task": "spin", "gravity": f"{scene.gravity:g} m/s\u00b2"}.items() <= dict(data["facts"]).items()


def test_names_of_pages_are_distinct() -> None:
    names = page_names(["a/b/run", "a_b_run", "c/run", "c/RUN", "..", "y" * 300, "zero"])
    assert list(names.values())[:4] == ["run.html", "a_b_run.html", "run-2.html", "RUN-3.html"]
    assert not any(name.startswith(".") or len(name) > 100 for name in names.values())


# A value of each keyword of the environment, and for those that change what a return means, how it is printed.
VALUES: dict[str, tuple[Any, str]] = {
    "contact": ("pymunk", "fidelity balanced"), "substeps": (8, "contact pymunk, substeps 8"),
    "fidelity": ("coarse", "fidelity coarse"), "scene": ({"gravity": 2.0}, "scene {'gravity': 2.0}"),
    "task": ("spin", "task spin"), "control_dt": (0.05, "control_dt 0.05"),
    "randomize": ({"gravity": [1, 4]}, "randomize {'gravity': [1, 4]}"), "episode_steps": (50, "episode_steps 50"),
    "max_episode_steps": (40, "episode_steps 40"), "observation": ("landing", ""), "action": ("discrete", ""),
    "action_repeat": (3, ""), "torque": ("chirp", ""),
}  # fmt: skip

STILL = "import numpy as np\ndef act(observations):\n    return np.zeros(len(observations), int)\n"

TWO = ["--trust", "--episodes", "2", "--json", "out.json"]


def returns_in(path: Path) -> list[list[float]]:
    return [row["returns"] for row in json.loads(path.read_text())["results"]]


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a function, a saved model, and their returns beside those of zero."""
    from stable_baselines3 import PPO

    folder = tmp_path_factory.mktemp("usual")
    (folder / "still.py").write_text(STILL)
    save_model(PPO("MlpPolicy", make_sb3_vec_env(1, fidelity="exact")), folder / "model.zip")
    script("evaluate", "--policy", "zero", "still.py:act", "model.zip", *TWO, cwd=folder)
    return folder


@pytest.mark.parametrize("name", [name for name in ENV_KEYWORDS if name not in PER_POLICY])
def test_policies_are_compared_on_the_same_episodes(name: str, tmp_path: Path, usual: Path) -> None:
    value, fact = VALUES[name]
    env, stored = tmp_path / "env.json", json.loads((usual / "env.json").read_text())
    stored["model.zip"]["env"] |= {"fidelity": None} if name in KEYWORDS else {}
    stored["model.zip"]["env"][name] = value
    env.write_text(json.dumps(stored))
    shutil.copy(usual / "model.zip", tmp_path)
    refused = script("evaluate", "--policy", "zero", "model.zip", "--film", "film.gif", *TWO, cwd=tmp_path, status=2)
    assert f"model.zip would play with {fact}, zero with " in refused.stderr.splitlines()[-1]
    assert {path.name for path in tmp_path.iterdir()} == {"env.json", "model.zip"}
    chosen = ["--policy", "zero", f"{usual}/still.py:act", "model.zip", "--env", f"{name}={json.dumps(value)}"]
    assert fact in script("evaluate", *chosen, *TWO, cwd=tmp_path).stdout
    for before, after in zip(returns_in(usual / "out.json"), returns_in(tmp_path / "out.json"), strict=True):
        assert before != after
    still, zero, _ = returns_in(tmp_path / "out.json")
    assert still == zero


@pytest.mark.parametrize("name", PER_POLICY)
def test_what_policies_observe_and_do_may_differ(name: str, tmp_path: Path, usual: Path) -> None:
    chosen = ["--policy", "zero", f"{usual}/still.py:act", "--env", f"{name}={VALUES[name][0]}"]
    done = script("evaluate", *chosen, *TWO, cwd=tmp_path)
    assert returns_in(tmp_path / "out.json")[0] == returns_in(usual / "out.json")[0]
    assert ("still.py:act (torque chirp) |" in done.stdout) == (name == "torque")


def test_chosen_keywords_reach_scripted_policies_planners_and_networks_as_options_do(tmp_path: Path) -> None:
    few = ["--policy", "level", "planner-fast", "ppo", "--episodes", "1", "--json"]
    script("evaluate", *few, "a", "--task", "spin", "--scene", '{"gravity": 2.0}', "--dt", "0.05", cwd=tmp_path)
    words = "task=spin", 'scene={"gravity": 2.0}', "control_dt=0.05"
    script("evaluate", *few, "b", *(word for one in words for word in ("--env", one)), cwd=tmp_path)
    assert returns_in(tmp_path / "a") == returns_in(tmp_path / "b")


def test_a_film_is_as_long_as_the_episodes_of_the_table(tmp_path: Path) -> None:
    import imageio.v3 as imageio

    few = ["--policy", "zero", "chirp", "--episodes", "1", "--env", "episode_steps=24", "--env", "control_dt=0.05"]
    done = script("evaluate", *few, "--film", "film.gif", "--json", "out.json", cwd=tmp_path)
    assert len(imageio.imread(tmp_path / "film.gif")) == 24
    ((one,), (other,)) = returns_in(tmp_path / "out.json")
    assert done.stdout.endswith(f"  zero: return {one:.1f}\n  chirp: return {other:.1f}\n")


def test_a_planner_among_varied_scenes_is_noted(capsys: pytest.CaptureFixture[str]) -> None:
    settings = EnvSettings(randomize='{"jack_mass": [2, 6]}')
    note_other_environment("planner", find_policy("planner", settings), settings.env_settings)
    assert capsys.readouterr().err.startswith("Note: planner plans in the scene that is given")


def test_a_task_and_an_observation_of_a_file_train_and_play_and_run_only_if_trusted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forget() -> None:
        """As in a new process."""
        monkeypatch.setattr(user_code, "_loaded", {})

    (tmp_path / "mine.py").write_text(MINE.format(value=1.0))
    names = ["--task", "mine.py:task", "--observation", "mine.py:angle", "--action", "torque", "--fidelity", "coarse"]
    script("train", *names, "--total-steps", "64", "--num-envs", "2", "--folder", "run", "--no-progress", cwd=tmp_path)
    play = ["--task", "mine.py:task", "--fidelity", "coarse", "--policy", "level", "zero", "run", "--episodes", "2"]
    assert "Note" not in script("evaluate", *play, "--trust", "--json", "one.json", cwd=tmp_path).stderr
    record = json.loads((tmp_path / "one.json").read_text())
    assert (record["env"]["task"], record["results"][2]["keywords"]["observation"]) == ("mine.py:task", "mine.py:angle")
    assert len({row["mean"] for row in record["results"]}) == 3
    for name, arguments in (
        ("evaluate", ["--policy", "run"]),
        ("train", ["--resume", "run", "--total-steps", "128"]),
        ("export", ["run", "arrays"]),
    ):
        forget()
        refused = script(name, *arguments, cwd=tmp_path, status=2).stderr
        assert refused == "run runs code ('mine.py:task'): if you trust its author, use --trust\n"
    # The run has the text that it was trained with, wherever it is used; two texts under one name are refused.
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "mine.py").write_text(MINE.format(value=900.0))
    script("export", "../run", "../arrays", "--trust", cwd=tmp_path / "elsewhere")
    means = []
    for folder, *policies in (("elsewhere", "../run", "../arrays"), (".", "run")):
        forget()
        again = ["--policy", *policies, "--episodes", "2", "--trust", "--json", "again.json"]
        noted = script("evaluate", *again, cwd=tmp_path / folder).stderr
        assert f"{policies[0]} was trained in another environment (task mine.py:task, fidelity coarse)" in noted
        means += [row["mean"] for row in json.loads((tmp_path / folder / "again.json").read_text())["results"]]
    assert len(set(means)) == 1
    forget()
    monkeypatch.chdir(tmp_path / "elsewhere")
    with pytest.raises(ValueError, match="run runs code"):
        load_model("../run")
    model, envs = load_model("../run", 2, trust=True)
    envs.seed(derived_seed("evaluation", 0))
    assert evaluate_policy(model, envs, 2)[0] == pytest.approx(record["results"][2]["mean"])
    forget()
    refused = script("evaluate", *play[:5], "../run", "--trust", cwd=tmp_path / "elsewhere", status=2).stderr
    assert refused.startswith("../run cannot be used: ValueError: mine.py has two versions here")
    script("train", "--resume", "run", "--total-steps", "128", "--trust", "--no-progress", cwd=tmp_path)


def test_files_of_one_name_have_different_neighbours_and_dataclasses_work(tmp_path: Path) -> None:
    for folder, value in (("a", 1.0), ("b", 2.0)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "neighbour.py").write_text(f"VALUE = {value}\n")
        (tmp_path / folder / "mine.py").write_text(
            "from __future__ import annotations\nfrom dataclasses import dataclass\nfrom neighbour import VALUE\n"
            "@dataclass\nclass Number:\n    value: float = VALUE\n"
        )
    names = [f"{tmp_path}/{folder}/mine.py:Number" for folder in ("a", "b")]
    user_code.load(names)
    assert [user_code.loaded(name)().value for name in names] == [1.0, 2.0]
