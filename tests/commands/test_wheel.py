"""The wheel alone: no extras, no checkout, in an empty folder. An editable install would hide what it lacks."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import sysconfig
import tomllib
from collections.abc import Iterable
from functools import partial
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from jackbox_env import __version__
from jackbox_env.commands.play import PAGE
from scripts.wheel import missing
from tests.fingerprints import fingerprints
from tests.guarantees.test_other_machines import OLDEST, differing, x86

ROOT = Path(__file__).parents[2]

PYMUNK = "--fidelity", "balanced"  # which compiles nothing


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel for any platform, installed."""
    pytest.importorskip("build")
    built = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(built), str(ROOT)]
    subprocess.run(
        build, capture_output=True, check=True
    )  # hatchling and what the page needs are among the packages here
    return installed(built.glob("*.whl"), tmp_path_factory.mktemp("site"))


def installed(wheels: Iterable[Path], folder: Path) -> Path:
    """A folder of packages as a plain ``pip install`` of the wheel makes it, with links to those installed here."""
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", str(folder)]
    subprocess.run([*install, *map(str, wheels)], check=True, capture_output=True)
    names = asked_by(*metadata.distributions(path=[str(folder)]))
    for package in names:  # grows meanwhile
        distribution = metadata.distribution(package)
        names += [name for name in asked_by(distribution) if name not in names]
        for top in {file.parts[0] for file in distribution.files or []} - {"..", "__pycache__"}:
            if not (folder / top).exists():
                (folder / top).symlink_to(Path(str(distribution.locate_file(top))))
    return folder


def asked_by(package: metadata.Distribution) -> list[str]:
    """The names of packages that a package requires without extras, on this system."""
    asked = map(Requirement, package.requires or [])
    return [one.name for one in asked if one.marker is None or one.marker.evaluate({"extra": ""})]


def run(site: Path, cwd: Path, *words: str, **settings: str) -> subprocess.CompletedProcess[str]:
    """Run Python with the wheel installed; -S hides the packages of this environment."""
    env, command = {**os.environ, **settings, "PYTHONPATH": str(site)}, [sys.executable, "-S", *words]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=env, timeout=250, check=False)


def jackbox(
    site: Path, cwd: Path, *arguments: str, status: int = 0, **settings: str
) -> subprocess.CompletedProcess[str]:
    """Run the command that the wheel installs."""
    done = run(site, cwd, str(site / "bin" / "jackbox"), *arguments, **settings)
    assert done.returncode == status, done.stderr
    return done


def test_a_wheel_contains_the_package_alone(site: Path) -> None:
    (wheel,) = metadata.distributions(name="jackbox", path=[str(site)])
    assert sorted(asked_by(wheel)) == ["gymnasium", "numba", "numpy", "pygame-ce", "pymunk", "typing-extensions"]
    names = {str(file) for file in wheel.files or []}
    tops = {name.split("/")[0] for name in names} - {"..", "bin"}
    assert tops == {"jackbox_env", f"jackbox-{wheel.version}.dist-info"}
    assert "jackbox_env/py.typed" in names
    assert {
        f"jackbox_env/recording/web/{path.name}" for path in (ROOT / "jackbox_env" / "recording" / "web").iterdir()
    } < names
    assert any(name.endswith("LICENSE") for name in names)


def test_simulate_writes_files_without_plots_and_refuses_to_draw_them(site: Path, tmp_path: Path) -> None:
    done = jackbox(site, tmp_path, "simulate", "--seconds", "2", "--html", "--folder", "out", *PYMUNK)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "impacts.csv",
        "scene.json",
        "states.csv",
        "trajectory.html",
    ]
    assert re.fullmatch("No plots: matplotlib is not installed .*\n", done.stderr)  # and nothing was compiled
    assert "pip install matplotlib" in jackbox(site, tmp_path, "simulate", "--plots", status=2).stderr


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder for code that the tests below compile."""
    return tmp_path_factory.mktemp("kept")


@pytest.mark.slow  # compiles anew
@pytest.mark.timeout(1800)
def test_check_finds_that_it_works_and_which_extras_are_missing(site: Path, cache: Path, tmp_path: Path) -> None:
    check = partial(jackbox, site, tmp_path, "check", status=0, **OLDEST, NUMBA_CACHE_DIR=str(cache))
    done, again = check(), check()
    assert done.stdout.count("ok      ") == again.stdout.count("ok      ") == 6
    assert re.search(r'extra train: not installed, pip install .*"torch', done.stdout)
    said = re.findall(r"jackbox compiles .* for ([a-z ]+), once on this machine", done.stderr)
    assert said == ["all environments", "feet at rest", "derivatives"]
    assert "compiles" not in again.stderr
    assert not list(tmp_path.iterdir())


@x86
@pytest.mark.slow  # compiles anew if it runs without the test above
def test_the_exact_model_gives_the_same_bits_on_the_oldest_machine(cache: Path) -> None:
    differ, compared = differing(["exact"], OLDEST | {"NUMBA_CACHE_DIR": str(cache)})
    assert differ == []
    assert len(compared) > 25


def test_play_writes_the_wheels_page(site: Path, tmp_path: Path) -> None:
    assert jackbox(site, tmp_path, "play", "--out", "game.html").stdout == "game.html\n"
    assert (tmp_path / "game.html").read_bytes() == PAGE.read_bytes()  # that of this source, which the build wrote


def test_the_page_is_built_with_the_packages_that_will_show_it() -> None:
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text())
    needed = stated["tool"]["hatch"]["build"]["targets"]["wheel"]["hooks"]["custom"]["dependencies"]
    assert {*needed} < {*stated["project"]["dependencies"]}


def test_commands_that_need_a_checkout_name_it_in_one_line(site: Path, tmp_path: Path) -> None:
    said = jackbox(site, tmp_path, "demo", status=2).stderr
    assert "clone the repository" in said
    assert said.count("\n") == 1


# -- with the exact model compiled ------------------------------------------------------------------------------------

FIRST = (
    "env = gym.make('JackInBox-v0', fidelity='exact'); env.reset(seed=0); env.step(np.zeros(1))",
    "envs = jackbox_env.JackInBoxVectorEnv(1024, fidelity='exact'); envs.reset(); envs.step(None)",
    "jackbox_env.rollout(None, np.zeros(12), np.zeros((8, 100)), 0.02, rewards='juggle')",
    "d = jackbox_env.linearize(None, np.zeros(12), [0.0], 0.02); d.A; d.jvp(); d.vjp(np.ones((1, 2, 12)))",
    "jackbox_env.simulate(duration=5.0)(4.99)",
    "jackbox_env.simulate({'drive': None}, [0.0] * 4 + [-5.0] + [0.0] * 7, 1.0)(0.5)",
    "gym.make('JackInBox-v0', fidelity='exact', observation='pixels').reset(seed=0)",
)
NOTHING_COMPILES = """
from numba.core.dispatcher import _FunctionCompiler
def refuse(*_): raise SystemExit("something is compiled")
_FunctionCompiler.compile = refuse
"""


@pytest.fixture(scope="module")
def shipped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel for this platform, which is built in dist, installed."""
    if sysconfig.get_platform() != "linux-x86_64":
        pytest.skip("compiled code is shipped for Linux on x86-64")
    subprocess.run([sys.executable, "-m", "scripts.wheel"], cwd=ROOT, check=True)
    return installed((ROOT / "dist").glob(f"jackbox-{__version__}-cp*.whl"), tmp_path_factory.mktemp("site"))


def first(site: Path, cwd: Path, code: str, **settings: str) -> subprocess.CompletedProcess[str]:
    """Run code with the wheel installed, an empty cache and no compiler."""
    return run(site, cwd, "-c", f"{NOTHING_COMPILES}\n{code}", **settings, NUMBA_CACHE_DIR=str(cwd))


@pytest.mark.slow  # builds the wheel
@pytest.mark.timeout(1800)
def test_shipped_code_takes_the_first_steps_and_nothing_is_compiled(shipped: Path, tmp_path: Path) -> None:
    steps = [f"import gymnasium as gym, numpy as np, jackbox_env\n{code}" for code in FIRST]
    done = first(shipped, tmp_path, "\n".join(steps))
    assert (done.returncode, done.stderr) == (0, "")
    # for which the code is not
    assert "something is compiled" in first(shipped, tmp_path, steps[0], NUMBA_CPU_NAME="generic").stderr


@pytest.mark.slow  # builds the wheel
@pytest.mark.timeout(1800)
def test_shipped_code_gives_the_same_bits(shipped: Path, tmp_path: Path) -> None:
    marks = f"runpy.run_path({str(ROOT / 'tests' / 'fingerprints.py')!r})['fingerprints']"
    done = first(shipped, tmp_path, f"import json, runpy; print(json.dumps({marks}(['exact'])))")
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout) == fingerprints(["exact"])


def test_a_wheel_without_the_code_of_a_compiled_function_is_not_built(tmp_path: Path) -> None:
    assert {"run", "draw"} < set(missing(tmp_path))
    for name in set(missing(tmp_path)) - {"draw"}:
        (tmp_path / f"file.{name}-0.kept").touch()
    assert missing(tmp_path) == ["draw"]
