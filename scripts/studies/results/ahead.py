"""PPO that is shown a plan by `Lookahead` and corrects it: five trainings on juggle."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.evaluation.returns import evaluate
from agents.policies.playing import manner_of, play
from agents.runs import TIME
from agents.settings import TrainSettings
from agents.training.models import load_model
from agents.training.ppo import trained_in
from jackbox_env.recording.files import write_json

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


class PlanAlone:
    """A policy that follows the plan that `Lookahead` shows, and corrects nothing."""

    def __init__(self) -> None:
        self._manner = manner_of(SETTINGS)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Any, Any]:
        """See :class:`agents.policies.scripted.Policy`."""
        return play(self._manner, _no_correction, observation, state, episode_start)


def _no_correction(seen: NDArray[Any]) -> NDArray[Any]:
    return np.zeros((len(seen), 1), np.float32)


def plan_alone(kept: Path, episodes: int, seed: int) -> dict[str, Any]:
    """What the plan earns that nobody corrects; kept in the folder."""
    file = kept / f"lookahead-alone-{episodes}.json"
    if not file.exists():
        row = evaluate("plan alone", PlanAlone(), SETTINGS.env_settings, episodes, seed, progress=True)
        write_json(file, row.as_json())
    found: dict[str, Any] = json.loads(file.read_text())
    return found


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


def text(rows: list[dict[str, Any]], alone: dict[str, Any], reached: float = 300.0) -> list[str]:
    """The page's lines, of trainings and of the plan alone."""
    plain, (plain_low, plain_high) = alone["mean"], alone["interval_95"]
    above = sum(row["interval_95"][0] > reached for row in rows)
    lines = [
        "",
        "## Looking ahead",
        "",
        f"PPO that is shown a plan of 32 samples by `Lookahead` and corrects it earns more than {reached:.0f} on "
        f"juggle in {above} of {len(rows)} trainings. The plan alone, which an agent follows that always says 0, earns "
        f"{plain:.1f} ({plain_low:.1f} to {plain_high:.1f}). So these trainings have not improved on it.",
        "",
        "Most of the time goes into looking ahead. The minutes are the wall clock's, on a machine that other work "
        "shared.",
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
