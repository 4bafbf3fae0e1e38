"""Sweeps on Ray: on this machine's cores, and on a cluster with workers and a node killed in the middle."""

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

from agents.settings import EnvSettings
from agents.sweeps import trials
from agents.sweeps.in_process import InTurn, Runner, Trial
from agents.sweeps.on_ray import OnRay
from agents.sweeps.results_log import TABLE, TIMES, Outcome, carry_out, new_sweep
from jackbox_env.compiled import compiler
from tests.agents.small_run import TINY
from tests.agents.test_sweeping import GRID, rows_of

pytest.importorskip("ray", reason='NOTHING ON RAY IS TESTED: Ray is missing, pip install -e ".[scale]"')
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning", "ignore::ResourceWarning"),
]
NODES = 2


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two nodes of one core each, on loopback."""
    from ray.cluster_utils import Cluster

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.delenv("PYTHONPATH", raising=False)  # the nodes have what they are sent
        made = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
        for _ in range(NODES - 1):
            made.add_node(num_cpus=1)
    yield made
    made.shutdown()


def swept(folder: Path, grid: list[Trial], work: Any, runner: Runner) -> tuple[bytes, Outcome]:
    """The table of a whole sweep."""
    outcome = carry_out(new_sweep(folder, {}, grid), grid, work, runner, progress=False)
    return (folder / TABLE).read_bytes(), outcome


def test_policies_and_trainings_give_the_same_table_in_process_on_cores_and_on_a_cluster(
    tmp_path: Path, cluster: Any
) -> None:
    environments = [EnvSettings(contact="exact"), EnvSettings(contact="pymunk", scene='{"gravity": 5.0}')]
    small = asdict(replace(TINY, total_steps=512, eval_steps=256, checkpoint_steps=256, contact="exact"))
    grid = [*trials.policy_trials(("ppo", "random"), environments, 2, 2), Trial({**small, "episodes": 2})]
    runners: dict[str, Runner] = {
        "alone": InTurn(),
        "cores": OnRay(workers=2),
        "cluster": OnRay(address=cluster.address),
    }
    tables = set[bytes]()
    for name, runner in runners.items():
        table, outcome = swept(tmp_path / name, grid, partial(trials.run_trial, tmp_path / name), runner)
        assert not outcome.failed, table
        assert len(outcome.processors) == 1
        tables.add(table)
        assert len({row["place"] for row in rows_of(tmp_path / name, TIMES)}) == (1 if name == "alone" else NODES)
    assert len(tables) == 1


def test_machines_load_the_compiled_code_that_they_are_sent(tmp_path: Path, cluster: Any) -> None:
    def compiled(settings: dict[str, Any]) -> dict[str, Any]:
        import jackbox_env

        folder = compiler.cache_folders()[-1]
        before = {path.name for path in folder.iterdir()}
        jackbox_env.make_simulator(contact="exact").step(0.02)
        return {"folder": str(folder), "there": len(before), "new": len(list(folder.iterdir())) - len(before)}

    compiled({})  # here, so that there is something to send
    swept(tmp_path / "sweep", GRID[:1], compiled, OnRay(address=cluster.address))
    (row,) = rows_of(tmp_path / "sweep")
    assert row["folder"] not in map(str, compiler.cache_folders())
    assert int(row["there"]) > 0
    assert row["new"] == "0"


def test_a_worker_and_a_node_killed_in_the_middle_lose_nothing(tmp_path: Path, cluster: Any) -> None:
    def shares(settings: dict[str, Any]) -> dict[str, Any]:
        return {"share": (settings["number"] + len(settings["name"])) / 7.0}

    node, notes = cluster.add_node(num_cpus=1), tmp_path / "notes"
    lost = node.node_id
    notes.mkdir()

    def hanging(settings: dict[str, Any]) -> dict[str, Any]:
        import ray

        here, number = ray.get_runtime_context().get_node_id(), settings["number"]
        what = "node" if here == lost else f"worker-{settings['name']}" if number == 3 else ""
        if what and not (notes / what).exists():
            (notes / f"{what}.new").write_text(str(os.getpid()))
            (notes / f"{what}.new").rename(notes / what)
            time.sleep(250.0)
        return shares(settings)

    def kill() -> None:
        for what in ("worker-one", "worker-other", "node"):
            deadline = time.monotonic() + 100.0
            while not (notes / what).exists() and time.monotonic() < deadline:
                time.sleep(0.05)
            if what == "node":
                cluster.remove_node(node, allow_graceful=False)
            else:
                os.kill(int((notes / what).read_text()), signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    table, outcome = swept(tmp_path / "killed", GRID, hanging, OnRay(address=cluster.address))
    killer.join()
    assert len(list(notes.iterdir())) == 3
    assert (outcome.finished, outcome.failed) == (len(GRID), [])
    assert table == swept(tmp_path / "alone", GRID, shares, InTurn())[0]
