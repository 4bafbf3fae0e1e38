"""Motions: states at any time against 60 digits, restarts, events, energy and work, files."""

from __future__ import annotations

import csv
import json
import math
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import jackbox_env
import jackbox_env.recording.recorder
from jackbox_env import Chirp, Drive, Impact, Motion, Scene, State, make_simulator, rollout, simulate
from jackbox_env.mechanics import gaps, simultaneous_impact_map
from jackbox_env.simulators import CONTACT_MODELS
from tests.states import at, inside, load, lying

RECORDS = [*load("exact_trajectories"), *load("loss_trajectories"), *load("seed_scene")]
CASES = json.loads((Path(__file__).parents[2] / "docs" / "reference" / "cases.json").read_text())["cases"]


def arguments_of(reference: dict[str, Any], dt: float) -> dict[str, Any]:
    """Those of a 60-digit trajectory; each held action, of 0.02 s, lasts for whole steps of ``dt``."""
    drive = Chirp() if reference["drive"] == "chirp" else None
    scene = Scene(gravity=reference["gravity"], restitution=reference.get("restitution", 1.0), drive=drive)
    torque = None
    if reference["drive"] == "held":
        torque = np.repeat(90000.0 * np.array(reference["actions"]), round(0.02 / dt))[: round(reference["T"] / dt)]
    start = reference["q"] + reference["qdot"]
    return {"scene": scene, "state": start, "duration": float(reference["T"]), "torque": torque, "dt": dt}


# -- states at any time ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("reference", RECORDS, ids=lambda reference: reference["name"])
def test_states_at_times_between_steps_and_at_impacts_equal_60_digits(reference: dict[str, Any]) -> None:
    dt = 0.004 if reference["drive"] == "held" else 0.07
    motion = simulate(**arguments_of(reference, dt))
    times = np.array([one["time"] for one in reference["states"]])
    expected, impacts = np.array([one["state"] for one in reference["states"]]), reference["impacts"]
    few = times < (impacts[5]["time"] if len(impacts) > 5 else math.inf)  # chaos grows with impacts
    errors = np.abs(motion(times) - expected)[few].max(axis=1)
    assert few.sum() > 9
    assert errors.max() < 1e-8
    free = times[few] < (impacts[0]["time"] if impacts else math.inf)
    assert errors[free].max() < 1e-12
    for hit, known in list(zip(motion.impacts, impacts, strict=False))[:5]:
        assert (hit["wall"], hit["foot"]) == (known["wall"], known["foot"])
        assert hit["time"] == pytest.approx(known["time"], abs=1e-10, rel=0.0)
        assert abs(gaps(motion.scene, hit["before"])[hit["wall"], hit["foot"]]) < 1e-12
        after, _ = simultaneous_impact_map(motion.scene, hit["before"], [(hit["wall"], hit["foot"])])
        np.testing.assert_allclose(hit["after"], after, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(
    "keywords",
    [
        {}, {"torque": 0.0}, {"torque": lambda t: 9e4 * math.sin(3.0 * t)}, {"dt": 0.5}, {"time": 40.0},
        {"scene": Scene(drive=Drive(force_x=lambda t: 3e5 * math.cos(5.0 * t))), "torque": 3e4, "dt": 0.3},
        {"scene": {"restitution": 0.5}, "duration": 5.0},
    ],
)  # fmt: skip
def test_flights_end_where_the_engine_arrives(keywords: dict[str, Any]) -> None:
    motion = simulate(**keywords)
    assert len(motion.impacts) > 4
    times = motion.impacts["time"]
    np.testing.assert_array_equal(motion(times)[-1], motion.impacts["after"][-1])
    np.testing.assert_array_equal(motion(times, side="before")[0], motion.impacts["before"][0])
    np.testing.assert_array_equal(motion(motion.t), motion.states)
    early = np.nextafter(times, -math.inf)
    np.testing.assert_allclose(motion(early), motion.impacts["before"], rtol=0.0, atol=1e-11)
    assert motion(times.reshape(1, -1)).shape == (1, len(times), 12)
    fine = simulate(**{**keywords, "dt": keywords.get("dt", 0.02) / 8.0})
    between = np.random.default_rng(0).uniform(motion.t[0], times[3], 50)
    np.testing.assert_allclose(motion(between), fine(between), rtol=0.0, atol=1e-9)


def test_at_rest_the_jack_stays_on_its_feet_at_any_time() -> None:
    scene = Scene(restitution=0.5, drive=Chirp(2000.0, 0.3, 0.0))
    motion = simulate(scene, lying(), 1.5, dt=0.25)
    times = np.random.default_rng(0).uniform(0.5, 1.5, 12)
    floor = [gaps(scene, state)[3] for state in motion(times)]
    assert np.abs(np.sort(np.abs(floor), axis=1)[:, :2]).max() < 1e-12  # two feet on the floor
    fine = simulate(scene, lying(), 1.5, dt=0.002)
    np.testing.assert_allclose(motion(times), fine(times), rtol=0.0, atol=1e-11)
    rows = motion.impacts
    assert (rows["before"] == rows["after"]).all()
    np.testing.assert_allclose(rows["before"][-1], motion.states[-1])


def test_without_the_engines_rest_a_foot_at_rest_would_fall(monkeypatch: pytest.MonkeyPatch) -> None:
    motion = simulate(Scene(restitution=0.5, drive=None), lying(), 1.0, dt=0.25)
    height = motion.states[0, 4]
    assert abs(np.diff(motion(0.6)[[1, 4]]) - height) < 1e-12
    monkeypatch.setitem(vars(motion._record), "knots", motion._record.knots._replace(held=np.zeros(5, np.bool_)))
    assert np.diff(motion(0.6)[[1, 4]]) < height - 0.04


# -- energy and work ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("restitution", [1.0, 0.6])
def test_energy_is_the_work_less_what_impacts_dissipate(restitution: float) -> None:
    motion = simulate(Scene(restitution=restitution), duration=8.0)
    times = np.linspace(0.0, 8.0, 333)
    jumps = motion.impacts[(motion.impacts["before"] != motion.impacts["after"]).any(axis=1)]
    jumps = jumps[np.unique(jumps["time"], return_index=True)[1]]
    lost = motion.energy(jumps["time"], "before") - motion.energy(jumps["time"])
    assert (lost.max() > 10.0) == (restitution < 1.0)
    gained = motion.energy(times) - motion.energy(0.0)
    dissipated = [lost[jumps["time"] <= time].sum() for time in times]
    assert np.ptp(motion.work(times)) > 1e4
    np.testing.assert_allclose(gained, motion.work(times) - dissipated, rtol=0.0, atol=1e-6)
    assert motion.work()[0] == 0.0


@pytest.mark.parametrize("restitution", [1.0, 0.5])
def test_impacts_of_several_feet_have_no_part_in_work(restitution: float, cases: Callable[[int], int]) -> None:
    rng, times = np.random.default_rng(5), np.linspace(0.0, 4.0, 99)
    scene = Scene(restitution=restitution, box_mass=30.0)
    for _ in range(cases(20)):
        start = at(theta_jack=math.pi / 4.0)  # two feet come down together
        start[[9, 10]] = rng.uniform(-3.0, 3.0, 2)
        free = simulate(scene, start, 4.0, torque=0.0)
        assert free.impacts["time"][0] == free.impacts["time"][1]
        np.testing.assert_allclose(free.work(times), 0.0, rtol=0.0, atol=1e-9)
        if restitution == 1.0:
            turned = simulate(scene, start, 2.0, torque=lambda t: 0.0 if t < 1.6 else 10.0)
            np.testing.assert_allclose(turned.energy() - turned.energy(0.0), turned.work(), rtol=0.0, atol=1e-9)


# -- restarts ----------------------------------------------------------------------------------------------------------


def drawn(rng: np.random.Generator) -> Motion:
    """A random motion of 2 s with impacts: elastic or with loss, under the chirp, held torques or none."""
    scene = Scene(restitution=float(rng.choice([1.0, 0.8, 0.3])), gravity=float(rng.choice([0.0, 9.81])))
    torque = [None, 0.0, rng.uniform(-9e4, 9e4, 40)][rng.integers(3)]
    start = lying(along=float(rng.uniform(-3.0, 3.0))) if scene.restitution < 0.5 else inside(scene, rng)
    return simulate(scene, start, 2.0, torque=torque, time=float(rng.uniform(0.0, 5.0)), dt=0.05)


def test_a_restart_has_the_same_bits(cases: Callable[[int], int]) -> None:
    rng, resting = np.random.default_rng(3), 0
    for _ in range(cases(1000)):
        motion = drawn(rng)
        if not len(motion.impacts):
            continue
        k = int(rng.integers(len(motion.impacts)))
        again, hit = motion.restart(k), motion.impacts[k]
        resting += (hit["before"] == hit["after"]).all()
        count = len(again.t) - 1
        assert again.t[0] == hit["time"]
        np.testing.assert_array_equal(again.states[0], hit["after"])
        assert (again.t[1:] == motion.t[len(motion.t) - count :]).all()
        assert (again.states[1:] == motion.states[len(motion.t) - count :]).all()
        assert (again.impacts == motion.impacts[len(motion.impacts) - len(again.impacts) :]).all()
        later = motion.impacts["time"] > hit["time"]
        assert later.sum() <= len(again.impacts) < len(motion.impacts)
    assert resting > 10


@pytest.mark.parametrize("dt", [0.02, 0.003, 1e-4])
def test_a_restart_goes_to_the_nominal_end(dt: float) -> None:
    whole = simulate(torque=np.full(math.ceil(4.0 / dt - 1e-6), 3e4), duration=4.0, dt=dt)
    for one in (whole, whole.restart(0), whole.restart(-1)):
        np.testing.assert_array_equal(one.states[-1], whole.states[-1])
        np.testing.assert_allclose(one(4.0), one.states[-1], rtol=0.0, atol=1e-8)


# -- events ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", [case for case in CASES if case["impacts"]], ids=lambda case: case["name"])
def test_impacts_that_end_a_motion_are_the_proven_ones(case: dict[str, Any]) -> None:
    kind, torque = case["torque"]["kind"], case["torque"].get("values", 0.0)
    drive = None
    if kind == "chirp":
        drive, torque = Chirp(*[case["torque"][name] for name in ("amplitude", "start_frequency", "rate")]), None
    scene = Scene.of({**case["scene"], "drive": drive})
    keywords = {"duration": case["duration"], "torque": torque, "dt": case["dt"]}
    known = [float(hit["time"]) for hit in case["impacts"]]
    close = 2e-12 if case["name"] == "graze-hits" else 1e-13  # 2e-9 m deep: rounding of the gap moves the moment
    first = simulate(scene, case["start"], until="impact", **keywords)
    assert first.t[-1] == first.impacts["time"][-1]
    assert first.t[-1] == pytest.approx(known[0], abs=close, rel=0.0)
    np.testing.assert_array_equal(first.states[-1], first.impacts["after"][-1])
    whole = simulate(scene, case["start"], **keywords)
    for count in range(2, min(len(known), 6)):
        until = simulate(scene, case["start"], until=count, **keywords)
        assert until.t[-1] == whole.impacts["time"][count - 1]  # as rollout and step have it
        assert until.t[-1] == pytest.approx(known[count - 1], abs=1e-9, rel=0.0)


@pytest.mark.parametrize("dt", [0.02, 0.5])
def test_a_function_ends_a_motion_where_its_sign_changes(dt: float) -> None:
    def height(state: State) -> float:
        return state.y_jack + 2.0

    top = simulate({"drive": None}, duration=60.0, until=height, dt=dt)
    assert top.t[-1] == pytest.approx(math.sqrt(4.0 / 9.81), abs=1e-14)
    assert top.states[-1, 4] == pytest.approx(-2.0, abs=1e-14)
    rising = simulate({"drive": None}, top.states[-1], 60.0, time=float(top.t[-1]), until=lambda s: s.vy_jack, dt=dt)
    assert rising.t[-1] == rising.impacts["time"][0]  # an impact changes the sign
    assert rising.states[-1, 10] > 0.0
    turning = simulate({"drive": None}, rising.states[-1], 60.0, until=lambda s: s.vy_jack, dt=dt)
    assert turning.t[-1] == pytest.approx(rising.states[-1, 10] / 9.81, abs=1e-13)
    assert len(simulate(duration=3.0, until=lambda state: 0.0, dt=dt).t) == 1 + math.ceil(3.0 / dt)


def test_a_foot_at_rest_is_no_impact_that_ends_a_motion() -> None:
    motion = simulate(Scene(restitution=0.5, drive=None), lying(), 1.0, until="impact")
    assert motion.t[-1] == pytest.approx(1.0)
    assert len(motion.impacts) == 100  # its weight, on two feet in each step
    assert motion.impacts["resting"].all()
    assert repr(motion) == "Motion(t from 0 to 1 s, 51 states, 0 impacts, dt = 0.02 s)"
    both = simulate(Scene(restitution=0.5, drive=None), duration=8.0)
    jumps = (both.impacts["before"] != both.impacts["after"]).any(axis=1)
    np.testing.assert_array_equal(both.impacts["resting"], ~jumps)
    assert 0 < both.impact_count < len(both.impacts)


FAILING: dict[str, Any] = {
    "array": np.where(np.arange(100) == 55, 1e300, 0.0),
    "function": lambda t: 0.0 if t < 1.1 else 1.0 / 0.0,
    "no number": lambda t: 0.0 if t < 1.1 else math.nan,
}  # fmt: skip


@pytest.mark.parametrize("torque", FAILING.values(), ids=FAILING)
def test_a_failure_after_the_event_is_none(torque: Any) -> None:
    motion = simulate(duration=2.0, torque=torque, until=1)
    assert motion.t[-1] == motion.impacts["time"][0] == simulate(torque=0.0, until=1).t[-1]
    assert motion.failure is None
    assert simulate(duration=2.0, torque=torque, until=lambda s: s.vy_jack + 9.0).t[-1] == pytest.approx(9.0 / 9.81)
    for late in (2, lambda s: s.vy_jack + 20.0, None):
        with pytest.raises((jackbox_env.JackLostError, ZeroDivisionError, ValueError), match="t = 1.1|division|nan"):
            simulate(duration=2.0, torque=torque, until=late)


def test_the_first_state_is_the_start_and_an_impact_there_is_in_the_motion() -> None:
    begun = simulate({"drive": None}, duration=2.0)
    start = begun.impacts["before"][0]
    for until in (None, 1, "impact"):
        motion = simulate({"drive": None}, start, 1.0, until=until)
        assert motion.impacts["time"][0] == 0.0
        np.testing.assert_array_equal(motion.states[0], start)
        np.testing.assert_array_equal(motion(0.0), motion.impacts["after"][0])
        np.testing.assert_array_equal(motion(0.0, "before"), start)


# -- the rest of the interface -----------------------------------------------------------------------------------------


def test_a_duration_that_is_no_multiple_of_dt_ends_with_a_shorter_step() -> None:
    motion = simulate(duration=0.05)
    np.testing.assert_allclose(motion.t, [0.0, 0.02, 0.04, 0.05])
    np.testing.assert_allclose(motion.states[-1], simulate(duration=0.05, dt=0.05).states[-1], rtol=0.0, atol=1e-14)
    assert len(simulate(duration=0.3, dt=0.1).t) == 4
    assert simulate(duration=0.01).t.tolist() == [0.0, 0.01]
    assert simulate(duration=1e-9).t.tolist() == [0.0, 1e-9]
    assert simulate(duration=1e-9, fidelity="balanced", torque=[3.0]).t.tolist() == [0.0, 1e-9]


def test_a_pickled_motion_is_small() -> None:
    motion = simulate({"drive": None}, duration=1.1, torque=0.0)
    assert len(pickle.dumps(motion)) < 30_000
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(motion)).restart(0).t, motion.restart(0).t)
    assert len(pickle.dumps(simulate(duration=1e5, torque=0.0, until=1))) < 100_000


def test_torques_are_numbers_functions_or_one_for_each_step() -> None:
    torques = np.random.default_rng(0).uniform(-9e4, 9e4, 100)
    by_rollout = rollout(None, np.zeros(12), torques, 0.02)[0]
    np.testing.assert_array_equal(simulate(duration=2.0, torque=torques).states, by_rollout)
    constant, function = simulate(duration=2.0, torque=5e4), simulate(duration=2.0, torque=lambda t: 5e4)
    np.testing.assert_allclose(constant.states, function.states, rtol=0.0, atol=1e-10)
    assert constant.torques is not None
    assert constant.torques.tolist() == [5e4] * 100
    assert function.torques is None
    np.testing.assert_allclose(function.mean_torques, 5e4)


@pytest.mark.parametrize("contact", CONTACT_MODELS)
def test_a_controller_sets_the_torque_of_each_step_from_its_time_and_state(contact: str) -> None:
    def level(time: float, state: State) -> float:
        return time - 9e4 * state.theta_box - state[8]

    fidelity = "exact" if contact == "exact" else "balanced"
    start, simulator = {"theta_box": 0.2, "vx_jack": 3.0}, make_simulator(fidelity=fidelity)
    motion = simulate(None, start, 3.01, torque=level, time=5.0, fidelity=fidelity)
    simulator.reset([start.get(name, 0.0) for name in State._fields], 5.0)
    assert motion.torques is not None
    hits = list[Impact]()
    for number, torque in enumerate(motion.torques.tolist()):
        assert torque == level(simulator.time, State(*simulator.state.tolist()))
        simulator.step(0.02 if number < 150 else motion._record.rest, torque)
        np.testing.assert_array_equal(motion.states[number + 1], simulator.state)
        hits += simulator.impacts
    assert motion.hits == hits != []
    if contact == "exact":
        np.testing.assert_array_equal(motion.restart(0).states[-1], motion.states[-1])
        assert simulate(None, start, 3.0, torque=level, time=5.0, until=1).t[-1] == motion.impacts["time"][0]


# -- files -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fidelity", ["exact", "balanced"])
def test_files_have_the_motion(tmp_path: Path, fidelity: str) -> None:
    motion = simulate(duration=3.0, fidelity=fidelity)
    scipy = pytest.importorskip("scipy.io")
    (npz,), (mat,), tables = (motion.save(tmp_path / f"run{suffix}") for suffix in (".npz", ".mat", ".csv"))
    matlab = scipy.loadmat(mat, squeeze_me=True)
    with np.load(npz) as arrays:
        np.testing.assert_array_equal(arrays["state"], motion.states)
        assert Scene.of(json.loads(str(arrays["scene"]))) == motion.scene
        for name in arrays:
            np.testing.assert_array_equal(matlab[name], arrays[name])
    assert [path.name for path in tables] == ["run.csv", "run_impacts.csv"]
    states, impacts = (list(csv.DictReader(path.read_text().splitlines())) for path in tables)
    assert [float(row["y_jack [m]"]) for row in states] == motion.states[:, 4].tolist()
    assert states[-1]["torque [N m]"] == ""
    torques = [float(row["torque [N m]"]) for row in states[:-1]]
    assert torques == matlab["torque"].tolist()
    means = [0.5 * sum(Chirp().torque_means(0.02 * step, 0.02)) for step in range(150)]
    np.testing.assert_allclose(torques, means, rtol=1e-6)
    assert [float(row["time [s]"]) for row in impacts] == motion.impacts["time"].tolist()
    if fidelity == "exact":
        after = [float(row["after omega_jack [rad/s]"]) for row in impacts]
        assert after == motion.impacts["after"][:, 11].tolist()


def test_a_frame_has_names_without_units_and_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    motion = simulate(duration=2.0)
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=dict))
    hits = motion.to_frame("impacts")
    np.testing.assert_array_equal(hits["after omega_jack"], motion.impacts["after"][:, 11])
    frame = motion.to_frame()
    assert list(frame) == ["time", *State._fields, "torque"]
    np.testing.assert_array_equal(frame["y_jack"], motion.states[:, 4])
    with pytest.raises(ValueError, match="table must be one of 'states', 'impacts', got 'torques'"):
        motion.to_frame("torques")  # type: ignore[arg-type]
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match="to_frame needs pandas, the extra 'all'"):
        motion.to_frame()
    monkeypatch.setitem(sys.modules, "scipy.io", None)
    with pytest.raises(ImportError, match=".mat files needs SciPy, the extra 'train'"):
        motion.save("run.mat")


def test_a_motion_of_a_function_is_saved_without_its_scene(tmp_path: Path) -> None:
    (path,) = simulate(duration=0.1, torque=math.sin).save(tmp_path / "run.npz")
    with np.load(path) as arrays:
        assert "scene" not in arrays
