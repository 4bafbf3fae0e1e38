"""PPO that is shown a plan by `Lookahead` and corrects it: five trainings on juggle."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

from agents.evaluation import evaluate
from agents.models import load_model
from agents.runs import TIME
from agents.settings import TrainSettings
from agents.training import trained_in
from jackbox_env.storage import write_json

SEEDS = (0, 1, 2, 3, 4)
SETTINGS = TrainSettings(
    contact="exact", lookahead=32, hold=5, num_envs=64, rollout_steps=64, batch_size=1024, total_steps=204_800,
    learning_rate=1e-4, initial_log_std=-3.0, gae_lambda=0.9, hidden_units=(64, 64), checkpoint_steps=1_000_000,
    eval_steps=40_960, eval_episodes=64,
)  # fmt: skip
COMMAND = (
    "python scripts/train.py --contact exact --lookahead 32 --hold 5 --num-envs 64 --rollout-steps 64 "
    "--batch-size 1024 --total-steps 204800 --learning-rate 1e-4 --initial-log-std -3 --gae-lambda 0.9 "
    "--hidden-units 64 64 --checkpoint-steps 1000000 --eval-steps 40960 --eval-episodes 64 --seed 0"
)


def ahead(kept: Path, episodes: int, seed: int) -> list[dict[str, Any]]:
    """What each training earns on the exact model, and its times; trainings and rows are kept in a folder."""
    rows = []
    for own in SEEDS:
        run, file = kept / f"lookahead-{own}", kept / f"lookahead-{own}-{episodes}.json"
        if not file.exists():
            settings = dataclasses.replace(SETTINGS, seed=own)
            trained_in(run, settings)
            earned = evaluate(f"lookahead {own}", load_model(run), settings.env_settings, episodes, seed, progress=True)
            write_json(file, {"seed": own, **earned.as_json(), "time": json.loads((run / TIME).read_text())})
        rows.append(json.loads(file.read_text()))
        print(f"lookahead, seed {own}: {rows[-1]['mean']:.1f}", flush=True)
    return rows


def text(rows: list[dict[str, Any]], reached: float = 300.0) -> list[str]:
    """The page's lines."""
    above = sum(row["interval_95"][0] > reached for row in rows)
    lines = [
        "",
        "## Looking ahead",
        "",
        f"PPO that is shown a plan of 32 samples by `Lookahead` and corrects it earns more than {reached:.0f} on "
        f"juggle in {above} of {len(rows)} trainings. Most of the time goes into looking ahead. The minutes are the "
        "wall clock's, on a machine that other work shared.",
        "",
        "| seed | mean return | 95 % interval | minutes | looking ahead | environment | learning |",
        "|---:|---:|:---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        (low, high), spent = row["interval_95"], row["time"]
        shares = [spent["parts"][part] / spent["seconds"] for part in ("looking ahead", "environment", "learning")]
        cells = " | ".join(f"{100.0 * share:.0f} %" for share in shares)
        minutes = spent["seconds"] / 60.0
        lines.append(f"| {row['seed']} | {row['mean']:.1f} | {low:.1f} to {high:.1f} | {minutes:.1f} | {cells} |")
    return [*lines, "", "```sh", COMMAND, "```"]
