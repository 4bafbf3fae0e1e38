"""Evaluate policies on JackInBox-v0: baselines, the planner and shipped networks by name, others by run folder."""

from __future__ import annotations

import sys
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated

from agents.settings import EnvSettings
from jackbox_env.commands.common import command_line, tyro


@dataclass(frozen=True)
class Arguments:
    """Evaluate policies on JackInBox-v0."""

    settings: Annotated[EnvSettings, tyro.conf.arg(name="")]
    policy: tuple[str, ...] = ("random", "chirp", "zero", "level")
    """random: uniform torques; chirp: the scene's drive; zero: no torque; level: a PD law that holds the box level;
    planner: plays many torques ahead by the exact model, 1 to 2 s of computing for each episode; ppo: the network of
    the task in agents/trained; distilled, on juggle: judges by a network there what one bounce leads to; or run
    folders, exported policies or model files. All act in the environment given here, whatever they were trained in."""
    episodes: int = 128
    """Episodes of each policy."""
    seed: int = 0
    """Decides the starts."""
    json: Path | None = None
    """Also write the results, every return included, to this new file."""
    html: Path | None = None
    """Also write an animated page of each policy's first start to this new folder."""
    film: Path | None = None
    """Also film an episode of all policies side by side, in this new .mp4 or .gif file."""
    trust: bool = False
    """Unpickle models that have no settings.json beside them: only those of people you trust."""


def describe_env(settings: EnvSettings) -> str:
    """The environment in one line: task, contact model, and what differs from the default."""
    contact, substeps = settings.setting
    told = [f"task {settings.task}", f"contact {contact}", *([f"substeps {substeps}"] * bool(substeps))]
    others = [part.name for part in fields(EnvSettings) if part.name not in ("task", "contact", "substeps", "fidelity")]
    differing = [name for name in others if getattr(settings, name) != getattr(EnvSettings, name)]
    return ", ".join([*told, *(f"{name} {getattr(settings, name)}" for name in differing)])


def warn_of_other_training(name: str, here: EnvSettings) -> None:
    """Note which runs were trained in another environment."""
    if (Path(name) / "settings.json").is_file():
        from agents.runs import read_settings

        trained = EnvSettings(
            **{part.name: getattr(read_settings(Path(name)), part.name) for part in fields(EnvSettings)}
        )
        same = replace(trained, contact=here.contact, substeps=here.substeps, fidelity=here.fidelity) == here
        if trained.setting != here.setting or not same:  # one setting can be written in several ways
            print(f"Note: {name} was trained in another environment ({describe_env(trained)})", file=sys.stderr)


@command_line
def main() -> None:
    """Parse, evaluate, print the table."""
    arguments = tyro.cli(Arguments, description=__doc__)
    from agents.episodes import write_pages
    from agents.evaluation import evaluate, find_policy, table
    from agents.runs import versions
    from jackbox_env import _validation as check
    from jackbox_env.storage import check_writable, new_folder, write_json

    check.whole("episodes", arguments.episodes, at_least=1)
    check.whole("seed", arguments.seed, at_least=0, at_most=2**32 - 1)
    if arguments.json is not None:
        check_writable(arguments.json.parent)
    if arguments.json is not None and arguments.json.exists():
        raise FileExistsError(f"{arguments.json} exists, and results are never overwritten: choose another file")
    if arguments.html is not None and arguments.html.exists():
        raise FileExistsError(f"{arguments.html} exists, and pages are never overwritten: choose another folder")
    if arguments.film is not None:
        from agents.film import check_film, film_episode
        from agents.models import derived_seed

        check_film(arguments.film)
    env_settings = arguments.settings.env_settings
    found = [
        (name, find_policy(name, arguments.settings, arguments.seed, arguments.trust)) for name in arguments.policy
    ]
    print(f"{arguments.episodes} episodes each, seed {arguments.seed}, {describe_env(arguments.settings)}")
    rows = []
    for name, (policy, more) in found:
        warn_of_other_training(name, arguments.settings)
        act_in = {**env_settings, **more}
        rows.append(evaluate(name, policy, act_in, arguments.episodes, arguments.seed, progress=True))
    print(table(rows))
    if arguments.film is not None:
        film_episode(dict(found), env_settings, arguments.film, derived_seed("evaluation", arguments.seed))
    if arguments.json is not None:
        record = {"env": env_settings, "seed": arguments.seed, "versions": versions()}
        write_json(arguments.json, {**record, "results": [row.as_json() for row in rows]})
    if arguments.html is not None:
        print("One episode of each, as a page that any browser opens:")
        pages = write_pages(new_folder(arguments.html, "evaluate"), dict(found), arguments.settings, arguments.seed)
        for page, earned in pages.items():
            print(f"  {page}: return {earned:.1f}")


if __name__ == "__main__":
    main()
