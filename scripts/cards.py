"""Write the model cards of agents/trained, in the hub's layout: card.md filled from docs/benchmark.json.

`scripts/dataset.py` writes the datasets' card.
"""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import tyro

from agents.policies.network import SHIPPED, WEIGHTS
from jackbox_env import __version__
from jackbox_env.tools.command_line import ROOT, command_line
from jackbox_env.tools.files import write_text

MADE = {  # what a network is, and how it was trained
    "ppo": "A network that chooses the actions, trained by PPO. `make networks`",
    "distilled": "A network that chooses torques. It tried torques from the same states, played on by exact rollouts, and made the better ones more likely by PPO's clipped loss. `python -m agents.training.vine`",  # noqa: E501
    "juggle-distilled": "A network that evaluates a bounce. The policy predicts one bounce in closed form for many angles and rates of the box, and turns the box to the best. `python -m agents.training.distil`",  # noqa: E501
    "value": "A network that evaluates the last state of a plan. `planner` adds it to the plan's rewards, and the returns below are the planner's. `python -m agents.training.value`",  # noqa: E501
}
METRIC = """  - task: {{type: reinforcement-learning, name: reinforcement-learning}}
    dataset: {{type: JackInBox-v0, name: "JackInBox-v0, {task}, {contact}"}}
    metrics: [{{type: mean_reward, value: {mean:.1f}, name: "mean return of {episodes} episodes, 95 % +- {half:.1f}"}}]
"""
ROW = "| {contact} | {mean:.1f} ± {half:.1f} | {episodes} |\n"


def card(folder: Path, record: dict[str, Any], commit: str) -> str:
    """The card of a shipped network; ``record`` is docs/benchmark.json, ``commit`` that of the weights."""
    task, name = folder.name.split("-")
    policy = "planner" if name == "value" else name
    rows = [
        {**row, "half": (row["interval_95"][1] - row["interval_95"][0]) / 2.0}
        for row in record["policies"]
        if (row["task"], row["policy"], row["setting"]) == (task, policy, "default")
    ]
    return Path(__file__).with_name("card.md").read_text().format(
        task=task, folder=folder.name, policy=policy, version=__version__, commit=commit,
        path=policy if name == "value" else folder.relative_to(ROOT).as_posix(),
        made=MADE.get(folder.name, MADE[name]),
        metrics="".join(METRIC.format(**row) for row in rows),
        rows="".join(ROW.format(**row) for row in rows),
    )  # fmt: skip


def main() -> None:
    """Write all model cards; each names the last commit that changed its weights."""
    record = json.loads((ROOT / "docs" / "benchmark.json").read_text())
    for weights in sorted(SHIPPED.glob(f"*/{WEIGHTS}")):
        commit = subprocess.run(
            ["git", "-C", str(ROOT), "log", "-1", "--format=%H", "--", str(weights)],
            capture_output=True, text=True, check=True,
        ).stdout.strip()  # fmt: skip
        write_text(weights.with_name("README.md"), card(weights.parent, record, commit))


if __name__ == "__main__":
    command_line(lambda: tyro.cli(main, description=__doc__))()
