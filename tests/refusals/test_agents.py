"""Settings, policies and run folders that cannot be used are refused in one sentence."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from agents.policies.network import NetworkPolicy, layers_of, read_policy, write_with_layers
from agents.policies.one_bounce import LandingSettings, read_landing
from agents.policies.planner import Planner
from agents.policies.registry import find_policy, policy_of_run
from agents.policies.value import Value, read_value
from agents.runs import read_settings
from agents.settings import EnvSettings, TrainSettings
from agents.sweep import new_sweep, read_sweep
from agents.training.models import make_ppo, make_vec_env
from jackbox_env import Scene
from jackbox_env.recording.film import check_film
from jackbox_env.sb3 import load_model
from jackbox_env.tools.files import write_json
from jackbox_env.tools.reading import DamagedFileError, read_json
from tests.agents.small_run import TINY
from tests.agents.test_saved_models import HERE
from tests.agents.untrained import layers_for
from tests.refusals.sentences import Refusal, Subject, assert_refused, contents, files, fill, folder, rows

# -- files of networks -------------------------------------------------------------------------------------------------


PLAIN = replace(TINY, contact="exact")


@cache
def plain_model() -> bytes:
    """An untrained model, as its file."""
    make_ppo(PLAIN, make_vec_env(PLAIN.env_settings, 1, 0)).save(file := io.BytesIO())
    return file.getvalue()


def plain_layers() -> Any:
    return layers_of(make_ppo(PLAIN, make_vec_env(PLAIN.env_settings, 1, 0)).get_parameters()["policy"])


WRITTEN: dict[str, tuple[Any, Any, Any, str]] = {  # how they are read and written, and what they have
    "settings.json": (read_policy, PLAIN, plain_layers, "policy"),
    "landing.json": (read_landing, LandingSettings(angles=(-0.3, 0.3), rates=(0.0,)), layers_for, "policy of landings"),
    "value.json": (read_value, EnvSettings(contact="exact"), layers_for, "value"),
}


def written(name: str, harm: Callable[[Path], object]) -> Subject:
    """A folder with a network, which is then harmed."""
    _, settings, layers, _ = WRITTEN[name]

    def start(path: Path) -> None:
        fill(path, {"run/a": ""})
        write_with_layers(path / "run", name, settings, layers())
        harm(path)

    return Subject(folder, start, contents)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


def unlinked(name: str) -> Callable[[Path], object]:
    return lambda path: (path / "run" / name).unlink()


def unfit(name: str, content: Any, sentence: str) -> Refusal:
    read, _, _, what = WRITTEN[name]
    harmed = written(name, lambda path: write_json(path / "run" / name, content))
    return Refusal(lambda _: read(Path("run")), ValueError, f"run has no {what}: {sentence}", harmed)


NETWORKS = [
    *(
        Refusal(
            lambda _, read=read: read(Path("run")),
            ValueError,
            f"run has no {what}: File is not a zip file",
            written(name, lambda path: cut(path / "run" / "weights.npz")),
        )
        for name, (read, _, _, what) in WRITTEN.items()
    ),
    *(
        Refusal(
            lambda _, read=read: read(Path("run")),
            FileNotFoundError,
            f"run has no {missing}",
            written(name, unlinked(missing)),
        )
        for name, (read, _, _, what) in WRITTEN.items()
        for missing in ("weights.npz", name)
    ),
    unfit("landing.json", {"action_repeat": 0}, "action_repeat must be a whole number from 1 to 500, got 0"),
    unfit("landing.json", {"angles": []}, "angles must be a list of 1 to 1000 numbers, got []"),
    unfit(
        "landing.json",
        {"angles": [0.0] * 40, "rates": [0.0] * 40},
        "angles and rates must make at most 1,000 pairs, got 1,600",
    ),
    unfit(
        "landing.json", {"angles": [3.0]}, "angles must be a finite number at least -1.5708 and at most 1.5708, got 3.0"
    ),
    unfit(
        "landing.json", {"rates": ["fast"]}, "rates must be a finite number at least -100 and at most 100, got 'fast'"
    ),
    unfit(
        "landing.json",
        {"speed": 1},
        "settings accepts only ..., 'angles', 'rates', got 'speed' (did you mean 'scene'?)",
    ),
    unfit("value.json", {"gravity": 3.0}, "settings accepts only ..., 'randomize', got 'gravity'"),
    unfit("value.json", {"scene": 3}, "scene must be a JSON object, got 3"),
    unfit("value.json", [], "settings must be a JSON object, got []"),
    unfit(
        "value.json", {"task": "dance"}, "task must be one of 'juggle', 'spin', 'rattle', 'file.py:name', got 'dance'"
    ),
    unfit(
        "value.json", {"contact": "pymunk", "substeps": -1}, "substeps must be a whole number from 1 to 1000000, got -1"
    ),
]

# -- settings and policies ---------------------------------------------------------------------------------------------

SETTINGS = [
    Refusal(
        lambda _: NetworkPolicy(PLAIN, plain_layers()).predict(np.zeros(9)),
        ValueError,
        "observation must have shape (n, 10) or (10,), got (9,)",
    ),
    Refusal(
        lambda _: EnvSettings(fidelity="exact", contact="pymunk"),
        ValueError,
        "fidelity='exact' stands for contact='exact', got contact='pymunk' beside it: leave one of them out",
    ),
    Refusal(
        lambda _: EnvSettings(fidelity="fine", contact="exact"),
        ValueError,
        "fidelity='fine' stands for contact='pymunk', got contact='exact' beside it: leave one of them out",
    ),
    Refusal(
        lambda _: EnvSettings(fidelity="coarse", substeps=8),
        ValueError,
        "fidelity='coarse' stands for substeps=2, got substeps=8 beside it: leave one of them out",
    ),
    Refusal(
        lambda _: EnvSettings(fidelity="exact", substeps=4),
        ValueError,
        "fidelity='exact' stands for substeps=None, got substeps=4 beside it: leave one of them out",
    ),
    Refusal(lambda _: TrainSettings(scene="[1]"), ValueError, "scene must be a JSON object, got '[1]'"),
    Refusal(lambda _: TrainSettings(scene="{"), ValueError, "scene must be a JSON object, got '{'"),
    Refusal(lambda _: EnvSettings(randomize="[1]"), ValueError, "randomize must be a JSON object, got '[1]'"),
    Refusal(
        lambda _: EnvSettings(randomize='{"mass": [1, 2]}'),
        ValueError,
        "randomize accepts only 'box_half_width', 'box_mass', 'box_inertia', 'jack_arm', 'jack_mass', "
        "'jack_inertia', 'gravity', 'restitution', 'torque_limit', got 'mass' (did you mean 'box_mass'?)",
    ),
    Refusal(
        lambda _: find_policy("pid", EnvSettings(), 0),
        FileNotFoundError,
        "a policy must be one of random, chirp, zero, level, planner-fast, planner, distilled, ppo, "
        "or a run folder, a model file or file.py:function, got 'pid'",
    ),
    Refusal(
        lambda _: find_policy("value", EnvSettings(), 0),
        FileNotFoundError,
        "a policy must be one of random, chirp, zero, level, planner-fast, planner, distilled, ppo, "
        "or a run folder, a model file or file.py:function, got 'value'",
    ),
    Refusal(lambda _: Planner(Scene(), samples=1), ValueError, "samples must be a whole number >= 2, got 1"),
    Refusal(lambda _: Planner(Scene(), elites=300), ValueError, "elites must be a whole number from 1 to 256, got 300"),
    Refusal(lambda _: Planner(Scene(), knots=1), ValueError, "knots must be a whole number >= 2, got 1"),
    Refusal(lambda _: Planner(Scene(), repeat=0), ValueError, "repeat must be a whole number >= 1, got 0"),
    Refusal(lambda _: Planner(Scene(), num_threads=0), ValueError, "num_threads must be a whole number >= 1, got 0"),
    Refusal(
        lambda _: Planner(Scene(), control_dt=0.0), ValueError, "control_dt must be a finite number above 0, got 0.0"
    ),
    Refusal(lambda _: Planner(Scene(), value="good"), TypeError, "value must be a Value or None, got 'good'"),  # type: ignore[arg-type]
    Refusal(lambda _: Value(HERE, []), ValueError, "the layers must have shapes [((1, 21), (1,))], got []"),
    Refusal(
        lambda _: Value(HERE, layers_for()[:1]),
        ValueError,
        "the layers must have shapes [((1, 21), (1,))], got [((16, 21), (16,))]",
    ),
    Refusal(
        lambda _: Value(HERE, layers_for()[1:]),
        ValueError,
        "the layers must have shapes [((1, 21), (1,))], got [((1, 16), (1,))]",
    ),
    Refusal(
        lambda _: Value(HERE, [(weight * np.nan, bias) for weight, bias in layers_for()]),
        ValueError,
        "weights must be finite",
    ),
    Refusal(
        lambda _: Value(HERE, [(weight, bias * np.nan) for weight, bias in layers_for()]),
        ValueError,
        "weights must be finite",
    ),
    Refusal(
        lambda _: NetworkPolicy(PLAIN, layers_for()),
        ValueError,
        "the layers must have shapes [((16, 10), (16,)), ((1, 16), (1,))], got [((16, 21), (16,)), ((1, 16), (1,))]",
    ),
    Refusal(
        lambda _: NetworkPolicy(PLAIN, [(weight * np.nan, bias) for weight, bias in plain_layers()]),
        ValueError,
        "weights must be finite",
    ),
    Refusal(
        lambda _: check_film(Path("film.avi")),
        ValueError,
        "a film must be a .gif or .mp4 file, got 'film.avi'",
        files({}),
    ),
    Refusal(
        lambda _: check_film(Path("nowhere/film.gif")),
        FileNotFoundError,
        "[Errno 2] No such file or directory: 'nowhere'",
        files({}),
    ),
    Refusal(
        lambda _: check_film(Path("there.gif")),
        FileExistsError,
        "there.gif exists, and is never overwritten: choose another place",
        files({"there.gif": ""}),
    ),
]

# -- models and runs ---------------------------------------------------------------------------------------------------

EARLIER = {name: value for name, value in asdict(TrainSettings()).items() if not name.startswith("action")}
RUNS = [
    Refusal(
        lambda _: load_model(Path("run")),
        FileNotFoundError,
        "there is no model file run/model.zip",
        files({"run/a": ""}),
    ),
    Refusal(
        lambda _: policy_of_run(Path("a/model.zip"), trust=False),
        FileNotFoundError,
        "a has no settings.json",
        files({"a/model.zip": "a"}),
    ),
    Refusal(
        lambda _: load_model(Path("a/model.zip")),
        FileNotFoundError,
        "a/model.zip needs an env.json beside it that describes its environment: load it with its environments, as "
        "PPO.load(path, env=envs), and save it by jackbox_env.sb3.save_model",
        files({"a/model.zip": "a", "a/settings.json": json.dumps(asdict(PLAIN))}),
    ),
    Refusal(
        lambda _: policy_of_run(Path("model.zip"), trust=False),
        ValueError,
        "model.zip is no model of its settings: ValueError: the layers must have shapes ...",
        Subject(
            folder,
            lambda path: fill(
                path,
                {"model.zip": plain_model(), "settings.json": json.dumps(asdict(replace(PLAIN, hidden_units=(8, 8))))},
            ),
            contents,
        ),
    ),
    Refusal(
        lambda _: policy_of_run(Path("model.zip"), trust=False),
        ValueError,
        "model.zip is no model of its settings: DamagedFileError: model.zip is damaged: ...",
        files({"model.zip": "nonsense", "settings.json": json.dumps(asdict(PLAIN))}),
    ),
    Refusal(
        lambda _: read_settings(Path("run")),
        ValueError,
        "run/settings.json has no settings of a run: settings of another version, without action, "
        "action_repeat, cannot be used: train again",
        files({"run/settings.json": json.dumps({**EARLIER, "landing": True, "repeat": "bounce"})}),
    ),
    Refusal(
        lambda _: new_sweep(Path("sweep"), [{"number": 0}]),
        FileExistsError,
        "sweep exists, and is never overwritten: choose another place",
        files({"sweep/a": ""}),
    ),
    Refusal(
        lambda _: new_sweep(Path("sweep"), []),
        ValueError,
        "a sweep must have at least one trial, and each once, got 0 times any",
        files({}),
    ),
    Refusal(
        lambda _: new_sweep(Path("sweep"), [{"number": 0}, {"number": 1}, {"number": 0}]),
        ValueError,
        'a sweep must have at least one trial, and each once, got 2 times {"number": 0}',
        files({}),
    ),
    Refusal(
        lambda _: read_sweep(Path("sweep")),
        DamagedFileError,
        "sweep/sweep.json is damaged: ...",
        files({"sweep/sweep.json": "{"}),
    ),
    *(
        Refusal(
            lambda _: read_json(Path("a.json")), DamagedFileError, "a.json is damaged: ...", files({"a.json": content})
        )
        for content in (b"", b"\xff\xfe\x00", b"[" * 100_000)
    ),
]


@rows([*NETWORKS, *SETTINGS, *RUNS])
def test_agents_refuse_in_one_sentence_and_write_nothing(row: Refusal) -> None:
    assert_refused(row)
