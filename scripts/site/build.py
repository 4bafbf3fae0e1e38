"""Build the page in which the jack in a box is played: `python -m scripts.site.build`.

One HTML file without a network: the exact model as a WebAssembly module, the trained networks, the script. The module
is compiled once for each version of the source, and stored with the package's compiled code.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite  # type: ignore[import-untyped]
import numba
import numpy as np

import jackbox_env
from jackbox_env import Scene
from jackbox_env.commands.game import FARTHEST, LONGEST, MOST_SECONDS, VERSION
from jackbox_env.commands.play import PAGE
from jackbox_env.exact.pcg64 import seeded
from jackbox_env.exact.workspace import new_workspaces
from jackbox_env.jit.folders import cache_folders
from jackbox_env.model.action import ACTIONS, repeat_of
from jackbox_env.model.scene import BOUNDS, SceneNumbers
from jackbox_env.model.states import START_TOLERANCE, STATE_NAMES
from jackbox_env.model.tasks import TASKS
from jackbox_env.recording.page import assembled, base64_of
from jackbox_env.tools.command_line import command_line
from jackbox_env.tools.files import write_bytes, write_text
from scripts.site import entries

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
AGENTS = ROOT / "agents" / "trained"  # of each task's folder <task>-ppo settings.json and weights.npz are read
GOALS = {
    "juggle": "Keep the jack near the middle of the box: a step earns up to 1, in the middle.",
    "spin": "Spin the jack counter-clockwise: a step earns up to 1, less the faster the box turns.",
    "rattle": "Knock the jack hard against the walls; torque costs a little.",
}
COMPARED = {"level": "keeps the box level", "ppo": "trained agent (A)", "planner": "planner (searches ahead)"}
# Sliders: label, unit, ends.
SLIDERS = {
    "torque_limit": {"label": "torque limit", "unit": "N m", "least": 900.0, "most": 900000.0, "logarithmic": True},
    "box_mass": {"label": "box's mass", "unit": "kg", "least": 4.0, "most": 4000.0, "logarithmic": True},
    "jack_mass": {"label": "jack's mass", "unit": "kg", "least": 0.4, "most": 400.0, "logarithmic": True},
    "jack_arm": {"label": "jack's arm", "unit": "m", "least": 0.2, "most": 8.4},
    "restitution": {"label": "restitution", "unit": "", "least": 0.0, "most": 1.0},
    "gravity": {"label": "gravity", "unit": "m/s\N{SUPERSCRIPT TWO}", "least": 0.0, "most": 25.0},
}


def _module_file() -> str:
    """The name of the compiled physics of this source."""
    sources = (source.read_text() for source in sorted(HERE.glob("*.py")))
    versions = numba.__version__, llvmlite.__version__, *sources
    return f"page-{hashlib.sha256(repr(versions).encode()).hexdigest()[:16]}.wasm"


@cache
def module(name: str) -> bytes:
    """The physics, compiled if no folder has the file ``name``; then stored, unless no folder can be written."""
    paths = [folder / name for folder in cache_folders()]
    for path in paths:
        if path.is_file():
            return path.read_bytes()
    print("jackbox compiles its page to play, once for this version of the source (20 seconds)", file=sys.stderr)
    code = "import sys; from scripts.site.module import physics; sys.stdout.buffer.write(physics())"
    compiled = subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False, stdout=subprocess.PIPE)
    if compiled.returncode:
        raise RuntimeError(f"numba {numba.__version__} cannot compile the page's physics: its error is above")
    made = compiled.stdout
    try:
        write_bytes(paths[-1], made)
    except OSError as error:
        said = f"({error.strerror}), so each process compiles it anew"
        print(f"the page's physics cannot be kept in {paths[-1].parent} {said}", file=sys.stderr)
    return made


def ensure_page(path: Path | None = None) -> Path:
    """The path of the finished page, by default that of the package; it is written anew if it is not of this source.

    The page has a hash of its source: one that is up to date needs neither the compiler nor a folder to write to.

    Raises:
        OSError: it has to be written and cannot be.
    """
    path, name, described = path or PAGE, _module_file(), _described()
    template = (HERE / "play.html").read_text(encoding="utf-8")
    parts = {part: (HERE / part).read_text(encoding="utf-8").strip() for part in ("physics.js", "game.js", "play.js")}
    source = assembled(template, {**described, "module": f"{cache_folders()[-1].name}/{name}"}, **parts)
    mark = hashlib.sha256(source.encode()).hexdigest()
    if not path.is_file() or mark.encode() not in path.read_bytes():
        physics = base64_of(np.frombuffer(module(name), np.uint8), "u1")
        write_text(path, assembled(template, {**described, "module": physics, "source": mark}, **parts))
    return path


def _described() -> dict[str, Any]:
    """The page's data, for JSON, but for the module."""
    scene = Scene()
    return {
        "version": VERSION, "package": jackbox_env.__version__, "mostText": LONGEST, "mostSeconds": MOST_SECONDS,
        "farthest": FARTHEST, "workspace": new_workspaces().nbytes,
        "offsets": entries.OFFSETS, "impactsAt": entries.IMPACTS_AT, "length": entries.LENGTH,
        "mostImpacts": entries.MOST_IMPACTS, "observed": entries.OBSERVED,
        "values": list(scene.numbers), "torqueLimit": SceneNumbers._fields.index("torque_limit"),
        "seed": [str(word) for word in seeded(0)[:4].tolist()], "startTolerance": START_TOLERANCE,
        "fields": {name: {**_field(scene, name), **slider} for name, slider in SLIDERS.items()},
        "inertias": {name: _field(scene, name) for name in ("box_inertia", "jack_inertia")},
        "lesson": _lesson(), "tasks": {name: _task(name) for name in TASKS},
        "columns": ["time", *STATE_NAMES, "torque", "energy", "work", *entries.MEASURED],
        "halfWidth": scene.box_half_width, "timeScale": scene.box_half_width / scene.speed_scale,
        "speedScale": scene.speed_scale,
    }  # fmt: skip


def _field(scene: Scene, name: str) -> dict[str, Any]:
    """A field of the scene, with its bounds and the sentences that refuse values beyond them."""
    low, high, above = *BOUNDS[name], 1e61
    if name == "jack_arm":
        high, above = math.nextafter(math.sqrt(2.0) * scene.box_half_width, 0.0), 1e20
    return {
        "index": SceneNumbers._fields.index(name), "low": low, "high": high,
        "below": _refused(name, -1.0), "above": _refused(name, above),
    }  # fmt: skip


def _refused(name: str, value: float) -> str:
    """The sentence that refuses a value of a field, with {} for the value."""
    try:
        Scene.of({name: value})
    except ValueError as error:
        return str(error).replace(str(value), "{}")
    raise AssertionError(f"{name} = {value} is accepted")


def _lesson() -> list[dict[str, str]]:
    """The questions of docs/lesson.md: title, question and answer in HTML; their scenes are links."""
    question, answer = r"<!-- question (\d) -->\n(.*?)\n<details>", r"<!-- answer \2 -->\n(.*?)<!-- end \2 -->$"
    part = rf"^## (?:\d\. )?([^\n]+)\n\n{question}.*?{answer}"
    text = (ROOT / "docs" / "lesson.md").read_text(encoding="utf-8").replace("play.html#", "#")
    questions = re.findall(part, text, re.MULTILINE | re.DOTALL)
    return [{"title": title, "question": asked, "answer": answered} for title, _, asked, answered in questions]


def _task(name: str) -> dict[str, Any]:
    """A task's goal, what policies earn, and the trained network."""
    rows = json.loads((ROOT / "docs" / "benchmark.json").read_text())["policies"]
    earned = {
        row["policy"]: row["mean"]
        for row in rows
        if (row["task"], row["contact"], row["setting"]) == (name, "exact", "default")
    }
    return {
        "goal": GOALS[name], "earned": {label: earned[policy] for policy, label in COMPARED.items()},
        "agent": _agent(AGENTS / f"{name}-ppo"),
    }  # fmt: skip


def _agent(folder: Path) -> dict[str, Any]:
    """A trained network, with the number of control steps that its actions last."""
    settings = json.loads((folder / "settings.json").read_text())
    with np.load(folder / "weights.npz") as stored:
        layers = [stored[name] for name in stored.files]  # each layer's weight and bias
    if settings["observation"] == "state":  # the first numbers of "landing"
        layers[0] = np.pad(layers[0], ((0, 0), (0, entries.OBSERVED - layers[0].shape[1])))
    weights = np.concatenate([part.ravel() for part in layers])
    scale = float(abs(weights).max()) / 32767.0  # 16 bits a weight keep the page small
    hidden, outputs = layers[0].shape[0], ACTIONS[settings["action"]].size
    sizes = (entries.OBSERVED, hidden), (hidden, hidden), (hidden, outputs)
    expected = [shape for before, after in sizes for shape in ((after, before), (after,))]
    if settings["observation"] not in ("state", "landing") or [part.shape for part in layers] != expected:
        raise ValueError(f"the page's networks observe 'state' or 'landing' and have two hidden layers, got {folder}")
    longest, most = repeat_of(settings["action_repeat"], settings["control_dt"])
    return {
        "weights": base64_of(np.round(weights / scale), "<i2"), "scale": scale, "hidden": hidden, "outputs": outputs,
        "longest": longest, "max_contact_steps": most,
    }  # fmt: skip


@command_line
def main() -> None:
    """Build the page and print its path."""
    import tyro

    tyro.cli(lambda: None, description=__doc__)
    print(ensure_page())


if __name__ == "__main__":
    main()
