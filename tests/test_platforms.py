"""The package without what macOS, Windows or a base install lack, which is hidden from a child process.

One child imports all modules, locks a folder and trains ten steps; another collects the tests.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import os
import pkgutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
# Libraries, imported before: they branch on the name of the system.
LIBRARIES = (
    "filelock matplotlib.pyplot numba pygame pymunk rich.progress scipy.stats stable_baselines3 torch._dynamo tyro"
)
MODULES = ("fcntl", "resource", "pwd", "grp", "termios", "tty", "pty")
ATTRIBUTES = {
    os: "O_NOFOLLOW register_at_fork sched_getaffinity sched_setaffinity fork uname sysconf getuid killpg setsid",
    signal: "SIGKILL SIGALRM SIGHUP SIGPIPE alarm setitimer pthread_kill",
}


def hide() -> None:
    """Hide what Windows lacks."""
    if sys.platform == "win32":
        return
    for name in MODULES:
        sys.modules[name] = None  # type: ignore[assignment]  # importing it fails
    for module, names in ATTRIBUTES.items():
        for name in names.split():
            if hasattr(module, name):  # macOS lacks some
                delattr(module, name)
    there = Path.exists
    setattr(Path, "exists", lambda path: path.parts[:2] != ("/", "proc") and there(path))  # noqa: B010


def import_all() -> int:
    """Import every module of the package, of the agents and of the commands; return how many."""
    names = [
        module.name
        for folder in ("jackbox_env", "agents", "scripts")
        for module in pkgutil.walk_packages([str(ROOT / folder)], f"{folder}.")
        if not module.name.startswith(("scripts.recipes", "scripts.studies"))
    ]
    for name in names:
        importlib.import_module(name)
    return len(names)


def train(folder: Path) -> None:
    """Train ten steps in a run folder, which is locked meanwhile."""
    from agents.runs import describe
    from agents.settings import TrainSettings
    from agents.training import ppo
    from jackbox_env.tools.files import new_folder

    settings = TrainSettings(
        total_steps=10, num_envs=2, rollout_steps=5, batch_size=10, epochs=1, eval_steps=10, eval_episodes=1
    )
    new_folder(folder, "test", lambda made: describe(made, settings))
    assert ppo.train(settings, folder, progress=False).num_timesteps == 10


def lock(folder: Path) -> None:
    """A folder is locked once, and can be locked again afterwards."""
    from agents import runs

    for _ in range(2):
        with runs.locked(folder), pytest.raises(runs.FolderInUseError), runs.locked(folder):
            pass
    with pytest.raises(runs.FolderInUseError), runs.locked(folder), runs.locked(folder):
        pass


def on_other_systems(folder: Path) -> None:
    """Import all modules, train and lock a folder without what macOS and Windows lack, in a child process."""
    for name in LIBRARIES.split():
        importlib.import_module(name)
    hide()
    print(import_all(), "modules")
    train(folder)
    lock(folder)


@pytest.mark.slow
def test_nothing_needs_features_that_other_systems_lack(tmp_path: Path) -> None:
    code = "import sys, pathlib, tests.test_platforms as here; here.on_other_systems(pathlib.Path(sys.argv[1]))"
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "run")], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout.split()[0]) > 100


def installed_with(*names: str) -> set[str]:
    """These distributions and all their requirements without extras."""
    packages: set[str] = set()
    missing = list(names)
    while missing:
        name = canonicalize_name(missing.pop())
        if name not in packages:
            packages.add(name)
            requirements = map(Requirement, importlib.metadata.requires(name) or [])
            missing += [one.name for one in requirements if not one.marker or one.marker.evaluate({"extra": ""})]
    return packages


class Missing:
    """Hides each library that a base install with pytest and Hypothesis lacks."""

    def __init__(self) -> None:
        base = installed_with("jackbox", "pytest", "hypothesis")
        owners = importlib.metadata.packages_distributions().items()
        self.names = {name for name, owned in owners if base.isdisjoint(map(canonicalize_name, owned))}

    def find_spec(self, name: str, *_: object) -> None:
        if name in self.names:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def collect() -> int:
    """Collect all tests as a base install does, also without pytest's plugins."""
    sys.meta_path.insert(0, Missing())
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
    return pytest.main(["--collect-only", "-q", "-p", "no:cacheprovider", str(ROOT / "tests")])


@pytest.mark.slow
def test_every_test_module_is_collected_in_a_base_install() -> None:
    code = "import tests.test_platforms as here; raise SystemExit(here.collect())"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert "tests/guarantees/test_bits.py::" in done.stdout
    assert "tests/batches/test_torch.py::" not in done.stdout  # the libraries were hidden
