"""The commands of a checkout refuse options in one sentence, with status 2, and make no folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from agents.evaluation import returns
from agents.policies.network import SHIPPED
from agents.training import ppo as training
from scripts import evaluate, sweep, train
from tests.agents.small_run import TINY
from tests.refusals.sentences import Refusal, assert_refused, command, files, refused, rows

BAD = {
    "bad.py": "import gymnasium, numpy as np\nfrom jackbox_env import Action, Task\nnumber = 3\n"
    "line = gymnasium.spaces.Box(-np.inf, np.inf, (1,))\n"
    "endless = Action(line, lambda scene, state, action, time, dt: action[0])\n"
    "fine = Task(('a',), lambda scene, state, torque, impulse: 0.0)\n"
    "shape = Task(('a',), lambda scene, state, torque, impulse: 0.0, start=lambda scene, rng: np.zeros(3))\n"
}
EXPORTED = files({f"copy/{path.name}": path.read_bytes() for path in (SHIPPED / "juggle-ppo").iterdir()})


def evaluates(*words: str) -> Callable[[Any], None]:
    def call(one: Any) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(returns, "evaluate", None)  # it is not reached
            command(evaluate.main, *words)(one)

    return call


def trains(*words: str) -> Callable[[Any], None]:
    return command(train.main, *words)


def sweeps(words: str) -> Callable[[Any], None]:
    return command(sweep.main, *words.split())


COMMANDS = [
    refused(evaluates("--policy"), "policy must name at least one policy, got none"),
    refused(evaluates("--html", "--folder", "/dev/null/pages"), "/dev/null cannot be used: Not a directory"),
    refused(
        evaluates("--html", "--folder", "pages"),
        "pages exists, and is never overwritten: choose another place",
        {"pages/a": ""},
    ),
    refused(evaluates("--folder", "pages"), "folder goes with --html, whose pages are written into it"),
    refused(evaluates("--film", "/proc/film.GIF"), "/proc cannot be used: No such file or directory"),
    refused(evaluates("--json", "/proc/out.json"), "/proc cannot be used: No such file or directory"),
    refused(evaluates("--json", "no/out.json"), "no cannot be used: No such file or directory"),
    refused(
        evaluates("--json", "out.json"),
        "out.json exists, and is never overwritten: choose another place",
        {"out.json": ""},
    ),
    refused(
        evaluates("--policy", str(SHIPPED / "juggle-ppo" / "weights.npz")),
        f"{SHIPPED}/juggle-ppo/weights.npz has only weights: pass its folder, {SHIPPED}/juggle-ppo",
    ),
    refused(evaluates("--policy", "/dev/null"), "there is no model file /dev/null"),
    refused(
        evaluates("--policy", "level", "--env", "action_repeat=4"),
        "--env action_repeat is for model files and functions, got level",
    ),
    refused(
        evaluates("--policy", "level", "--env", "max_episode_steps=501"),
        "max_episode_steps (shortens an episode of episode_steps=500) must be a whole number from 1 to 500, got 501",
    ),
    refused(
        evaluates("--policy", "level", "--env", "episode_steps=null"),
        "episodes must have one number of control steps, got at most inf in at most inf decisions: use --env "
        "episode_steps=500",
    ),
    refused(
        evaluates("--policy", "level", "--env", "repeat=4"),
        "--env accepts only 'contact', 'substeps', 'scene', 'task', 'control_dt', 'torque', "
        "'fidelity', 'randomize', 'observation', 'action', 'action_repeat', 'episode_steps', "
        "'max_episode_steps', got 'repeat' (did you mean 'action_repeat'?)",
    ),
    refused(evaluates("--policy", "level", "--env", "landing"), "--env must be name=value, got 'landing'"),
    refused(
        evaluates("--policy", "level", "--env", "task=nowhere.py:mine"),
        "nowhere.py:mine cannot be imported: FileNotFoundError: [Errno 2] No such file or directory: 'nowhere.py'",
    ),
    refused(
        evaluates("--jack-mass", "5", "--scene", '{"jack_mass": 4}'),
        "jack_mass must be chosen once, got 4 in --scene and 5 beside it",
    ),
    refused(
        evaluates("--policy", "bad.py:number"), "a policy must be a function of observations, got bad.py:number, 3", BAD
    ),
    refused(
        trains("--action", "bad.py:endless", "--folder", "new"),
        "PPO needs an action within finite bounds, got Box(-inf, inf, (1,), float32)",
        BAD,
    ),
    refused(
        trains("--task", "bad.py", "--folder", "new"),
        "task must be one of 'juggle', 'spin', 'rattle', 'file.py:name', got 'bad.py'",
        BAD,
    ),
    refused(
        trains("--task", "bad.py:shape", "--folder", "new"),
        "the task's start has drawn what is none: state must have shape (12,), got shape (3,)",
        BAD,
    ),
    refused(
        trains("--resume", "x", "--gravity", "2"),
        "--resume uses the settings of its run folder: only --total-steps may be added",
    ),
    Refusal(trains("--resume", "copy"), SystemExit, "copy is no training run: it has no run.json", EXPORTED),
    Refusal(
        lambda _: training.train(TINY, Path("copy"), progress=False),
        FileExistsError,
        "copy is an exported policy, which cannot be trained further: choose another folder",
        EXPORTED,
    ),
    refused(
        sweeps("--task bad:fine --policy level --folder new"),
        "a sweep stores the text of code, so its objects must be file.py:name, got bad:fine",
        BAD,
    ),
    refused(
        sweeps("--policy nobody"),
        "a policy must be one of random, chirp, zero, level, planner-fast, planner, distilled, ppo, "
        "or a run folder, a model file or file.py:function, got 'nobody'",
    ),
    refused(sweeps("--setting fast"), "setting must be a JSON object, got 'fast'"),
    refused(
        sweeps("""--scene {"gravity":-1}"""), "gravity must be a finite number at least 0 and at most 1e+60, got -1"
    ),
    refused(sweeps("--episodes 1"), "episodes must be a whole number >= 2, got 1"),
    refused(
        sweeps("--setting exact exact"),
        'a sweep must have at least one trial, and each once, got 2 times {"contact": null, '
        '"control_dt": 0.02, "episodes": 16, "fidelity": "exact", "policy": "level", "randomize": '
        '"{}", "scene": "{}", "seed": 0, "substeps": null, "task": "juggle"}',
    ),
    refused(sweeps("--workers 0"), "workers must be a whole number from 1 to 100, got 0"),
    refused(
        sweeps("--workers 2 --address auto"), "workers must be None with an address: the cluster has its own, got 2"
    ),
    refused(sweeps("""--train {"epochs":4}"""), "train must have a list of values for each setting, got 4 for epochs"),
    refused(sweeps("""--train {"epochs":[0]}"""), "epochs must be a whole number >= 1, got 0"),
    refused(
        sweeps("""--train {"action_repeat":[4]}"""),
        "train accepts only 'total_steps', 'num_envs', 'rollout_steps', 'batch_size', "
        "'epochs', 'learning_rate', 'gamma', 'gae_lambda', 'clip_range', 'entropy_coefficient', "
        "'hidden_units', 'initial_log_std', 'checkpoint_steps', 'eval_steps', 'eval_episodes', got "
        "'action_repeat'",
    ),
    refused(
        sweeps("""--train {} --setting {"action_repeat":0}"""),
        "action_repeat must be a whole number from 1 to 1000000, got 0",
    ),
    refused(
        sweeps("""--setting {"observation":"landing"}"""),
        "setting must have no observation for level: the policy has its own",
    ),
    refused(
        sweeps("""--setting {"observation":"sea"}"""),
        "observation must be one of 'state', 'landing', 'pixels', got 'sea'",
    ),
    refused(sweeps("""--train {} --policy zero"""), "--train runs trainings in place of policies: leave out --policy"),
    refused(sweeps("--resume nowhere"), "nowhere/sweep.json cannot be used: No such file or directory"),
    refused(
        sweeps("--resume nowhere --seeds 3"), "--resume continues the sweep of its folder: leave out other settings"
    ),
]


@rows(COMMANDS)
def test_a_script_refuses_in_one_sentence_and_writes_nothing(row: Refusal) -> None:
    assert_refused(row)
