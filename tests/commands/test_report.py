"""The page as a file: small, written fast, complete."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jackbox_env import Drive, Scene, make_simulator
from jackbox_env.recording.page import write_page
from jackbox_env.recording.trajectory import Trajectory, simulate
from jackbox_env.simulators import Impact


def run(scene: Scene, seconds: float, dt: float = 0.02) -> Trajectory:
    simulator = make_simulator(scene, contact="exact")
    simulator.reset([0.0] * 12)
    return simulate(simulator, seconds, dt, progress=False)


def data_of(page: Path) -> dict[str, Any]:
    match = re.search(r'id="data">(.*?)</script>', page.read_text(), re.DOTALL)
    assert match is not None
    data: dict[str, Any] = json.loads(match[1])
    return data


def impacts_of(data: dict[str, Any]) -> list[Impact]:
    times, impulses, meetings = (
        np.frombuffer(base64.b64decode(data[name]), kind).tolist()
        for name, kind in (("impacts", "<f8"), ("impulses", "<f8"), ("meetings", "u1"))
    )
    return [
        Impact(moment, meeting // 4, meeting % 4, impulse)
        for moment, meeting, impulse in zip(times, meetings, impulses, strict=True)
    ]


def test_the_page_has_every_stored_state_to_the_last_bit_and_nothing_from_elsewhere(tmp_path: Path) -> None:
    trajectory = run(Scene(), 10.0)
    page = write_page(tmp_path / "page.html", Scene(), trajectory, "a test", [("contact model", "exact")])
    data = data_of(page)
    columns = np.frombuffer(base64.b64decode(data["samples"]), "<f8").reshape(-1, len(data["columns"]))
    last = np.searchsorted(columns[:, 0], trajectory.times, side="right") - 1  # of the samples at each time
    np.testing.assert_array_equal(columns[last, :13], np.column_stack([trajectory.times, trajectory.states]))
    assert impacts_of(data) == trajectory.impacts
    facts = dict(data["facts"])
    assert (facts["contact model"], facts["time"], facts["time step"]) == ("exact", "0 s to 10 s", "0.02 s")
    assert (facts["box half width L"], facts["jack mass"], facts["restitution"]) == ("6 m", "4 kg", "1")
    assert page.stat().st_size < 2_000_000
    assert "{{" not in page.read_text()
    assert not re.search(r"https?:|//\w+\.\w", page.read_text())  # nothing is fetched from elsewhere
    with pytest.raises(FileExistsError):
        write_page(page, Scene(), trajectory, "a test", [])


def test_a_page_of_very_many_impacts_lists_the_first_and_notes_it(tmp_path: Path) -> None:
    scene = Scene(restitution=0.2, drive=None)
    trajectory = run(scene, 60.0, 0.005)
    page = write_page(tmp_path / "page.html", scene, trajectory, "a test", [])
    data = data_of(page)
    names, listed, _ = data["notes"]
    assert "Wall 0 is on the right" in names
    assert f"2,000 of {len(trajectory.impacts):,} " in listed
    assert impacts_of(data) == trajectory.impacts


@pytest.mark.parametrize(
    "scene",
    [
        Scene(gravity=0.0, jack_arm=2.0, drive=Drive(force_x=lambda t: 240000.0 * np.cos(2.0 * np.pi * t))),
        Scene(box_half_width=0.1, box_mass=1.0, jack_arm=0.02, jack_mass=0.01, drive=None),
        Scene(restitution=0.0),
    ],
)
def test_other_scenes_have_pages_too(tmp_path: Path, scene: Scene) -> None:
    data = data_of(write_page(tmp_path / "page.html", scene, run(scene, 1.0), "a test", []))
    assert data["halfWidth"] == scene.box_half_width
    assert dict(data["facts"])["drive"] in ("functions of time", "none", "chirp, 90000 N m, from 0.5 Hz by 0.9 Hz/s")
