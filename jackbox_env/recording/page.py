"""A motion as one page of HTML: an animation, its impacts, and plots that follow its time.

The page is one file that any browser opens, without a network. Its parts are in the folder ``web``: ``page.html``
names the others, which are inserted there. The page interpolates between samples
(:mod:`jackbox_env.recording.samples`) by cubics through position and velocity; all physics is computed here.
"""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterable
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from jackbox_env.model.scene import Chirp, Scene
from jackbox_env.model.states import STATE_NAMES
from jackbox_env.recording.motion import Motion
from jackbox_env.recording.samples import Samples, samples_of
from jackbox_env.simulators.fidelity import Setting, explicit
from jackbox_env.tools import colours
from jackbox_env.tools.files import new_file

_MOST_LISTED = 2000  # impacts in the page's table: more would make a heavy page that nobody reads

Facts = list[tuple[str, str]]  # names, and values with their units


def model_facts(setting: Setting) -> Facts:
    """The contact model and its settings, in words."""
    contact, *settings = explicit(setting)._asdict().items()
    return [("contact model", contact[1]), *((name, str(value)) for name, value in settings if value is not None)]


def write_page(path: Path, motion: Motion, title: str, facts: Iterable[tuple[str, str]]) -> Path:
    """Write a motion as a page.

    Args:
        path: of the new file.
        motion: to show.
        title: the cause of the box's motion, in a few words.
        facts: rows above the scene's numbers.

    Raises:
        FileExistsError: there is something at ``path``.
    """
    data = _described(motion, samples_of(motion), title, [*facts, *_timing(motion), *_scene_facts(motion.scene)])
    with new_file(path) as partial:
        template = (files("jackbox_env.recording") / "web" / "page.html").read_text(encoding="utf-8")
        partial.write_text(assembled(template, data), encoding="utf-8")
    return path


def _described(motion: Motion, shown: Samples, title: str, facts: Facts) -> dict[str, Any]:
    """The page's data, for JSON."""
    scene, impacts = motion.scene, motion.impacts
    columns = np.column_stack([shown.times, shown.states, shown.torques, shown.energies, shown.work])
    return {
        "title": title,
        "facts": facts,
        "notes": _notes(motion),
        "halfWidth": scene.box_half_width,
        "arm": scene.jack_arm,
        "knock": 2.0 * scene.jack_mass * scene.speed_scale,  # the impulse of a hard impact [N s]
        "timeScale": scene.box_half_width / scene.speed_scale,  # of a fall across the box [s]
        "held": motion.torques is not None,
        "columns": ["time", *STATE_NAMES, "torque", "energy", "work"],
        "samples": base64_of(columns, "<f8"),
        "listed": _MOST_LISTED,
        "impacts": base64_of(impacts["time"], "<f8"),
        "impulses": base64_of(impacts["impulse"], "<f8"),
        "meetings": base64_of(4 * impacts["wall"] + impacts["foot"], "u1"),  # of a wall and a foot
    }


def base64_of(numbers: Any, kind: str) -> str:
    """Numbers as base64 of an array of this kind, numpy's name of it."""
    return base64.b64encode(np.asarray(numbers).astype(kind).tobytes()).decode()


def _notes(motion: Motion) -> list[str]:
    """Notes on this motion for the page's reader."""
    count = len(motion.impacts)
    notes = [
        "Wall 0 is on the right of a level box, 1 above, 2 on the left, 3 below. They keep their numbers as it turns."
    ]
    if count > _MOST_LISTED:
        listed = f"{_MOST_LISTED:,} of {count:,} impacts"
        notes.append(f"The table lists the first {listed}; the animation and the plots show all.")
    if not motion.scene.elastic and count:
        notes.append("A foot that rests on a wall is recorded as an impact in each step, by pymunk in each substep.")
    if motion.failure:
        notes.append(f"It ended early: {motion.failure}.")
    return notes


def _timing(motion: Motion) -> Facts:
    times = motion.t
    steps = max(1, len(times) - 1)
    return [
        ("time", f"{times[0]:g} s to {times[-1]:g} s"),
        ("time step", f"{(times[-1] - times[0]) / steps:.4g} s"),
        ("impacts", f"{motion.impact_count:,}"),
    ]


def _scene_facts(scene: Scene) -> Facts:
    drive = scene.drive
    if isinstance(drive, Chirp):
        moved = f"chirp, {drive.amplitude:g} N m, from {drive.start_frequency:g} Hz by {drive.rate:g} Hz/s"
    else:
        moved = "none" if drive is None else "functions of time"
    return [
        ("box half width L", f"{scene.box_half_width:g} m"),
        ("box mass", f"{scene.box_mass:g} kg"),
        ("box inertia", f"{scene.box_inertia:g} kg m\u00b2"),
        ("jack arm l", f"{scene.jack_arm:g} m"),
        ("jack mass", f"{scene.jack_mass:g} kg"),
        ("jack inertia", f"{scene.jack_inertia:g} kg m\u00b2"),
        ("gravity", f"{scene.gravity:g} m/s\u00b2"),
        ("restitution", f"{scene.restitution:g}"),
        ("torque limit", f"{scene.torque_limit:g} N m"),
        ("drive", moved),
    ]


def assembled(template: str, data: dict[str, Any], **parts: str) -> str:
    """A page: a template with its ``{{parts}}``, which are ``parts`` or files of the folder ``web``, and its data."""
    # "<" would let a title end the script that the data stands in.
    text = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    values = {"data": text, "colours": _colours(), **parts}

    def part(match: re.Match[str]) -> str:
        name = match[1]
        return values.get(name) or (files("jackbox_env.recording") / "web" / name).read_text(encoding="utf-8").strip()

    return re.sub(r"\{\{([\w.]+)\}\}", part, template)


def _colours() -> str:
    """The colours that the page shares with frames and plots, as properties of its style."""
    shared = {"box": colours.WALL, "jack": colours.JACK, "foot": colours.FIRST_FOOT, "torque": colours.TORQUE}
    return " ".join(f"--{name}: {colours.hexed(colour)};" for name, colour in shared.items())
