"""The fits of docs/fitting.md of a made-up camera: what is printed, how often it is right, seconds and memory.

The file has names of its own, mm, degrees, y downwards, angles that wrap and one dropped frame in fifty.
"""

from __future__ import annotations

import csv
import json
import resource
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from jackbox_env import Recording, Scene, fit
from jackbox_env.model.states import OMEGA_BOX, RATES, STATE_NAMES, THETA_BOX, Array
from jackbox_env.model.tasks import sample_start
from jackbox_env.tools.command_line import ROOT
from scripts.studies.fitting.measured import followed

FILE = Path("docs", "cam.csv")  # of the page's example
TRUE = {"jack_mass": 4.6, "restitution": 0.9}
START = {"jack_mass": 4.0, "restitution": 0.95}  # where the fits of long recordings begin
HEADERS = ("box_x [mm]", "box_y [mm]", "box_angle [deg]", "ball_x [mm]", "ball_y [mm]", "ball_angle [deg]")
COLUMNS = ",".join(
    ["time=t", *(f"{n}={h.partition(' ')[0]}" for n, h in zip(STATE_NAMES[:RATES], HEADERS, strict=True))]
)
OPTIONS = ("--columns", COLUMNS, "--y-down")
_NOISE = np.array([5e-3, 5e-3, 1e-3, 5e-3, 5e-3, 5e-3])  # [m] and [rad]
_DROPPED = 50  # frames, one of which is lost


def observed(scene: Scene, rate: float, seconds: float, seed: int) -> tuple[Array, Array]:
    """Positions with noise, NaN in dropped frames, (H + 1, 6), and the torques of a motor, (H,); a drive goes before.

    The motor's torque is held for half a second, and keeps the box from spinning.
    """
    rng, steps = np.random.default_rng(seed), round(seconds * rate)

    def motor(state: Array) -> float:
        back = scene.box_inertia * (state[OMEGA_BOX] + state[THETA_BOX])
        return float(rng.uniform(-5e4, 5e4) - back)

    states, torques = followed(scene, sample_start(scene, rng), rate, steps, motor)
    seen: Array = states[:, :RATES] + _NOISE * rng.standard_normal((steps + 1, RATES))
    seen[rng.choice(np.arange(1, steps), steps // _DROPPED, replace=False)] = np.nan
    return seen, torques


def write_camera_file(path: Path, rate: float = 60.0, seconds: float = 10.0, seed: int = 0) -> Scene:
    """Write what a camera with this many frames a second sees of the scene under its drive; return the scene."""
    scene = Scene.of(TRUE)
    seen, _ = observed(scene, rate, seconds, seed)
    seen = seen * np.array([1e3, -1e3, -np.rad2deg(1.0)] * 2)
    seen[:, 2::3] = (seen[:, 2::3] + 180.0) % 360.0 - 180.0
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["t [ms]", *HEADERS, "frame"])
        for frame in np.flatnonzero(np.isfinite(seen[:, 0])):
            writer.writerow([f"{1e3 * frame / rate:.1f}", *(f"{value:.2f}" for value in seen[frame]), frame])
    return scene


def fitted_files(rate: float, count: int) -> dict[str, float]:
    """Fit files by the reader of ``jackbox fit``: how many converge, and how many of those intervals have the mass."""
    from jackbox_env.commands.fit import column_names, read_recording

    converged = right = 0
    for seed in range(count):
        with TemporaryDirectory() as folder:
            write_camera_file(Path(folder, "cam.csv"), rate, seed=seed)
            recording = read_recording(Path(folder, "cam.csv"), Scene(), None, column_names(COLUMNS), y_down=True)
        result = fit(recording, ("jack_mass", "restitution"))
        low, high = result.intervals["jack_mass"]
        converged += result.converged
        right += result.converged and low <= TRUE["jack_mass"] <= high
    return {"rate": rate, "count": count, "converged": converged, "right": right}


def fitted_long(seconds: float) -> dict[str, float]:
    """Fit a long recording in this process: seconds of the processor, memory, the interval, whether it has the mass."""
    scene = Scene.of({**TRUE, "drive": None})
    seen, torques = observed(scene, 60.0, seconds, seed=1)
    states = np.full((len(seen), 12), np.nan)
    states[:, :RATES] = seen
    fit(Recording(states[:60], torques[:59], 1.0 / 60.0), ("jack_mass",), scene)  # loads what is compiled
    began = time.process_time()
    result = fit(Recording(states, torques, 1.0 / 60.0), ("jack_mass", "restitution"), scene.changed(**START))
    low, high = result.intervals["jack_mass"]
    return {
        "length": seconds, "seconds": time.process_time() - began, "width": high - low, "converged": result.converged,
        "contains": low <= TRUE["jack_mass"] <= high, "left_out": result.left_out,
        "mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }  # fmt: skip


def fitted_alone(seconds: float) -> dict[str, float]:
    """:func:`fitted_long` in a process of its own, whose memory counts."""
    code = f"import json; from {__name__} import fitted_long; print(json.dumps(fitted_long({seconds})))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    result: dict[str, float] = json.loads(done.stdout)
    return result


def printed() -> str:
    """The output of the command for the page's file, but for its progress."""
    write_camera_file(ROOT / FILE)
    command = [sys.executable, "-m", "jackbox_env", "fit", FILE.as_posix(), *OPTIONS]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    notes = [line for line in done.stderr.splitlines() if line.startswith(FILE.as_posix())]
    return "\n".join([*notes, *done.stdout.splitlines()])
