"""Sweeps on a cluster of Ray: the same table, also with a worker and a node killed in the middle."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from agents.runners import in_turn
from agents.sweep import TABLE, Code, carry_out, code_named, grid, new_sweep, run_trial
from agents.sweep_ray import runner_for
from jackbox_env.jit import folders
from jackbox_env.tools.user_code import texts_of
from tests.agents.small_run import TINY
from tests.agents.test_sweep import MINE, carried_out

pytest.importorskip("ray", reason='NOTHING ON RAY IS TESTED: Ray is missing, pip install -e ".[scale]"')
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning", "ignore::ResourceWarning"),
]


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two nodes of one core each, on loopback."""
    from ray.cluster_utils import Cluster

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.delenv("PYTHONPATH", raising=False)  # the nodes have what they are sent
        made = Cluster(
            initialize_head=True,
            # At Ray's niceness of 15 workers get nearly nothing on a busy machine.
            head_node_args={"num_cpus": 1, "include_dashboard": False, "_system_config": {"worker_niceness": 0}},
        )
        made.add_node(num_cpus=1)
    yield made
    made.shutdown()


def test_policies_trainings_and_users_code_give_the_same_table_as_in_one_process(
    tmp_path: Path, cluster: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(MINE.format(value=1.0))  # which the nodes are sent
    sides: dict[str, Any] = {"policy": ("ppo", "random"), "train": None, "task": ("juggle",), "scene": ("{}",)}
    small = {**asdict(replace(TINY, total_steps=512, eval_steps=256, checkpoint_steps=256)), "episodes": 2}
    users = grid(
        **sides | {"policy": ("level", "mine.py:level"), "task": ("mine.py:task",)},
        setting=("exact",),
        seeds=1,
        episodes=2,
    )
    trials = [*grid(**sides, setting=("exact", "balanced"), seeds=2, episodes=2), *users, small]
    code = Code(texts_of(code_named(trials)), tuple(code_named(trials)))
    for name, runner in (("alone", in_turn), ("cluster", runner_for(None, cluster.address))):
        work = partial(run_trial, new_sweep(tmp_path / name, trials), code)
        assert not any(row["error"] for row in carry_out(tmp_path / name, trials, work, runner, progress=False))
    assert (tmp_path / "alone" / TABLE).read_bytes() == (tmp_path / "cluster" / TABLE).read_bytes()


def test_a_worker_and_a_node_killed_in_the_middle_lose_nothing(tmp_path: Path, cluster: Any) -> None:
    node, here = cluster.add_node(num_cpus=1), folders.cache_folders()[-1]
    killed, there = node.node_id, sorted(os.listdir(here))

    def hanging(settings: dict[str, Any]) -> dict[str, Any]:
        import ray

        what = "node" if ray.get_runtime_context().get_node_id() == killed else "worker"
        if not (tmp_path / what).exists():
            (tmp_path / what).touch()
            if what == "worker":
                os.kill(os.getpid(), signal.SIGKILL)
            time.sleep(250.0)
        sent = folders.cache_folders()[-1]
        assert sent != here
        assert sorted(os.listdir(sent)) == there
        return {"share": settings["number"] / 7.0}

    def kill() -> None:
        while not (tmp_path / "node").exists():
            time.sleep(0.05)
        cluster.remove_node(node, allow_graceful=False)

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    table = carried_out(tmp_path / "killed", hanging, runner_for(None, cluster.address))
    assert (tmp_path / "worker").exists()
    assert not killer.is_alive()
    assert table == carried_out(tmp_path / "alone", lambda settings: {"share": settings["number"] / 7.0})
