"""Evaluate policies on JackInBox-v0: baselines by name, trained models by run folder or file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from agents.settings import EnvSettings
from scripts.common import command_line


@dataclass(frozen=True)
class Arguments:
    """Evaluate policies on JackInBox-v0."""

    settings: Annotated[EnvSettings, tyro.conf.arg(name="")]
    policy: tuple[str, ...] = ("random", "chirp", "zero", "level")
    """random, chirp, zero, level, or run folders or model files."""
    episodes: int = 128
    """Episodes of each policy."""
    seed: int = 0
    """Decides the starts."""
    json: Path | None = None
    """Also write the results, every return included, to this new file."""
    trust: bool = False
    """Unpickle models that have no settings.json beside them: only those of people you trust."""


@command_line
def main() -> None:
    """Parse, evaluate, print the table."""
    arguments = tyro.cli(Arguments, description=__doc__)
    from agents.evaluation import evaluate, find_policy, table
    from agents.runs import versions, write_json
    from jackbox_env import Scene
    from jackbox_env import _validation as check

    check.whole("episodes", arguments.episodes, at_least=1)
    check.whole("seed", arguments.seed, at_least=0, at_most=2**32 - 1)
    if arguments.json is not None and arguments.json.exists():
        raise FileExistsError(f"{arguments.json} exists, and results are never overwritten: choose another file")
    env_settings = arguments.settings.env_settings
    scene = Scene.of(env_settings["scene"])
    found = [(name, find_policy(name, scene, arguments.seed, arguments.trust)) for name in arguments.policy]
    rows = []
    for name, (policy, more) in found:
        rows.append(evaluate(name, policy, {**env_settings, **more}, arguments.episodes, arguments.seed))
    print(table(rows))
    if arguments.json is not None:
        record = {"env": env_settings, "seed": arguments.seed, "versions": versions()}
        write_json(arguments.json, {**record, "results": [row.as_json() for row in rows]})


if __name__ == "__main__":
    main()
