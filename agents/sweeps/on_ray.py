"""Run trials on the cores of one machine, or of a cluster, by plain tasks of Ray.

A task is retried where its worker or its machine dies. Ray Tune would add schedulers that stop trials early, which a
sweep of fixed trials has no use for, and seven packages; tasks need Ray alone.
"""

from __future__ import annotations

import contextlib
import os
import platform
import shutil
import socket
import tempfile
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from agents.sweeps.in_process import LOOK_AGAIN, Finished, InTurn, Runner, Trial, Work, attempt, nothing
from agents.sweeps.results_log import differing, made_with
from jackbox_env import _validation as check
from jackbox_env.compiled import compiler

RETRIES = 4  # of a trial whose worker has died; then it has failed
AHEAD = 8  # trials given to the cluster for each of its cores: short ones do not wait for this process
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
_ANSWERS = 10.0  # [s] that a cluster's head has to answer
_ROOT = Path(__file__).parents[2]
_SENT = ("jackbox_env", "agents", "scripts", "tests/data")  # of the checkout; what is not there is left out
_CODE = "compiled"  # folder of compiled code, beside them


def runner_for(workers: int | None, address: str | None) -> Runner:
    """What runs trials as a command line asks: in this process, or on Ray where one of the two is given.

    Raises:
        ImportError, TypeError, ValueError: as :class:`OnRay` does.
    """
    return InTurn() if workers is None and address is None else OnRay(workers, address)


class OnRay:
    """Runs trials as tasks of Ray, each on one core and in one thread.

    Args:
        workers: on this machine, without a cluster; None: its cores.
        address: of a cluster's head, or "auto" on a machine of the cluster. Its machines need this project's
            requirements and Ray of the same versions; checkout and compiled code are sent to them.

    Raises:
        ImportError: Ray is not installed.
        TypeError, ValueError: both are given, or ``workers`` is no whole number from 1 to 1000.
    """

    def __init__(self, workers: int | None = None, address: str | None = None) -> None:
        if workers is not None:
            check.whole("workers", workers, at_least=1, at_most=1000)
        if workers is not None and address is not None:
            raise ValueError(f"workers must be None with an address: the cluster has its own, got {workers}")
        try:
            import ray
        except ImportError as error:
            raise ImportError(check.extra_needed("running trials side by side", "ray", "scale")) from error
        self._ray: Any = ray
        self._workers, self._address = workers, address

    def run(self, trials: Iterable[Trial], work: Work, look: Callable[[], None] = nothing) -> Iterator[Finished]:
        """See :class:`agents.sweeps.in_process.Runner`; a machine that joins the cluster meanwhile is used.

        Raises:
            ConnectionError: there is no cluster at the address.
            RuntimeError: a machine has other versions or other code.
        """
        with self._connected():
            given = self._task(work)
            waiting, under_way = iter(trials), dict[Any, Trial]()
            try:
                while True:
                    free = AHEAD * self._cores() - len(under_way)
                    under_way |= {given.remote(trial.settings): trial for trial in islice(waiting, max(0, free))}
                    if not under_way:
                        return
                    self._ray.wait(list(under_way), timeout=LOOK_AGAIN)
                    look()
                    done, _ = self._ray.wait(list(under_way), num_returns=len(under_way), timeout=0)
                    for reference in done:
                        yield self._fetched(reference, under_way.pop(reference))
            finally:
                for reference in under_way:
                    self._ray.cancel(reference, force=True)

    def _task(self, work: Work) -> Any:
        """The work as a task of Ray, which a worker loads once."""
        expected = made_with()

        def run(settings: dict[str, Any]) -> Finished | str:
            other = differing(expected, _made_with_once())
            return f"{other} on {platform.node()}" if other else attempt(work, Trial(settings))

        return self._ray.remote(num_cpus=1, max_retries=RETRIES)(run)

    def _fetched(self, reference: Any, trial: Trial) -> Finished:
        """What a task returned, or that its worker died once too often."""
        try:
            found = self._ray.get(reference)
        except self._ray.exceptions.RayTaskError as error:  # the work could not be loaded there
            said = f"{type(error.cause).__name__}: {next(iter(str(error.cause).splitlines()), '')}"
            return Finished(trial, None, said, str(error), 0.0, "", "")
        except self._ray.exceptions.RayError as error:
            said = f"{type(error).__name__}: its worker ended {RETRIES + 1} times, or could not start"
            return Finished(trial, None, said, str(error), 0.0, "", "")
        if isinstance(found, str):
            raise RuntimeError(f"the machines of a sweep must have the same code and versions, got {found}")
        return Finished(trial, *found[1:])

    def _cores(self) -> int:
        """Of the machines that are there now; one where none is, so that a trial waits for the first."""
        return max(1, int(self._ray.cluster_resources().get("CPU", 0)))

    @contextlib.contextmanager
    def _connected(self) -> Iterator[None]:
        """Start Ray on this machine, or join a cluster; leave it at the end."""
        if self._ray.is_initialized():
            raise RuntimeError("this process is connected to Ray already: call ray.shutdown() first")
        quiet = {"log_to_driver": False, "logging_level": "error"}
        with tempfile.TemporaryDirectory() as scratch:
            if self._address is None:
                # no dashboard, no reports of use: a machine without a network runs sweeps too
                os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
                environment: dict[str, Any] = {"env_vars": ONE_THREAD}
                own = {"address": "local", "num_cpus": self._workers, "include_dashboard": False}
                self._ray.init(**own, runtime_env=environment, **quiet)
            else:
                _check_answers(self._address)
                sent = str(sent_to_machines(Path(scratch)))
                environment = {"working_dir": sent, "env_vars": {**ONE_THREAD, "NUMBA_CACHE_DIR": _CODE}}
                self._ray.init(address=self._address, runtime_env=environment, **quiet)
            try:
                yield
            finally:
                self._ray.shutdown()


def _check_answers(address: str) -> None:
    """Refuse now an address that Ray would try for minutes.

    Raises:
        ConnectionError: nothing answers there.
    """
    host, _, port = address.rpartition(":")
    if not (host and port.isdecimal()):
        return  # "auto", or a form that Ray reads by itself
    try:
        socket.create_connection((host, int(port)), timeout=_ANSWERS).close()
    except OSError as error:
        raise ConnectionError(f"no cluster answers at {address}: {error.strerror or error}") from error


_here: dict[str, str] = {}


def _made_with_once() -> dict[str, str]:
    """As :func:`agents.sweeps.results_log.made_with`, which reads all of the code, once for each process."""
    if not _here:
        _here.update(made_with())
    return _here


def sent_to_machines(scratch: Path) -> Path:
    """A folder with what a cluster's machines get: the checkout's code, and what this machine has compiled.

    Compiled code is for one kind of processor; a machine of another kind does not load it, and compiles for itself.
    """
    made, ignored = scratch / "jackbox", shutil.ignore_patterns("__pycache__", "*.partial*")
    for name in _SENT:
        if (_ROOT / name).is_dir():
            shutil.copytree(_ROOT / name, made / name, ignore=ignored)
    for folder in reversed(compiler.cache_folders()):  # the last is where this process saves
        shutil.copytree(folder, made / _CODE / folder.name, dirs_exist_ok=True, ignore=shutil.ignore_patterns("*.tmp"))
    return made
