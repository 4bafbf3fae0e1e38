"""Evaluate policies on JackInBox-v0: baselines, the planner and shipped networks by name, others by run folder."""

from __future__ import annotations

import json
import sys
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from agents.settings import PER_POLICY, EnvSettings, SceneFields, scene_as_json
from jackbox_env.tools import checks as check
from jackbox_env.tools.command_line import command_line, progress
from jackbox_env.tools.files import check_new, check_new_file, new_file, new_folder, write_json
from jackbox_env.tools.user_code import is_object, load, with_objects

with suppress(ImportError):  # main names what is missing
    import tyro

if TYPE_CHECKING:
    from agents.policies.scripted import PolicyWithEnv


@dataclass(frozen=True)
class Arguments:
    """Evaluate policies on JackInBox-v0."""

    settings: EnvSettings
    scene_fields: SceneFields
    policy: tuple[str, ...] = ("random", "chirp", "zero", "level")
    (
        "random: uniform torques; chirp: the scene's drive; zero: no torque; level: a PD controller that keeps the "
        "box level; planner: simulates many torque sequences by the exact model, about 10 ms for each decision of 0.1 "
        "s; planner-fast: fewer, about 1 ms; ppo: the network of the task in agents/trained; distilled: trained on "
        "exact rollouts, needs none at run time; or run folders, exported policies, model files, or file.py:function, "
        "which returns actions for observations. All play the same episodes: of the options here, or as env.json "
        "beside a model file describes."
    )
    episodes: int = 128
    """Episodes of each policy."""
    seed: int = 0
    """Seed of the starts, which are not those of reset(seed=...), and of all else that is drawn."""
    json: Path | None = None
    """Also write the results, every return included, to this new file."""
    html: bool = False
    """Also write an animated page of each policy's first start."""
    folder: Path | None = None
    """New folder for the pages; None: runs/evaluate-<date>-<time>."""
    film: Path | None = None
    """Also film an episode of all policies side by side, in this new .mp4 or .gif file."""
    trust: bool = False
    (
        "Unpickle models that have no settings.json beside them, and run the code that settings.json or env.json "
        "names: only of people you trust. Such models play in the environment that env.json beside them describes, "
        "which jackbox_env.sb3.save_model writes; --env and options that are not the default go before it. Beside "
        "other policies it must be theirs, but for observation, action, action_repeat and torque."
    )
    env: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    (
        "A keyword of the environment, once for each: --env episode_steps=400 --env task=file.py:name. All policies "
        "play with it, but observation, action, action_repeat and torque are of model files and functions alone."
    )


def _check(arguments: Arguments) -> None:
    """Raise now what would fail after minutes of computing."""
    check.whole("episodes", arguments.episodes, at_least=1)
    check.whole("seed", arguments.seed, at_least=0, at_most=2**32 - 1)
    if not arguments.policy:
        raise ValueError("policy must name at least one policy, got none")
    if arguments.json is not None:
        check_new_file(arguments.json)
    if arguments.folder is not None:
        if not arguments.html:
            raise ValueError("folder goes with --html, whose pages are written into it")
        check_new(arguments.folder)
    if arguments.film is not None:
        from jackbox_env.recording.film import check_film

        check_film(arguments.film)


@command_line
def main() -> None:
    """Parse, evaluate, print the table."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__, config=(tyro.conf.OmitArgPrefixes,))
    settings = replace(arguments.settings, scene=scene_as_json(arguments.settings.scene, arguments.scene_fields))
    _check(arguments)
    load(settings.objects.values())
    progress("Loading PyTorch and Stable-Baselines3 ...")
    from agents.evaluation.provenance import describe_env, note_other_environment, shared_environment
    from agents.evaluation.returns import evaluate, table
    from agents.policies.models import keywords_of
    from agents.runs import versions
    from agents.training.models import derived_seed

    chosen = keywords_of(arguments.env)
    acts = _policies(arguments, settings, chosen)
    of_all = {name: value for name, value in chosen.items() if name not in PER_POLICY}
    env = shared_environment(acts, with_objects({**settings.env_settings, **of_all}))
    names = {name: value for name, value in {**settings.objects, **of_all}.items() if is_object(value)}
    if "torch" in sys.modules:  # small networks are fastest on one thread
        sys.modules["torch"].set_num_threads(1)
    print(f"{arguments.episodes} episodes each, seed {arguments.seed}, {describe_env(env, names)}")
    rows = []
    for name, acting in acts.items():
        note_other_environment(name, acting, env)
        rows.append(evaluate(name, acting, env, arguments.episodes, arguments.seed, progress=True))
    print(table(rows))
    if arguments.film is not None:
        from agents.evaluation.film import film_episode

        start = derived_seed("evaluation", arguments.seed)
        film_episode(acts, env, arguments.film, start)
    if arguments.json is not None:
        results = [{**row.as_json(), "keywords": acts[row.policy].named} for row in rows]
        record = {"env": {**env, **names}, "seed": arguments.seed, "versions": versions(), "results": results}
        with new_file(arguments.json) as partial:
            write_json(partial, json.loads(json.dumps(record, default=repr)))
    if arguments.html:
        _write_pages(arguments.folder, acts, env, arguments.seed)


def _policies(arguments: Arguments, settings: EnvSettings, chosen: dict[str, Any]) -> dict[str, PolicyWithEnv]:
    """The policies by the names of their rows, which show if a policy does not choose the torque."""
    from agents.policies.registry import POLICIES, find_policy, is_function, with_chosen_env

    load(filter(is_function, arguments.policy))
    for_models = [f"--env {name}" for name in PER_POLICY if name in chosen]
    if for_models and not any(map(with_chosen_env, arguments.policy)):
        raise ValueError(f"{for_models[0]} is for model files and functions, got {', '.join(arguments.policy)}")
    acts = {name: find_policy(name, settings, arguments.seed, arguments.trust, chosen) for name in arguments.policy}
    driven = {name for name, acting in acts.items() if acting.keywords.get("torque") == "chirp"}.difference(POLICIES)
    return {f"{name} (torque chirp)" if name in driven else name: acting for name, acting in acts.items()}


def _write_pages(path: Path | None, acts: dict[str, PolicyWithEnv], env: dict[str, Any], seed: int) -> None:
    """Write an animated page of each policy into a new folder, and print the paths."""
    from agents.evaluation.episodes import write_pages

    earned = dict[str, float]()
    folder = new_folder(path, "evaluate", lambda made: earned.update(write_pages(made, acts, env, seed)))
    print("One episode of each, as a page that any browser opens:")
    for page, one in earned.items():
        print(f"  {folder / page}: return {one:.1f}")


if __name__ == "__main__":
    main()
