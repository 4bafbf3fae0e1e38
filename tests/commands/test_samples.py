"""Samples between the stored states: on the path of the model, with a corner at each impact."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jackbox_env import Chirp, Drive, Scene
from jackbox_env.recording.motion import Motion
from jackbox_env.recording.page import write_page
from jackbox_env.recording.samples import SPACING, samples_of
from jackbox_env.recording.simulation import recorded
from jackbox_env.simulators import Impact
from jackbox_env.simulators.fidelity import resolve


def run(scene: Scene, seconds: float = 3.0, dt: float = 0.02, **model: Any) -> Motion:
    return recorded(scene, resolve(**model), [0.0] * 12, 0.0, seconds, dt, None)


@pytest.mark.parametrize(
    ("scene", "seconds", "dt"),
    [
        (Scene(), 3.0, 0.02),
        (Scene(restitution=0.9), 10.0, 5.0),  # many impacts in a step
        (Scene(restitution=0.8), 5.0, 0.02),
        (Scene(restitution=0.2, drive=Chirp(3000.0, 0.5, 0.0)), 8.0, 0.02),  # comes to rest
    ],
)
def test_samples_are_states_of_the_motion_with_a_corner_at_each_impact(scene: Scene, seconds: float, dt: float) -> None:
    motion = run(scene, seconds, dt, contact="exact")
    samples, jumps = samples_of(motion), motion.impacts[~motion.impacts["resting"]]
    for hit in jumps[:5]:
        index = np.searchsorted(samples.times, hit["time"] - 1e-12)
        np.testing.assert_allclose(samples.states[index], hit["before"], rtol=0.0, atol=1e-9)
        assert (np.abs(samples.states[index:] - hit["after"]).max(axis=1) < 1e-9).any()
    plain = ~np.isin(samples.times, motion.impacts["time"])
    np.testing.assert_allclose(samples.states[plain], motion(samples.times[plain]), rtol=0.0, atol=1e-5)
    assert np.diff(samples.times).max() < max(SPACING, 0.02) + 1e-12
    np.testing.assert_array_equal(samples.work, motion.work(samples.times))
    lost = np.diff(samples.work - samples.energies)
    assert lost.min() > -1e-5
    assert (lost.max() > 1.0) == (scene.restitution < 1.0)


def test_pymunks_samples_are_its_stored_states_with_the_work_of_its_torque() -> None:
    motion = run(Scene(), contact="pymunk")
    samples = samples_of(motion)
    np.testing.assert_array_equal(samples.times, motion.t)
    np.testing.assert_array_equal(samples.states, motion.states)
    assert motion.impact_count > 0
    np.testing.assert_allclose(samples.energies - samples.energies[0], samples.work, rtol=1e-4)


def test_held_torques_are_shown_as_they_were_held() -> None:
    torques = np.array([50000.0, -30000.0, 10000.0])
    samples = samples_of(recorded(Scene(), resolve("exact"), [0.0] * 12, 0.0, 0.06, 0.02, torques))
    np.testing.assert_allclose(samples.torques[1:], np.repeat(torques, 4), rtol=1e-15)
    np.testing.assert_allclose(samples.energies, samples.work, atol=1e-9)


# -- the page as a file ------------------------------------------------------------------------------------------------


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
    motion = run(Scene(), 10.0, contact="exact")
    page = write_page(tmp_path / "page.html", motion, "a test", [("contact model", "exact")])
    data = data_of(page)
    columns = np.frombuffer(base64.b64decode(data["samples"]), "<f8").reshape(-1, len(data["columns"]))
    last = np.searchsorted(columns[:, 0], motion.t, side="right") - 1  # of the samples at each time
    np.testing.assert_array_equal(columns[last, :13], np.column_stack([motion.t, motion.states]))
    assert impacts_of(data) == motion.hits
    facts = dict(data["facts"])
    assert (facts["contact model"], facts["time"], facts["time step"]) == ("exact", "0 s to 10 s", "0.02 s")
    assert (facts["box half width L"], facts["jack mass"], facts["restitution"]) == ("6 m", "4 kg", "1")
    assert page.stat().st_size < 2_000_000
    assert "{{" not in page.read_text()
    assert not re.search(r"https?:|//\w+\.\w", page.read_text())  # nothing is fetched from elsewhere
    with pytest.raises(FileExistsError):
        write_page(page, motion, "a test", [])


@pytest.mark.parametrize(
    "scene",
    [
        Scene(gravity=0.0, jack_arm=2.0, drive=Drive(force_x=lambda t: 240000.0 * np.cos(2.0 * np.pi * t))),
        Scene(box_half_width=0.1, box_mass=1.0, jack_arm=0.02, jack_mass=0.01, drive=None),
        Scene(restitution=0.0),
    ],
)
def test_other_scenes_have_pages_too(tmp_path: Path, scene: Scene) -> None:
    data = data_of(write_page(tmp_path / "page.html", run(scene, 1.0, contact="exact"), "a test", []))
    assert data["halfWidth"] == scene.box_half_width
    assert dict(data["facts"])["drive"] in ("functions of time", "none", "chirp, 90000 N m, from 0.5 Hz by 0.9 Hz/s")
