"""Build two wheels in dist: one for any platform, and one for Linux on x86-64 with the exact model compiled.

The second is for this version of CPython. Its machine code is for `SHIPPED_FOR` and the version of numba here; where
it does not fit, the exact model is compiled on first use, as from the first wheel.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from base64 import urlsafe_b64encode
from hashlib import sha256
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

from jackbox_env.tools.command_line import ROOT, command_line

# Of the C library the code calls fmod, memmove, memset and sincos, which every glibc has; numba needs a newer one.
TAG = "cp{0}{1}-cp{0}{1}-manylinux_2_17_x86_64".format(*sys.version_info)


def call_all() -> None:
    """Call everything whose compiled code is cached on disk, and so cache it."""
    import numpy as np

    from jackbox_env import Drive, Scene, Task, make_simulator, rollout, simulate
    from jackbox_env.envs.single import JackInBoxEnv
    from jackbox_env.envs.vector import JackInBoxVectorEnv
    from jackbox_env.exact import late
    from jackbox_env.exact.workspace import new_workspaces
    from jackbox_env.model.action import ACTIONS
    from jackbox_env.model.observation import OBSERVATIONS
    from jackbox_env.model.tasks import TASKS
    from jackbox_env.planning import linearization

    make_simulator(Scene(drive=Drive(torque=lambda time: 1e4)), "exact").step(0.02)
    users = Task(("zero",), lambda scene, state, torque, impulse: (0.0,))
    names = {"task": (*TASKS, users), "observation": (*OBSERVATIONS, "pixels"), "action": ACTIONS}
    for settings in [{kind: name} for kind in names for name in names[kind]]:
        env = JackInBoxEnv(contact="exact", **settings)
        env.reset()
        env.step(env.action_space.sample())
        envs = JackInBoxVectorEnv(2, contact="exact", randomize={"jack_mass": (3.0, 5.0)}, **settings)
        envs.reset()
        for _ in range(2):  # the second changes arguments in place
            envs.step(envs.action_space.sample())
    rollout(None, np.zeros(12), np.zeros(2), 0.02)
    for height in (0.0, -5.0):  # of the jack, whose foot then rests
        simulate({"drive": None}, [0.0] * 4 + [height] + [0.0] * 7, 0.1)(0.05)
    linearization.ensure_compiled()
    late.with_all(new_workspaces())


def missing(cache: Path) -> list[str]:
    """The names of functions that the package passes to ``compiled`` or ``compiled_for``, without code in a folder."""
    sources = "".join(path.read_text(encoding="utf-8") for path in sorted((ROOT / "jackbox_env").rglob("*.py")))
    passed = " ".join(re.findall(r"\bcompiled(?:_for\([\w.]+,|\()([^()]*)\)", sources))
    names = {*re.findall(r"(?<!=)\b\w+\b(?!=)", passed)} & {*re.findall(r"^def (\w+)", sources, re.MULTILINE)}
    return sorted(names - {path.name.partition("-")[0].partition(".")[2] for path in cache.rglob("*.kept")})


def compile_into(cache: Path, package: Path) -> None:
    """Fill a cache folder with the compiled code of an unpacked package, in a separate process.

    Raises:
        SystemExit: code is missing.
    """
    from jackbox_env.jit.code_cache import SHIPPED_FOR

    target = {"NUMBA_CPU_NAME": SHIPPED_FOR, "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(cache)}
    command = [sys.executable, "-c", "from scripts.wheel import call_all; call_all()"]
    paths = os.pathsep.join(map(str, (package, ROOT)))
    subprocess.run(command, check=True, cwd=cache, env={**os.environ, **target, "PYTHONPATH": paths})
    if lacking := missing(cache):
        raise SystemExit(f"call_all in scripts/wheel.py does not call {', '.join(lacking)}: no code to ship")


def with_code(pure: Path, cache: Path, out: Path) -> None:
    """Write a wheel like ``pure``, with the cached code, for this platform."""
    with ZipFile(pure) as source:
        files = {name: source.read(name) for name in source.namelist()}
    (record,) = (name for name in files if name.endswith(".dist-info/RECORD"))
    del files[record]
    about = f"Wheel-Version: 1.0\nGenerator: jackbox\nRoot-Is-Purelib: false\nTag: {TAG}\n"
    files[record.replace("RECORD", "WHEEL")] = about.encode()
    for path in sorted(cache.rglob("*.kept")):
        files[f"jackbox_env/exact/shipped/{path.relative_to(cache).as_posix()}"] = path.read_bytes()
    lines = list[str]()
    for name, content in files.items():
        digest = urlsafe_b64encode(sha256(content).digest()).decode().rstrip("=")
        lines.append(f"{name},sha256={digest},{len(content)}\n")
    files[record] = "".join([*lines, f"{record},,\n"]).encode()
    with ZipFile(out, "w", ZIP_DEFLATED) as wheel:
        for name, content in files.items():
            wheel.writestr(name, content)


@command_line
def main() -> None:
    """Build both; exits with a message on other platforms than Linux on x86-64."""
    import tyro

    tyro.cli(lambda: None, description=__doc__)
    if sysconfig.get_platform() != "linux-x86_64":
        raise SystemExit("compiled code is for Linux on x86-64; for any platform: python -m build --wheel")
    out = ROOT / "dist"
    out.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        built, package, cache = (Path(scratch) / name for name in ("built", "package", "cache"))
        cache.mkdir()
        build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(built), str(ROOT)]
        subprocess.run(build, check=True, stdout=subprocess.DEVNULL)
        (pure,) = built.iterdir()
        shutil.unpack_archive(pure, package, "zip")
        compile_into(cache, package)
        shutil.copy(pure, out)
        with_code(pure, cache, out / pure.name.replace("py3-none-any", TAG))
    print(f"Both are in {out}")


if __name__ == "__main__":
    main()
