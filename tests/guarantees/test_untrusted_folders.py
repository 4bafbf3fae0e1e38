"""Untrusted run folders: bad contents are refused in one sentence, before they use memory or run."""

from __future__ import annotations

import contextlib
import io
import json
import subprocess
import sys
import tracemalloc
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from agents.policies.network import WEIGHTS, read_policy
from agents.policies.registry import find_policy
from agents.runners import in_turn
from agents.runs import EVALUATIONS, LOCK, read_settings
from agents.settings import EnvSettings, TrainSettings
from agents.sweep import LOG, SWEEP, TABLE, carry_out, new_sweep, read_sweep, run_trial
from agents.training.best import read_evaluations
from agents.training.models import make_ppo, make_vec_env
from jackbox_env.sb3 import load_model, save_model
from jackbox_env.sb3.saved_models import write_entries
from jackbox_env.tools.reading import unpacked

TINY = TrainSettings.suited(action="torque", num_envs=1, rollout_steps=2, batch_size=2, hidden_units=(4,))
MOST_MEMORY = 10_000_000  # [bytes]


@contextmanager
def little_memory() -> Iterator[None]:
    """Fail if Python took much memory in the block."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < MOST_MEMORY
    finally:
        tracemalloc.stop()


def folder_with(tmp_path: Path, settings: str | bytes) -> Path:
    (tmp_path / "settings.json").write_bytes(settings if isinstance(settings, bytes) else settings.encode())
    return tmp_path


def changed(**values: Any) -> str:
    return json.dumps({**asdict(TINY), **values})


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ("[" * 100_000, "(maximum recursion depth|Stack overflow)"),
        (b'{"seed": "\x80"}', "0x80"),
        ("[1, 2]", r"got \[1, 2\]"),
        (changed(units=3), "got 'units'"),
        (
            '{"seed": 3, "repeat": 4}',
            "of another version, without task, contact, substeps, cannot be used: train again",
        ),
        ('{"seed": ' + "9" * 5000 + "}", "limit"),
        (changed(hidden_units=[[1]]), r"hidden_units .* got \[1\]"),
        (changed(scene="[" * 100_000), "scene must be"),
        (changed(fidelity={}), "fidelity .* got {}"),
        (" " * 1_000_001, "at most 1,000,000 bytes, got 1,000,001"),
    ],
)
def test_unusable_settings_are_refused_in_one_sentence(tmp_path: Path, settings: str | bytes, reason: str) -> None:
    folder = folder_with(tmp_path, settings)
    with pytest.raises(ValueError, match=f"^{folder}/settings.json has no settings of a run: .*{reason}") as refusal:
        read_settings(folder)
    assert "\n" not in str(refusal.value)
    assert len(str(refusal.value)) < 600


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"hidden_units": [5000, 5000]}, "hidden_units .* 20,000,000 weights"),
        ({"hidden_units": [1] * 33}, "hidden_units .* got 33"),
        ({"rollout_steps": 10**9}, r"num_envs \* rollout_steps .* got 1,000,000,000"),
        ({"total_steps": 10**400}, "total_steps .* got 1000"),
        ({"control_dt": -1.0}, "control_dt must .* above 0, got -1.0"),
    ],
)
def test_absurd_sizes_are_refused_before_anything_is_made(tmp_path: Path, values: dict[str, Any], reason: str) -> None:
    folder = folder_with(tmp_path, changed(**values))
    (folder / "model.zip").write_bytes(b"")
    with little_memory(), pytest.raises(ValueError, match=f"has no settings of a run: {reason}"):
        find_policy(str(folder / "model.zip"), EnvSettings())


def with_arguments(**change: Any) -> dict[str, Any]:
    return {"arguments": {**TINY.arguments, **change}}


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (with_arguments(policy_kwargs={"net_arch": [5000, 5000]}), "hidden_units .* 20,000,000 weights"),
        (with_arguments(policy_kwargs={"net_arch": [1] * 33}), "hidden_units .* got 33"),
        (with_arguments(policy_kwargs={"net_arch": "x"}), "net_arch must be a whole number .* got 'x'"),
        (
            with_arguments(policy_kwargs={"net_arch": [4], "features_extractor_class": "x"}),
            "policy_kwargs accepts only",
        ),
        (with_arguments(n_steps=10**9), r"num_envs \* rollout_steps .* got 1,000,000,000"),
        (with_arguments(n_steps=1.5), "n_steps must be a whole number"),
        (with_arguments(batch_size="x"), "is no model of env.json beside it: TypeError"),
        (with_arguments(tensorboard_log="/"), "arguments accepts only .* got 'tensorboard_log'"),
        ({"arguments": 5}, "is no model of env.json beside it: TypeError"),
        ({"env": {"observation": "pixels-4096x4096x4095"}}, "Pixels must be at most"),
        ({"env": {"observation": "mine.py:seen"}}, "runs code .'mine.py:seen'.: if you trust its author"),
        ({"env": {"torques": 1}}, "has no argument 'torques'"),
        ({"wrappers": [{"stack": 10**9}]}, "stack must be a whole number from 1 to 1000"),
        ({"env": {"observation": "pixels-200x200x3"}, "wrappers": [{"stack": 1000}]}, "from 1 to 83, got 1000"),
        ({"env": {}, "missing": ["task"]}, "that .* was trained with: load it with task="),
    ],
)
def test_an_untrusted_description_is_refused_before_anything_is_made(
    saved: Path, change: dict[str, Any], reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(saved)
    (saved / "env.json").write_text(json.dumps({"model.zip": {**entry_in(saved), **change}}))
    (saved / "mine.py").write_text("import pathlib\npathlib.Path('ran').touch()\nseen = None")
    (saved / "settings.json").unlink()
    for load in (load_model, evaluated):
        with little_memory(), pytest.raises(ValueError, match=reason) as refusal:
            load(saved / "model.zip")
        assert "\n" not in str(refusal.value)
    assert not (saved / "ran").exists()


@pytest.mark.parametrize("algorithm", ["stable_baselines3.common.save_util:load_from_pkl", "os:system"])
def test_an_algorithm_is_of_stable_baselines3_even_if_it_is_trusted(saved: Path, algorithm: str) -> None:
    entry = {"algorithm": algorithm, "env": {}, "missing": [], "wrappers": []}
    (saved / "env.json").write_text(json.dumps({"model.zip": entry}))
    with pytest.raises(ValueError, match=f"algorithm must be of stable_baselines3 or sb3_contrib, got '{algorithm}'"):
        load_model(saved / "model.zip", trust=True)


def entry_in(folder: Path, name: str = "model.zip") -> dict[str, Any]:
    """What env.json has about a model."""
    entry: dict[str, Any] = json.loads((folder / "env.json").read_text())[name]
    return entry


def evaluated(path: Path, trust: bool = False) -> Any:
    """What evaluates a model file."""
    return find_policy(str(path), EnvSettings(), trust=trust)


# -- model files ------------------------------------------------------------------------------------------------------


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    """A run folder with a model."""
    folder = folder_with(tmp_path, changed())
    write_entries(folder, TINY.named, TINY.arguments)
    make_ppo(TINY, make_vec_env(TINY.env_settings, 1, 0)).save(folder / "model.zip")
    return folder


def members(content: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def zipped(contents: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        for name, content in contents.items():
            archive.writestr(name, content)
    return file.getvalue()


ZEROS = bytes(40_000_000)


def understated(content: bytes) -> bytes:
    """The same zip file with members whose headers declare 1000 bytes."""
    size = len(ZEROS).to_bytes(4, "little")
    assert content.count(size) == 2  # before the member, and in the list at the end
    return content.replace(size, (1000).to_bytes(4, "little"))


@pytest.mark.parametrize(
    ("kind", "understate", "sentence"),
    [
        *(
            (kind, False, r"must inflate to at most [\d,]+ bytes, got 40,")
            for kind in ("policy.pth", "more.pth", "data")
        ),
        ("a tensor", False, r"must inflate to at most [\d,]+ bytes, got 40,"),
        ("policy.pth", True, "Bad CRC-32"),
        ("a tensor", True, ""),
    ],
)
def test_a_zip_bomb_is_refused_before_it_is_inflated(saved: Path, kind: str, understate: bool, sentence: str) -> None:
    # Below 1 MB, it inflates to 40 MB: a member of the model, or of its tensors.
    contents, disguised = members((saved / "model.zip").read_bytes()), understated if understate else bytes
    if kind == "a tensor":
        tensors = members(contents["policy.pth"])
        largest = max(tensors, key=lambda name: len(tensors[name]))
        content = zipped({**contents, "policy.pth": disguised(zipped({**tensors, largest: ZEROS}))}, zipfile.ZIP_STORED)
    else:
        content = disguised(zipped({**({} if understate else contents), kind: ZEROS}))
    assert len(content) < 1_000_000
    (saved / "model.zip").write_bytes(content)
    match = f"is no model of env.json beside it: .*{sentence}"
    with little_memory(), pytest.raises(ValueError, match=match):
        load_model(saved)


@pytest.mark.parametrize("understate", [False, True])
def test_arrays_are_inflated_to_no_more_than_arrays_take(
    tmp_path: Path, understate: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, content = folder_with(tmp_path, changed()), zipped({"weight_0.npy": ZEROS, "timesteps.npy": b""})
    for name in (WEIGHTS, EVALUATIONS):
        (folder / name).write_bytes(understated(content) if understate else content)
    with little_memory():
        with pytest.raises(ValueError, match="has no policy: "):
            read_policy(folder)
        assert read_evaluations(folder, 2).timesteps == []
    assert f"Skipped: {folder / EVALUATIONS} is damaged" in capsys.readouterr().err


@pytest.mark.parametrize("method", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_other_methods_are_refused(saved: Path, method: int) -> None:
    with pytest.raises(ValueError, match="model.zip must be stored or deflated"):
        unpacked(zipped(members((saved / "model.zip").read_bytes()), method), "model.zip")


def test_loading_never_unpickles_and_would_be_seen_to(saved: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """A model whose pickled part runs code when unpickled: loaded safely it does not, with trust it does."""
    shared = tmp_path_factory.mktemp("shared")
    for name in ("settings.json", "env.json"):
        (shared / name).write_bytes((saved / name).read_bytes())
    witness = shared / "witness"
    code = f"""
import base64, cloudpickle, pathlib
class Bomb:
    def __reduce__(self):
        return pathlib.Path.touch, (pathlib.Path({str(witness)!r}),)
print(base64.b64encode(cloudpickle.dumps(Bomb())).decode())
"""
    payload = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()
    contents = members((saved / "model.zip").read_bytes())
    poison = {":type:": "<class 'function'>", ":serialized:": payload}
    contents["data"] = json.dumps({**json.loads(contents["data"]), "lr_schedule": poison}).encode()
    (shared / "model.zip").write_bytes(zipped(contents))
    for trust in (False, True):  # which is for models without settings only
        model, envs = load_model(shared, trust=trust)
        assert model.predict(envs.reset())[0].shape == (1, 1)  # type: ignore[arg-type]
        find_policy(str(shared), EnvSettings(), trust=trust)
    assert not witness.exists()
    (shared / "settings.json").unlink()
    save_model(model, shared / "described.zip")  # for its entry
    (shared / "env.json").write_text(json.dumps({"model.zip": entry_in(shared, "described.zip")}))
    for load in (load_model, evaluated):
        with pytest.raises(ValueError, match="model.zip can run code, as it is unpickled: if you trust its author"):
            load(shared / "model.zip")
        assert not witness.exists()
        with contextlib.suppress(Exception):  # it may or may not load after what it did
            load(shared / "model.zip", trust=True)
        assert witness.exists()
        witness.unlink()


# -- sweeps -----------------------------------------------------------------------------------------------------------


def test_what_becomes_code_after_a_sweep_was_read_does_not_run(saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As if an earlier trial had removed a folder, whose name then is a function's, and a settings file."""
    monkeypatch.chdir(saved)
    Path("f.py:act").mkdir()
    trials = [{"policy": "f.py:act", **asdict(EnvSettings()), "seed": 0, "episodes": 2}]
    trials.append({**trials[0], "policy": "model.zip"})
    record = json.loads((new_sweep(Path("sweep"), trials) / SWEEP).read_text())
    record["code"] = {"f.py": "import pathlib\npathlib.Path('ran').touch()\ndef act(seen): return seen[:, :1]"}
    (Path("sweep") / SWEEP).write_text(json.dumps(record))
    _, code = read_sweep(Path("sweep"))
    Path("f.py:act").rmdir()
    Path("settings.json").unlink()
    Path("env.json").write_text(Path("env.json").read_text().replace("arguments", "others"))
    for trial, said in zip(trials, ("f.py:act is code, which runs only with --trust", "use --trust"), strict=True):
        with pytest.raises((ValueError, FileNotFoundError), match=said):
            run_trial(Path("sweep"), code, trial)
    assert not Path("ran").exists()
    with pytest.raises(ValueError, match="sweep runs code"):
        read_sweep(Path("sweep"))
    _, code = read_sweep(Path("sweep"), trust=True)
    assert run_trial(Path("sweep"), code, trials[0])["mean"]
    assert Path("ran").exists()


# -- links and damaged lines ------------------------------------------------------------------------------------------


def test_a_lock_or_results_log_that_is_a_link_leads_nowhere(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("precious")
    folder, grid = tmp_path / "run", [{"number": number} for number in range(2)]
    new_sweep(folder, grid)
    (folder / LOCK).symlink_to(tmp_path / "mine")
    with pytest.raises(OSError, match=f"symbolic links: .*{folder / LOCK}"):
        carry_out(folder, grid, dict, in_turn, progress=False)
    for link in (Path.symlink_to, Path.hardlink_to):
        for name in (LOCK, LOG):
            (folder / name).unlink(missing_ok=True)
        (folder / LOCK).hardlink_to(tmp_path / "mine")
        link(folder / LOG, tmp_path / "mine")
        assert len(carry_out(folder, grid, dict, in_turn, progress=False)) == 2
        assert (tmp_path / "mine").read_text() == "precious"


@pytest.mark.parametrize("harm", [{"result": 5}, {"settings": []}, {"more": 1}, {"result": {"share": "\ud800"}}, None])
def test_a_damaged_line_of_a_results_log_is_named_and_its_trial_run_again(
    harm: dict[str, Any] | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    grid = [{"number": number} for number in range(3)]
    folder, asked = new_sweep(tmp_path / "sweep", grid), list[int]()

    def work(settings: dict[str, Any]) -> dict[str, Any]:
        asked.append(settings["number"])
        return {"share": settings["number"] / 7.0}

    carry_out(folder, grid, work, in_turn, progress=False)
    table, path = (folder / TABLE).read_bytes(), folder / LOG
    lines = path.read_text().splitlines()
    lines[1] = json.dumps({**json.loads(lines[1]), **harm}) if harm else "{]"
    path.write_text("\n".join([*lines, ""]))
    carry_out(folder, grid, work, in_turn, progress=False)
    assert asked == [0, 1, 2, 1]
    assert f"Skipped: {path}, line 2, is damaged" in capsys.readouterr().err
    assert (folder / TABLE).read_bytes() == table
