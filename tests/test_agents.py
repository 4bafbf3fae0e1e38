"""Agents and command lines: policies, training that resumes, safe loading, evaluation, simulation, film."""

from __future__ import annotations

import contextlib
import csv
import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
import zipfile
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3.common.evaluation import evaluate_policy

from agents import training
from agents.best import choosing_seed
from agents.checkpoints import Checkpoint, kept_steps
from agents.evaluation import Returns, evaluate, find_policy, table
from agents.film import film
from agents.models import load_model, make_ppo, make_vec_env
from agents.policies import BASELINES, baseline
from agents.runs import describe, new_folder, read_settings
from agents.settings import EnvSettings, TrainSettings
from agents.trajectory import simulate, write_npz
from jackbox_env import Scene, make_simulator
from jackbox_env.simulators.fidelity import Setting
from tests.states import load

ROOT = Path(__file__).parents[1]
# Seconds instead of minutes: an update every 64 steps of 4 environments.
TINY = TrainSettings(
    total_steps=2048,
    num_envs=4,
    rollout_steps=64,
    batch_size=64,
    epochs=2,
    checkpoint_steps=512,
    eval_steps=1024,
    eval_episodes=4,
    hidden_units=(16,),
)


def script(name: str, *arguments: str, cwd: Path, status: int = 0) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "scripts" / f"{name}.py"), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=250, check=False)
    assert done.returncode == status, done.stderr
    return done


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of training."""
    folder = new_folder(tmp_path_factory.mktemp("runs") / "run", "test")
    describe(folder, TINY)
    training.train(TINY, folder, progress=False)
    return folder


# -- scripted policies ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", BASELINES)
def test_baselines_predict_as_stable_baselines3_does(name: str) -> None:
    policy, more = baseline(name, Scene())
    env = gym.make("JackInBox-v0", **more)
    observation, _ = env.reset(seed=0)
    action, state = policy.predict(observation, state=None, episode_start=np.array([True]), deterministic=True)
    assert action in env.action_space
    assert state is None
    actions, _ = policy.predict(np.stack([observation] * 5))
    assert actions.shape == (5, 1)
    assert actions.dtype == np.float32
    assert policy.predict(observation[None])[0].shape == (1, 1)
    mean, _ = evaluate_policy(policy, env, n_eval_episodes=1, warn=False)
    assert 0.0 < float(mean) < 500.0  # type: ignore[arg-type]


def test_level_answers_angle_and_rate() -> None:
    level = baseline("level", Scene()).policy
    observation = np.zeros((4, 10), dtype=np.float32)
    observation[:, 4] = 1.0
    observation[1, 5] = 0.01  # turned counter-clockwise
    observation[2, 6] = 0.01  # turning counter-clockwise
    observation[3, 4:6] = 0.0, -1.0  # far
    actions = level.predict(observation)[0][:, 0]
    # J_b stiffness theta / limit = 14400 * 10 * 0.01 / 90000; J_b damping omega / limit with omega = 0.01 v0 / L
    np.testing.assert_allclose(actions, [0.0, -0.016, -14400 * 5 * 0.01 * 10.8499 / 6 / 90000, 1.0], rtol=1e-3)


def test_the_random_policy_follows_its_seed() -> None:
    rows = np.zeros((100, 10))
    one, same, other = (baseline("random", Scene(), seed).policy.predict(rows)[0] for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)
    assert np.ptp(one) > 1.5


def test_an_unknown_policy_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="a baseline must be one of 'random', 'chirp', 'zero', 'level', got 'pid'"):
        baseline("pid", Scene())
    with pytest.raises(FileNotFoundError, match="a policy must be one of .* or a run folder or model file, got 'pid'"):
        find_policy("pid", Scene(), 0)


# -- evaluation -------------------------------------------------------------------------------------------------------


def test_returns_carry_their_interval() -> None:
    row = Returns("x", (1.0, 2.0, 3.0, 4.0))
    half_width = 1.96 * np.std([1, 2, 3, 4], ddof=1) / 2
    assert row.mean == 2.5
    assert row.interval == pytest.approx((2.5 - half_width, 2.5 + half_width))
    assert "| x      |         2.5 |    1.2 to 3.8    |        4 |" in table([row]).splitlines()
    assert Returns("x", (1.0,)).half_width == np.inf


def test_evaluation_is_repeatable_and_seeded() -> None:
    policy = baseline("level", Scene()).policy
    one, same, other = (evaluate("level", policy, {}, 4, seed) for seed in (0, 0, 100))
    assert one == same
    assert one.returns != other.returns
    assert len(set(one.returns)) == 4


def test_the_untrained_policy_does_not_beat_zero_torque() -> None:
    # DESIGN: about 158 against 200; the demo's trained policy stands above 200 with intervals apart.
    untrained = make_ppo(TrainSettings(), make_vec_env({}, 1, 0))
    rows = [
        evaluate("untrained", untrained, {}, 64, seed=0, deterministic=False),
        evaluate("zero", baseline("zero", Scene()).policy, {}, 64, seed=0),
    ]
    assert rows[0].interval[1] < rows[1].interval[0], table(rows)


# -- training ---------------------------------------------------------------------------------------------------------


def test_a_run_folder_holds_what_the_run_was_made_from(run: Path) -> None:
    assert read_settings(run) == TINY
    record = json.loads((run / "run.json").read_text())
    assert record["seed"] == TINY.seed
    assert record["command"] == sys.argv
    assert record["versions"]["torch"].startswith("2.13.0")
    assert set(record["versions"]) >= {"python", "jackbox", "pymunk", "stable-baselines3", "commit"}
    for name in ("model.zip", "best_model.zip", "evaluations.npz", "tensorboard", "checkpoints/ppo_512.zip"):
        assert (run / name).exists(), name
    stored = np.load(run / "evaluations.npz")
    assert stored["timesteps"].tolist() == [1024, 2048]
    assert stored["results"].shape == (2, 4)
    assert not list(run.rglob("*.partial*"))


def test_training_learns_from_its_rollouts(run: Path) -> None:
    before = make_ppo(TINY, make_vec_env({}, 1, 0)).get_parameters()["policy"]
    after = load_model(run / "model.zip").get_parameters()["policy"]
    assert max(float((after[name] - before[name]).abs().max()) for name in before) > 1e-3


def test_the_best_model_is_the_best_evaluation(run: Path) -> None:
    stored = np.load(run / "evaluations.npz")
    environments = make_vec_env(TINY.env_settings, 4, 0)
    environments.seed(choosing_seed(TINY))
    best, _ = evaluate_policy(load_model(run), environments, n_eval_episodes=4)
    assert best == pytest.approx(stored["results"].mean(axis=1).max(), rel=1e-6)


def test_interrupted_training_resumes_to_the_same_total(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = new_folder(tmp_path / "run", "test")
    describe(folder, TINY)

    class Interrupt(Checkpoint):
        def _on_step(self) -> bool:
            if self.num_timesteps >= 1300:
                raise KeyboardInterrupt
            return True

    with monkeypatch.context() as patched:
        patched.setattr(training, "Checkpoint", Interrupt)
        with pytest.raises(KeyboardInterrupt):
            training.train(TINY, folder, progress=False)
    # the last checkpoint was made for the evaluation at 1024, the rollout under way began at 1280
    assert kept_steps(folder) == [1280, 768, 512]
    assert not (folder / "model.zip").exists()
    model = training.train(TINY, folder, progress=False)
    assert model.num_timesteps == TINY.total_steps
    assert np.load(folder / "evaluations.npz")["timesteps"].tolist() == [1024, 2048]
    with pytest.raises(FileExistsError, match="is finished: it has a model.zip, and runs are never overwritten"):
        training.train(TINY, folder, progress=False)


def test_a_resumed_run_goes_on_from_the_weights_it_had(tmp_path: Path, run: Path) -> None:
    # Resuming at the total changes nothing: the checkpoint's weights come out again.
    folder = new_folder(tmp_path / "run", "test")
    describe(folder, replace(TINY, total_steps=768))
    (folder / "checkpoints").mkdir()
    checkpoint = folder / "checkpoints" / "ppo_768.zip"
    checkpoint.write_bytes((run / "checkpoints" / "ppo_768.zip").read_bytes())
    resumed = training.train(replace(TINY, total_steps=768), folder, progress=False)
    kept = load_model(checkpoint).get_parameters()
    for group, parameters in resumed.get_parameters().items():
        if group == "policy":
            for name, value in parameters.items():
                np.testing.assert_array_equal(value.numpy(), kept[group][name].numpy())
    assert kept["policy.optimizer"]["state"], "the optimiser's moments are part of a checkpoint"


def test_a_deadline_ends_training(tmp_path: Path) -> None:
    folder = new_folder(tmp_path / "run", "test")
    hurried = replace(TINY, total_steps=10_000_000, max_minutes=0.02)
    model = training.train(hurried, folder, progress=False)
    assert 0 < model.num_timesteps < 10_000_000
    assert (folder / "model.zip").exists()


# -- loading ----------------------------------------------------------------------------------------------------------


def test_loading_never_unpickles(run: Path, tmp_path: Path) -> None:
    """A model whose pickled part runs code when unpickled: loaded safely it does not, with trust it does."""
    shared = tmp_path / "shared"
    shared.mkdir()
    (shared / "settings.json").write_text((run / "settings.json").read_text())
    witness = tmp_path / "witness"
    code = f"""
import base64, cloudpickle, pathlib
class Bomb:
    def __reduce__(self):
        return pathlib.Path.touch, (pathlib.Path({str(witness)!r}),)
print(base64.b64encode(cloudpickle.dumps(Bomb())).decode())
"""
    payload = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()
    with (
        zipfile.ZipFile(run / "model.zip") as original,
        zipfile.ZipFile(shared / "model.zip", "w") as poisoned,
    ):
        for name in original.namelist():
            content = original.read(name)
            if name == "data":
                data = json.loads(content)
                data["lr_schedule"] = {":type:": "<class 'function'>", ":serialized:": payload}
                content = json.dumps(data).encode()
            poisoned.writestr(name, content)
    observation = np.zeros(10, dtype=np.float32)
    np.testing.assert_array_equal(load_model(shared).predict(observation)[0].shape, (1,))
    assert not witness.exists()
    load_model(shared, trust=True)  # trust is for models without settings only
    assert not witness.exists()
    (shared / "settings.json").unlink()
    with contextlib.suppress(Exception):  # it may or may not load after what it did
        load_model(shared, trust=True)
    assert witness.exists()


def test_models_that_are_not_there_or_do_not_fit_are_refused(run: Path, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="holds no model: best_model.zip or model.zip was looked for"):
        load_model(tmp_path)
    lonely = tmp_path / "a" / "b" / "model.zip"
    lonely.parent.mkdir(parents=True)
    lonely.write_bytes((run / "model.zip").read_bytes())
    with pytest.raises(FileNotFoundError, match="has no settings.json beside it .* use --trust"):
        load_model(lonely)
    (lonely.parent / "settings.json").write_text(json.dumps(asdict(replace(TINY, hidden_units=(8, 8)))))
    with pytest.raises(ValueError, match="is no model of the settings beside it"):
        load_model(lonely)
    lonely.write_bytes(b"nonsense")
    with pytest.raises(ValueError, match="is no model of the settings beside it"):
        load_model(lonely)


# -- settings ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("field", "bad", "sentence"),
    [
        ("total_steps", 0, "total_steps must be a whole number >= 1, got 0"),
        ("batch_size", 1, "batch_size must be a whole number >= 2, got 1"),
        ("num_envs", 1.5, "num_envs must be a whole number >= 1, got 1.5"),
        ("seed", -1, "seed must be a whole number from 0 to 4294967295, got -1"),
        ("learning_rate", float("nan"), "learning_rate must be a finite number above 0, got nan"),
        ("gamma", 1.1, "gamma must be a finite number at least 0 and at most 1, got 1.1"),
        ("hidden_units", (0,), "hidden_units must be a whole number >= 1, got 0"),
        ("max_minutes", 0.0, "max_minutes must be a finite number above 0, got 0.0"),
        ("scene", "[1]", r"scene must be a JSON object, got '\[1\]'"),
        ("scene", "{", "scene must be a JSON object, got '{'"),
        ("scene", '{"mass": 1}', "scene takes only .* got 'mass'"),
    ],
)
def test_impossible_settings_are_refused(field: str, bad: Any, sentence: str) -> None:
    with pytest.raises((TypeError, ValueError), match=sentence):
        TrainSettings(**{field: bad})


def test_run_folders_are_never_reused(tmp_path: Path) -> None:
    with pytest.raises(FileExistsError, match="exists, and runs are never overwritten: choose another folder"):
        new_folder(tmp_path, "test")


# -- trajectories and films -------------------------------------------------------------------------------------------


def test_npz_of_a_weightless_scene_without_impacts(tmp_path: Path) -> None:
    simulator = make_simulator(Scene(gravity=0.0, drive=None))
    (path,) = write_npz(simulate(simulator, 0.1, 0.02, progress=False), tmp_path)
    with np.load(path) as stored:
        assert stored["state"].shape == (6, 12)
        assert stored["impact_time"].shape == (0,)


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_films_show_the_policies_side_by_side(tmp_path: Path, suffix: str) -> None:
    import imageio.v3 as imageio

    acts = {name: baseline(name, Scene()) for name in ("zero", "chirp")}
    path = film(acts, {}, tmp_path / f"film{suffix}", seed=0, seconds=1.2, width=128, progress=False)
    frames = imageio.imread(path)
    assert frames.shape[0] == 30
    assert frames.shape[2:] == (256, 3)
    left, right = frames[-1][:, :128].astype(int), frames[-1][:, 128:].astype(int)
    assert np.abs(left - right).max() > 100  # the chirp turned its box
    with pytest.raises(FileExistsError, match="films are never overwritten"):
        film(acts, {}, path, seed=0)


# -- command lines ----------------------------------------------------------------------------------------------------


def test_simulate_writes_states_impacts_and_four_plots(tmp_path: Path) -> None:
    done = script("simulate", "--seconds", "3", "--folder", "out", cwd=tmp_path)
    folder = tmp_path / "out"
    with (folder / "states.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 151
    reference = load("seed_scene")[0]
    at_one_second = [float(value) for name, value in rows[50].items() if name != "time"]
    np.testing.assert_allclose(at_one_second, reference["states"][9]["state"], atol=1e-12)
    with (folder / "impacts.csv").open() as file:
        impacts = list(csv.DictReader(file))
    known = reference["impacts"][:3]
    assert [(int(row["wall"]), int(row["foot"])) for row in impacts] == [(hit["wall"], hit["foot"]) for hit in known]
    assert "3 impacts by t = 3 s" in done.stdout
    plots = sorted(path.name for path in folder.glob("*.png"))
    assert plots == [f"{body}_{what}.png" for body in ("box", "jack") for what in ("positions", "velocities")]
    again = script("simulate", "--folder", "out", cwd=tmp_path, status=2)
    assert "never overwritten" in again.stderr


def test_simulate_by_the_exact_model_gives_the_reference(tmp_path: Path) -> None:
    script("simulate", "--fidelity", "exact", "--seconds", "3", "--no-plots", "--folder", "out", cwd=tmp_path)
    with (tmp_path / "out" / "impacts.csv").open() as file:
        times = [float(row["time"]) for row in csv.DictReader(file)]
    known = [hit["time"] for hit in load("seed_scene")[0]["impacts"] if hit["time"] < 3.0]
    np.testing.assert_allclose(times, known, rtol=0.0, atol=1e-9)


def test_training_by_the_exact_model(tmp_path: Path) -> None:
    settings = dataclasses.replace(TINY, contact="exact", task="spin")
    folder = new_folder(tmp_path / "run", "test")
    describe(folder, settings)
    model = training.train(settings, folder, progress=False)
    assert model.num_timesteps >= settings.total_steps
    loaded = load_model(folder)
    assert loaded.predict(np.zeros((1, 10), dtype=np.float32))[0].shape == (1, 1)


def test_simulate_keeps_what_came_before_the_jack_left(tmp_path: Path) -> None:
    arguments = ["--scene", '{"box_mass": 0.01}', "--seconds", "5", "--folder", "out", "--no-plots"]
    done = script("simulate", *arguments, cwd=tmp_path, status=2)
    assert "the jack would leave the box" in done.stderr
    assert (tmp_path / "out" / "states.csv").stat().st_size > 100


def test_train_refuses_before_it_makes_a_folder(tmp_path: Path) -> None:
    done = script("train", "--contact", "box2d", "--folder", "run", cwd=tmp_path, status=2)
    assert "contact must be one of 'pymunk', 'exact', got 'box2d'" in done.stderr
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--seconds", "-1"], "seconds must be a finite number above 0"),
        (["--seconds", "nan"], "seconds must be a finite number above 0"),
        (["--dt", "20"], "dt must be at most seconds = 10, got 20"),
        (["--state", "[1, 2]"], r"state must have shape (12,), got shape (2,)"),
        (["--state", "[0,0,0,5.5,0,0,0,0,0,0,0,0]"], "a start must have every foot inside the box"),
        (["--state", "x"], "state must be a JSON list of 12 numbers, got 'x'"),
        (["--contact", "box2d"], "contact must be one of 'pymunk', 'exact', got 'box2d'"),
        (["--scene", '{"gravity": -1}'], "gravity must be a finite number at least 0"),
    ],
)
def test_simulate_refuses_nonsense_in_one_sentence(tmp_path: Path, arguments: list[str], sentence: str) -> None:
    done = script("simulate", *arguments, cwd=tmp_path, status=2)
    assert sentence in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_evaluate_compares_policies_and_writes_json(tmp_path: Path, run: Path) -> None:
    arguments = ["--policy", "zero", "chirp", str(run), "--episodes", "4", "--task", "spin", "--json", "out.json"]
    done = script("evaluate", *arguments, "--substeps", "2", cwd=tmp_path)
    stored = json.loads((tmp_path / "out.json").read_text())
    assert stored["env"]["task"] == "spin"
    assert [row["policy"] for row in stored["results"]] == ["zero", "chirp", str(run)]
    assert all(len(row["returns"]) == row["episodes"] == 4 for row in stored["results"])
    assert f"{stored['results'][0]['mean']:.1f}" in done.stdout
    assert "4 episodes each, seed 0, task spin, substeps 2" in done.stdout
    assert f"Note: {run} was trained in another environment (task juggle, default scene)" in done.stderr
    same = script("evaluate", "--policy", str(run), "--episodes", "2", "--fidelity", "balanced", cwd=tmp_path)
    assert "Note:" not in same.stderr  # another word for the same
    assert "is no folder" in script("evaluate", "--json", "no/out.json", cwd=tmp_path, status=2).stderr
    assert "never overwritten" in script("evaluate", *arguments, cwd=tmp_path, status=2).stderr


def test_training_survives_ctrl_c_and_resumes_from_the_command_line(tmp_path: Path) -> None:
    small = "--num-envs 4 --rollout-steps 64 --batch-size 64 --checkpoint-steps 256 --eval-steps 512 --eval-episodes 2"
    command = [sys.executable, str(ROOT / "scripts" / "train.py"), "--folder", "run", "--no-progress", *small.split()]
    process = subprocess.Popen(
        [*command, "--total-steps", "6144"], cwd=tmp_path, stderr=subprocess.PIPE, text=True, env=os.environ
    )
    checkpoints = tmp_path / "run" / "checkpoints"
    deadline = time.monotonic() + 120.0
    while not list(checkpoints.glob("*.zip")) and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert "Go on with: python scripts/train.py --resume run" in errors
    assert not (tmp_path / "run" / "model.zip").exists()
    assert "give no other setting" in script("train", "--resume", "run", "--seed", "3", cwd=tmp_path, status=2).stderr
    done = script("train", "--resume", "run", "--no-progress", cwd=tmp_path)
    assert "Going on after" in done.stdout
    assert "Trained. Models, settings and evaluations: run" in done.stdout
    assert (tmp_path / "run" / "model.zip").exists()
    assert "is finished" in script("train", "--resume", "run", cwd=tmp_path, status=2).stderr


def test_the_demo_runs_end_to_end_when_made_small(tmp_path: Path) -> None:
    done = script("demo", "--folder", "demo", "--total-steps", "8192", "--episodes", "4", cwd=tmp_path)
    for policy in (*BASELINES, "PPO"):
        assert f"| {policy}" in done.stdout
    for name in ("model.zip", "settings.json", "run.json", "results.json", "results.png", "film.gif"):
        assert (tmp_path / "demo" / name).stat().st_size > 100, name
    stored = json.loads((tmp_path / "demo" / "results.json").read_text())
    assert [row["policy"] for row in stored["results"]] == [*BASELINES, "PPO"]


@pytest.mark.parametrize(
    "name", ["train", "evaluate", "simulate", "play", "demo", "benchmark", "readme", "speed", "containment", "transfer"]
)
def test_every_command_line_explains_itself(name: str, tmp_path: Path) -> None:
    assert "show this help message" in script(name, "--help", cwd=tmp_path).stdout


def test_the_words_for_a_contact_setting_mean_one_setting() -> None:
    default = make_simulator(Scene())
    assert EnvSettings().setting == Setting("pymunk", default.substeps)  # type: ignore[attr-defined]
    assert EnvSettings(fidelity="balanced").setting == EnvSettings(contact="pymunk").setting
    assert EnvSettings(fidelity="exact").setting == EnvSettings(contact="exact").setting == Setting("exact")
    assert EnvSettings(fidelity="coarse", substeps=8).setting == Setting("pymunk", 8)
    with pytest.raises(ValueError, match="fidelity must be one of 'coarse', 'balanced', 'fine', 'exact', got 'slow'"):
        EnvSettings(fidelity="slow")
    env: Any = gym.make("JackInBox-v0", **EnvSettings(fidelity="exact").env_settings).unwrapped
    assert env.contact == "exact"


def test_a_run_from_before_fidelities_had_names_loads(tmp_path: Path) -> None:
    old = asdict(TINY)
    del old["fidelity"]
    (tmp_path / "settings.json").write_text(json.dumps({**old, "contact": "pymunk"}))
    assert read_settings(tmp_path).setting == TINY.setting


def test_env_settings_are_keyword_arguments_of_make() -> None:
    settings = EnvSettings(task="spin", substeps=3, scene='{"gravity": 1.62}')
    env: Any = gym.make("JackInBox-v0", **settings.env_settings).unwrapped
    assert (env.task, env.scene.gravity) == ("spin", 1.62)
