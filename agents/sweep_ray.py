"""Run a sweep's trials on a cluster, as plain tasks of Ray, each in one thread on one core.

A task is run again if its worker or its machine dies. The cluster's machines need this project's requirements and Ray
in the same versions. They receive the checkout's code and this machine's compiled code.
"""

from __future__ import annotations

import platform
import shutil
import socket
import tempfile
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from agents.runners import ONE_THREAD, Finished, Results, Runner, Trials, Work, attempt, in_turn, on_cores
from agents.sweep import differing, made_with
from jackbox_env.jit.folders import cache_folders
from jackbox_env.tools import checks as check
from jackbox_env.tools.reading import first_line

RETRIES = 4  # of a trial whose worker has died; then it has failed
AHEAD = 8  # trials submitted for each core of the cluster: short ones do not wait for this process
POLL = 0.5  # [s] between two polls of the running tasks
CONNECT_TIMEOUT = 10.0  # [s]
_ROOT = Path(__file__).parents[1]
_SENT_FOLDERS = ("jackbox_env", "agents", "scripts", "docs/reference")  # of the checkout, if they exist
_CODE = "compiled"  # folder of compiled code, beside them


def runner_for(workers: int | None, address: str | None) -> Runner:
    """The runner that a command line selects: this process, processes of this machine, or a cluster.

    Args:
        workers: processes; None: without others.
        address: of the cluster's head, or "auto" on a machine of the cluster; None: without a cluster.

    Raises:
        ImportError: Ray is not installed.
        TypeError, ValueError: both are given, or ``workers`` is no whole number from 1 to 100; each needs about eight
            open files, and a process often may have 1024.
    """
    if workers is not None and address is not None:
        raise ValueError(f"workers must be None with an address: the cluster has its own, got {workers}")
    if workers is not None:
        return partial(on_cores, check.whole("workers", workers, at_least=1, at_most=100))
    if address is None:
        return in_turn
    with check.extra("running trials on a cluster", "ray", "scale"):
        import ray
    return partial(_on_cluster, ray, address)


def _on_cluster(ray: Any, address: str, trials: Trials, work: Work) -> Results:
    """Run trials on all cores of a cluster; a machine that joins it meanwhile is used.

    Raises:
        ConnectionError: there is no cluster at the address.
        RuntimeError: a machine has other versions or other code.
    """
    expected, waiting, running = made_with(), iter(trials), dict[Any, dict[str, Any]]()

    def run(settings: dict[str, Any]) -> Finished:
        if missing := differing(expected):
            raise RuntimeError(
                f"the machines of a sweep must have the same versions: {platform.node()} has no {missing}"
            )
        return attempt(work, settings)

    _join(ray, address)
    try:
        task = ray.remote(num_cpus=1, max_retries=RETRIES)(run)
        while True:
            cores = max(1, int(ray.cluster_resources().get("CPU", 0)))  # 1: a trial waits for the first machine
            more = islice(waiting, max(0, AHEAD * cores - len(running)))
            running |= {task.remote(settings): settings for settings in more}
            if not running:
                return
            done, _ = ray.wait(list(running), num_returns=len(running), timeout=POLL)
            for reference in done:
                yield _fetched(ray, reference, running.pop(reference))
    finally:
        ray.shutdown()


def _fetched(ray: Any, reference: Any, settings: dict[str, Any]) -> Finished:
    """A task's result; a failed trial if its worker died too often."""
    try:
        return ray.get(reference)  # type: ignore[no-any-return]
    except ray.exceptions.RayTaskError as error:  # not of the work, whose errors are results
        raise RuntimeError(first_line(error.cause)) from error
    except ray.exceptions.RayError as error:
        return Finished(settings, error=first_line(error))


def _join(ray: Any, address: str) -> None:
    """Join a cluster; raises ConnectionError at once if none answers, where Ray would try for minutes."""
    host, _, port = address.rpartition(":")
    if host and port.isdecimal():
        try:
            socket.create_connection((host, int(port)), timeout=CONNECT_TIMEOUT).close()
        except OSError as error:
            raise ConnectionError(f"no cluster answers at {address}: {error.strerror or error}") from error
    with tempfile.TemporaryDirectory() as scratch:
        _copy_code(Path(scratch))
        environment = {"working_dir": scratch, "env_vars": {**ONE_THREAD, "NUMBA_CACHE_DIR": _CODE}}
        ray.init(address=address, runtime_env=environment, log_to_driver=False, logging_level="error")


def _copy_code(folder: Path) -> None:
    """Copy the files for a cluster's machines: the checkout's code, and this machine's compiled code.

    Compiled code is for one kind of processor. Machines of other kinds compile for themselves.
    """
    unfinished = shutil.ignore_patterns("__pycache__", "*.partial*", "*.tmp")
    for name in _SENT_FOLDERS:
        if (_ROOT / name).is_dir():
            shutil.copytree(_ROOT / name, folder / name, ignore=unfinished)
    for compiled in reversed(cache_folders()):  # the last is where this process saves
        shutil.copytree(compiled, folder / _CODE / compiled.name, dirs_exist_ok=True, ignore=unfinished)
