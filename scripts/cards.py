"""Write the model cards of agents/trained, in the hub's layout, from the networks' settings and docs/results.json.

`scripts/dataset.py` writes the datasets' card.
"""

from __future__ import annotations

import json
import math
import subprocess
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from agents.policies.network import SHIPPED, WEIGHTS
from jackbox_env import __version__
from jackbox_env.tools.command_line import ROOT, command_line
from jackbox_env.tools.files import write_text

INPUTS = {  # by the observation
    "state": 'From the observation `"state"`, ten numbers,',
    "landing": 'From the observation `"landing"`, ten numbers of the state and eleven of the next landing,',
}
ORIGINS = {  # what a network is, and how it was trained
    "ppo": """A network with two layers of {hidden_units[0]} neurons. {inputs} it chooses {chosen}, {lasting}.
PPO trained it for {total_steps:,} decisions in {num_envs} environments: discount {gamma}{per}, learning rate {learning_rate}, seed {seed}; settings.json has the rest. That took {spent:.0f} s of one core. Five such trainings, this one and four of other seeds, earn {lowest:.1f} to {highest:.1f}. `make networks` trains it again.""",  # noqa: E501
    "distilled": """A network with two layers of {hidden_units[0]} neurons. {inputs} it chooses a torque, for {action_repeat} control steps of {control_dt} s each time.
`agents/training/vine.py` tries torques from the same states, plays on by exact rollouts, and makes the better ones more likely by PPO's clipped loss.""",  # noqa: E501
    "juggle-distilled": """A network that evaluates a bounce. The policy predicts one bounce in closed form for many angles and rates of the box, and turns the box to the best.
`agents/training/distil.py` starts from the planner's value and improves it on states that the policy itself visits.""",  # noqa: E501
    "value": """A network that evaluates the last state of a plan. `planner` adds it to the plan's rewards, and the returns below are the planner's. `agents/training/value.py` fits it to what a longer search earns.""",  # noqa: E501
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

weights.npz has the layers, with tanh between them. They are of jackbox {version}, commit {commit}.

## Use

In a checkout of jackbox, this plays an episode:

```python
import gymnasium as gym

import jackbox_env  # registers JackInBox-v0
from agents.policies.registry import find_policy
from agents.settings import EnvSettings

policy, keywords = find_policy("{path}", EnvSettings(task="{task}"))
env = gym.make("JackInBox-v0", task="{task}", fidelity="exact", **keywords)
observation, info = env.reset(seed=0)
memory, done, total = None, False, 0.0
while not done:
    start = [info["time"] == 0.0]  # of an episode
    action, memory = policy.predict(observation, memory, start, deterministic=True)
    observation, reward, terminated, truncated, info = env.step(action)
    total, done = total + reward, terminated or truncated
print(total)
```

`jackbox evaluate --task {task} --policy {policy}` plays many, and compares.

## Returns

| contact model | mean return, 95 % interval | episodes |
|---|---:|---:|
{rows}
The starts are those of JackInBox-v0; no training uses them.

## Limits

It was trained for the default scene and the exact contact model. In other scenes it may earn far less: docs/results.md.

## Licence

MIT, like the repository, code and weights.
"""
DATASETS = """---
license: mit
task_categories: [reinforcement-learning]
tags: [minari, gymnasium, JackInBox-v0, offline-rl]
---

# Datasets of JackInBox-v0

A planar jack bounces in a box that a torque turns. On the exact contact model, a random policy, a PPO network and a
planner play the tasks juggle, spin and rattle. `jackbox` is a Minari namespace; each dataset is a folder in it.

| dataset | episodes | steps | mean return |
|---|---:|---:|---:|
{rows}
Episodes have 500 control steps of 0.02 s and start from the seeds 0, 1, 2 and so on. A step is one decision: of PPO and
the planner it has several control steps, for which `duration` is its time.

## Use

```python
import minari

dataset = minari.load_dataset("{first}")
env = dataset.recover_environment()  # needs jackbox
for episode in dataset.iterate_episodes():
    print(episode.rewards.sum(), episode.infos["state"].shape)
```

## Contents

Observations, actions and rewards are those of JackInBox-v0, with the observation, action and `action_repeat` of the
policy. `infos` has one row more than there are actions:

| name | meaning |
|---|---|
| `state` | x, y and angle of the box and of the jack, then their rates, 12 numbers, float64, SI units |
| `time`, `duration` | at the end of the step, and of it [s] |
| `torque` | mean over the step [N m] |
| `impacts`, `impulse` | their number in the step, and the sum of their impulses [N s] |
| `reward_<term>` | each term of the reward |

Every episode was replayed from its seed, and its second half from the state in the middle: states, observations and
rewards have the same bits.

## Version

Made with {versions}. Each dataset's metadata has these versions, each episode's its seed.

## Licence

MIT, like the code of jackbox.
"""


def commit_of(path: Path) -> str:
    """The last commit that changed a file."""
    command = ["git", "-C", str(ROOT), "log", "-1", "--format=%H", "--", str(path)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def card(folder: Path, record: dict[str, Any], commit: str) -> str:
    """The card of a shipped network; ``record`` is docs/results.json, ``commit`` that of the weights."""
    task, name = folder.name.split("-")
    facts: dict[str, Any] = {"task": task, "folder": folder.name, "policy": "planner" if name == "value" else name}
    path = facts["policy"] if name == "value" else folder.relative_to(ROOT).as_posix()
    facts |= {"version": __version__, "commit": commit, "path": path}
    facts |= {key: fact for path in folder.glob("*.json") for key, fact in json.loads(path.read_text()).items()}
    facts["inputs"] = INPUTS.get(facts.get("observation", "landing"), "")
    facts["spent"] = facts.get("processor_seconds", facts.get("seconds", math.nan))  # older trainings had a core alone
    means = [one["mean"] for one in record["learning"] if one["task"] == task]
    facts |= {"lowest": min(means), "highest": max(means), "metrics": "", "rows": ""}
    facts["chosen"] = "the box's angle and rate at the landing" if facts.get("action") == "landing" else "a torque"
    by_bounce = facts.get("action_repeat") == "bounce"
    steps = f"{facts.get('action_repeat')} control steps of {facts['control_dt']} s"
    facts |= {"lasting": "once a bounce" if by_bounce else f"for {steps} each time", "per": " per second" * by_bounce}
    for row in (row for row in record["rows"] if (row["task"], row["policy"]) == (task, facts["policy"])):
        half = (row["interval_95"][1] - row["interval_95"][0]) / 2.0
        facts["metrics"] += METRIC.format(**row, half=half)
        facts["rows"] += "| {contact} | {mean:.1f} ± {half:.1f} | {episodes} |\n".format(**row, half=half)
    return CARD.format(**facts, made=(ORIGINS.get(folder.name) or ORIGINS[name]).format(**facts))


def datasets_card(rows: Iterable[tuple[str, int, int, float]], versions: Mapping[str, str]) -> str:
    """The card of datasets: name, episodes, steps and mean return of each; ``versions`` that they were made with."""
    listed = list(rows)
    lines = "".join(f"| `{name}` | {count} | {steps:,} | {mean:.1f} |\n" for name, count, steps, mean in listed)
    made = ", ".join(f"{name} {version}" for name, version in versions.items())
    return DATASETS.format(rows=lines, first=listed[0][0], versions=made)


@command_line
def main() -> None:
    """Write all model cards."""
    import tyro

    tyro.cli(lambda: None, description=__doc__)
    record = json.loads((ROOT / "docs" / "results.json").read_text())
    for folder in sorted(path for path in SHIPPED.iterdir() if path.is_dir()):
        write_text(folder / "README.md", card(folder, record, commit_of(folder / WEIGHTS)))


if __name__ == "__main__":
    main()
