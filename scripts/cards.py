"""Write the model cards of agents/trained, in the hub's layout, from the networks' settings and docs/results.json."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from agents.policies.network import SHIPPED
from jackbox_env.command_line import ROOT, command_line
from jackbox_env.files import write_text

INPUTS = "From the observation, and eleven numbers about the jack's next landing that follow from it,"
ORIGINS = {  # what a network is, and how it was trained
    "ppo": f"""A network with two layers of {{hidden_units[0]}} neurons. {INPUTS} it chooses {{chosen}}, {{lasting}}.
PPO trained it for {{total_steps:,}} decisions in {{num_envs}} environments: discount {{gamma}}{{per}}, learning rate {{learning_rate}}, seed {{seed}}; settings.json has the rest. That took {{seconds:.0f}} s. Five such trainings, this one and four of other seeds, earn {{lowest:.1f}} to {{highest:.1f}}. `make networks` trains it again.""",  # noqa: E501
    "distilled": f"""A network with two layers of {{hidden_units[0]}} neurons. {INPUTS} it chooses a torque, for {{repeat}} control steps of {{control_dt}} s each time.
`scripts/studies/vine.py` tries torques from the same states, plays on by exact rollouts, and makes the better ones more likely by PPO's clipped loss.""",  # noqa: E501
    "juggle-distilled": """A network that evaluates a bounce. The policy predicts one bounce in closed form for many angles and rates of the box, and turns the box to the best.
`scripts/studies/distil.py` starts from the planner's value and improves it on states that the policy itself visits.""",  # noqa: E501
    "value": """A network that evaluates the last state of a plan. `planner` adds it to the plan's rewards, and the returns below are the planner's. `scripts/studies/value.py` fits it to what a longer search earns.""",  # noqa: E501
}
METRIC = """  - task: {{type: reinforcement-learning, name: reinforcement-learning}}
    dataset: {{type: JackInBox-v0, name: "JackInBox-v0, {task}, {contact}"}}
    metrics: [{{type: mean_reward, value: {mean:.1f}, name: "mean return of {episodes} episodes, 95 % +- {half:.1f}"}}]
"""
CARD = """---
library_name: jackbox
license: mit
tags: [reinforcement-learning, gymnasium, JackInBox-v0, {task}]
model-index:
- name: {folder}
  results:
{metrics}---

# {folder}

{made}

weights.npz has the layers, with tanh between them. In a checkout: `jackbox evaluate --task {task} --policy {policy}`.

## Returns

| contact model | mean return, 95 % interval | episodes |
|---|---:|---:|
{rows}
The starts are those of JackInBox-v0; no training uses them.

## Limits

It was made for the default scene and the exact contact model. In other scenes it may earn far less: docs/results.md.
"""


def card(folder: Path, record: dict[str, Any]) -> str:
    """The card of a shipped network; ``record`` is docs/results.json."""
    task, name = folder.name.split("-")
    facts: dict[str, Any] = {"task": task, "folder": folder.name, "policy": "planner" if name == "value" else name}
    facts |= {key: fact for path in folder.glob("*.json") for key, fact in json.loads(path.read_text()).items()}
    means = [one["mean"] for one in record["learning"] if one["task"] == task]
    facts |= {"lowest": min(means), "highest": max(means), "metrics": "", "rows": ""}
    facts["chosen"] = "the box's angle and rate at the landing" if facts.get("landing") else "a torque"
    by_bounce = facts.get("repeat") == "bounce"
    steps = f"{facts.get('repeat')} control steps of {facts['control_dt']} s"
    facts |= {"lasting": "once a bounce" if by_bounce else f"for {steps} each time", "per": " per second" * by_bounce}
    for row in (row for row in record["rows"] if (row["task"], row["policy"]) == (task, facts["policy"])):
        half = (row["interval_95"][1] - row["interval_95"][0]) / 2.0
        facts["metrics"] += METRIC.format(**row, half=half)
        facts["rows"] += "| {contact} | {mean:.1f} ± {half:.1f} | {episodes} |\n".format(**row, half=half)
    return CARD.format(**facts, made=(ORIGINS.get(folder.name) or ORIGINS[name]).format(**facts))


@command_line
def main() -> None:
    """Write all cards."""
    import tyro

    tyro.cli(lambda: None, description=__doc__)
    record = json.loads((ROOT / "docs" / "results.json").read_text())
    for folder in sorted(path for path in SHIPPED.iterdir() if path.is_dir()):
        write_text(folder / "README.md", card(folder, record))


if __name__ == "__main__":
    main()
