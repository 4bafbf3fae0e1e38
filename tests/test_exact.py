"""The exact contact model against 60-digit data, the impact law, and searches that miss what it finds.

The model is plain Python that is compiled: negative controls replace one of its functions and run it uncompiled.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import mpmath as mp
import numpy as np
import pytest

from jackbox_env.compiled import impacts, step
from jackbox_env.compiled import search as kernel
from jackbox_env.compiled.compiler import compiled
from jackbox_env.compiled.status import Status
from jackbox_env.compiled.workspace import GRADIENTS, HITS, IMPULSES, RECORD, STATE, TALLY, new_workspace
from jackbox_env.mechanics import energy, impact_map, simultaneous_impact_map
from jackbox_env.planning import rollout
from jackbox_env.scene import Chirp, Drive, Scene
from jackbox_env.simulators import Impact, exact, functions
from jackbox_env.simulators.exact import ExactSimulator, drive_kind, pieces_for
from jackbox_env.states import clearance
from jackbox_env.tasks import sample_start
from jackbox_env.vector_env import JackInBoxVectorEnv
from scripts.studies.speed import naive
from tests.closed_forms import chirp_motion_by_fresnel
from tests.states import Array, inside, load, one_foot_on_wall, several_contacts

WEIGHTLESS = Scene(gravity=0.0, drive=None)
RECORDS = [*load("exact_trajectories"), *load("seed_scene")]


def simulator(scene: Scene, state: Any, time: float = 0.0) -> ExactSimulator:
    made = ExactSimulator(scene)
    made.reset(state, time)
    return made


def plain_step(scene: Scene, state: Any, dt: float, torque: float | None = None, time: float = 0.0) -> tuple[Any, ...]:
    """One step of the same code uncompiled: how it ended, the state after, and the impacts (time, wall, foot)."""
    n, w = scene.numbers, new_workspace(64)
    before, after = np.array(state, dtype=float), np.empty(12)
    pieces = pieces_for(scene, time, dt, torque)
    held = 0.0 if torque is None else torque
    plan = step.make_plan(n, dt, drive_kind(scene, torque is not None))
    with np.errstate(divide="ignore", invalid="ignore"):
        ended, _ = step.step(n, plan, before, after, time, held, step.Pieces(pieces, 0, len(pieces)), w)
    rows = w[RECORD : RECORD + int(w[TALLY, HITS]), :3]
    return ended, after, [(row[0], int(row[1]), int(row[2])) for row in rows]


# -- against the 60-digit reference ------------------------------------------------------------------------------------


def run_record(record: dict[str, Any]) -> tuple[list[Impact], list[Array]]:
    """Impacts, and states every 0.1 s."""
    scene = Scene(gravity=record["gravity"], drive=Chirp() if record["drive"] == "chirp" else None)
    run = simulator(scene, record["q"] + record["qdot"])
    hits: list[Impact] = []
    states = []
    for number in range(round(record["T"] / 0.02)):
        run.step(0.02, 90000.0 * record["actions"][number] if record["drive"] == "held" else None)
        hits += run.impacts
        if number % 5 == 4:
            states.append(run.state)
    return hits, states


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record["name"])
def test_impacts_and_states_equal_the_60_digit_reference(record: dict[str, Any]) -> None:
    hits, states = run_record(record)
    predictable = 14 if record["name"] == "seed" else len(record["impacts"])  # beyond, float64 can not tell
    expected = record["impacts"][:predictable]
    assert [(hit.wall, hit.foot) for hit in hits[:predictable]] == [(hit["wall"], hit["foot"]) for hit in expected]
    if record["name"] != "seed":
        assert len(hits) == predictable
    for hit, reference in list(zip(hits, expected, strict=False))[:5]:
        assert hit.time == pytest.approx(reference["time"], abs=1e-10, rel=0.0)
        assert hit.impulse == pytest.approx(reference["impulse"], rel=1e-8)
    times = [hit["time"] for hit in record["impacts"]]
    checked = 0
    for state, reference in zip(states, record["states"], strict=True):
        before = sum(time < reference["time"] for time in times)
        if before > 5:
            break
        tolerance = 1e-12 if before == 0 else 1e-8
        np.testing.assert_allclose(state, reference["state"], rtol=0.0, atol=tolerance)
        checked += 1
    assert checked > 9


def test_the_control_step_does_not_matter() -> None:
    expected = load("seed_scene")[0]["impacts"][:5]
    for dt in (0.1, 0.007, 0.5):
        run = simulator(Scene(), np.zeros(12))
        hits: list[Impact] = []
        while len(hits) < 5:
            run.step(dt)
            hits += run.impacts
        for hit, reference in zip(hits, expected, strict=False):
            assert (hit.wall, hit.foot) == (reference["wall"], reference["foot"])
            assert hit.time == pytest.approx(reference["time"], abs=1e-10, rel=0.0)


def test_without_torque_time_can_be_turned_back() -> None:
    rng = np.random.default_rng(3)
    scene = Scene(drive=None)
    total = 0
    for _ in range(20):
        start = inside(scene, rng, speed=3.0)
        run = simulator(scene, start)
        hits = 0
        while hits < 4:
            run.step(0.02)
            hits += len(run.impacts)
        there = run.state
        there[6:] *= -1.0
        back = simulator(scene, there)
        for _ in range(round(run.time / 0.02)):
            back.step(0.02)
        home = back.state
        home[6:] *= -1.0
        np.testing.assert_allclose(home, start, atol=1e-7)
        total += hits
    assert total >= 80


# -- the law of impact -------------------------------------------------------------------------------------------------


def relative_error(found: Array, expected: Array) -> float:
    return float(np.abs(found[6:] - expected[6:]).max() / np.abs(expected[6:]).max())


def test_one_contact_equals_the_impact_map_over_2000_states() -> None:
    rng = np.random.default_rng(0)
    for _ in range(2000):
        state, wall, foot = one_foot_on_wall(WEIGHTLESS, rng)
        expected, impulse = impact_map(WEIGHTLESS, state, wall, foot)
        run = simulator(WEIGHTLESS, state)
        run.step(1e-12, torque=0.0)
        assert [(hit.wall, hit.foot) for hit in run.impacts] == [(wall, foot)]
        assert relative_error(run.state, expected) < 1e-10
        assert run.impacts[0].impulse == pytest.approx(impulse, rel=1e-9)


@pytest.mark.parametrize("kind", ["one wall", "two walls", "corner"])
@pytest.mark.parametrize("inertia", [4.0, 0.004])
def test_simultaneous_contacts_equal_the_simultaneous_law(kind: str, inertia: float) -> None:
    rng = np.random.default_rng(2)
    scene = Scene(gravity=0.0, drive=None, jack_inertia=inertia)
    several = 0
    for _ in range(200):
        state, contacts = several_contacts(scene, rng, kind)
        expected, impulses = simultaneous_impact_map(scene, state, contacts)
        run = simulator(scene, state)
        run.step(1e-13, torque=0.0)
        assert relative_error(run.state, expected) < 1e-9
        several += (impulses > 0.0).sum() > 1
    assert several > 5


def test_one_contact_after_the_other_would_break_the_simultaneous_law(monkeypatch: pytest.MonkeyPatch) -> None:
    # Resolved one by one, two feet on a floor give another, also energy-keeping, answer.
    def one_by_one(n: Any, w: Any, count: int) -> None:
        for number in range(count):
            w[IMPULSES, number] = impacts.bounce(n, w[STATE], w[GRADIENTS + number])

    rng = np.random.default_rng(2)
    state, contacts = several_contacts(WEIGHTLESS, rng, "one wall")
    expected, _ = simultaneous_impact_map(WEIGHTLESS, state, contacts)
    assert relative_error(plain_step(WEIGHTLESS, state, 1e-13, 0.0)[1], expected) < 1e-9
    monkeypatch.setattr(impacts, "bounce_together", one_by_one)
    assert relative_error(plain_step(WEIGHTLESS, state, 1e-13, 0.0)[1], expected) > 0.01


def test_a_jack_that_fits_at_45_degrees_only_rattles_in_its_corners() -> None:
    # Eight contacts of rank three, with 1e-4 m of play: thousands of impacts per second, some of them together.
    scene = Scene(gravity=0.0, drive=None, jack_arm=6.0 * math.sqrt(2.0) - 1e-4)
    state = np.zeros(12)
    state[5], state[9], state[10] = math.pi / 4.0, 3.0, 3.0
    run = simulator(scene, state)
    hits: list[Impact] = []
    for _ in range(10):
        run.step(0.001)
        hits += run.impacts
        assert clearance(scene, run.state.tolist()) > -1e-9
    assert len(hits) > 100
    assert len({hit.time for hit in hits}) < len(hits)
    assert energy(scene, run.state) == pytest.approx(energy(scene, state), rel=1e-11)
    np.testing.assert_allclose(400.0 * run.state[6:8] + 4.0 * run.state[9:11], [12.0, 12.0], rtol=1e-9)


def test_a_jack_without_any_play_is_refused_rather_than_shaken_for_ever() -> None:
    scene = Scene(gravity=0.0, drive=None, jack_arm=6.0 * math.sqrt(2.0) * (1.0 - 4e-16))
    state = np.zeros(12)
    state[5], state[9] = math.pi / 4.0, 3.0
    with pytest.raises(RuntimeError, match="the jack needs more than 1,000,000 gap evaluations"):
        simulator(scene, state).step(1e-9)


# -- certified isolation -----------------------------------------------------------------------------------------------


def grazing(depth: float) -> tuple[Scene, Array, float]:
    """A foot swings through a wall by ``depth`` [m] and back within a step: scene, state and step."""
    scene = Scene(gravity=0.0, drive=None)
    # Foot 0 turns at 10 rad/s on an arm of 1 m around a centre at 5 + depth: it points at the wall after 10 ms.
    state = np.zeros(12)
    state[3], state[5], state[11] = 5.0 + depth, -0.1, 10.0
    return scene, state, 0.02


MISSED: dict[str, Callable[[], tuple[Scene, Array, float]]] = {
    "a foot swings 1 mm through": lambda: grazing(1e-3),
    "a foot swings 1 um through": lambda: grazing(1e-6),
    "a foot swings 1 nm through": lambda: grazing(1e-9),
    "fast spin, whole turns in a step": lambda: (
        Scene(gravity=0.0, drive=None),
        np.array([0, 0, 0, 5.2, 0, 0.785, 0, 0, 0, 0, 0, 100.0 * math.pi]),
        0.02,
    ),
    "the box's corner sweeps past": lambda: (
        Scene(gravity=0.0, drive=None),
        np.array([0, 0, -0.02, 5.001, 0, -0.02, 0, 0, 2.0, 0, 0, 2.0]) * 1.0,
        0.02,
    ),
    "a bounce on the ceiling within a long step": lambda: (
        Scene(drive=None),
        np.array([0, 0, 0, 0, 4.9, 0, 0, 0, 0, 0, 1.5, 0]),
        0.3,
    ),
}


@pytest.mark.parametrize("name", MISSED)
def test_what_sampling_at_the_steps_end_misses_is_found(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, state, dt = MISSED[name]()
    ended, after, found = plain_step(scene, state, dt, 0.0)
    assert ended == Status.DONE
    assert found
    run = simulator(scene, state)  # and compiled it finds the same
    run.step(dt, 0.0)
    np.testing.assert_array_equal(run.state, after)
    # In small steps the foot is seen outside: the impact is real.
    monkeypatch.setattr(kernel, "walls_in_reach", lambda *_: 0)
    times = found[0][0] + np.linspace(0.0, 0.1 * dt, 2001)[1:]
    lows = [clearance(scene, plain_step(scene, state, float(time), 0.0)[1].tolist()) for time in times]
    assert min(lows) < -1e-13
    monkeypatch.undo()
    monkeypatch.setattr(kernel, "first_of_all", naive.first_of_all)
    assert len(plain_step(scene, state, dt, 0.0)[2]) < len(found)


def test_the_gap_stays_above_its_parabola() -> None:
    # The bound itself, over random flights: gap(s) >= gap + gap' s - K s^2 / 2; with half of K it is broken.
    rng = np.random.default_rng(5)
    broken = 0
    for _ in range(400):
        scene = Scene(jack_arm=rng.uniform(0.1, 8.0), gravity=rng.choice([0.0, 9.81]))
        state = inside(scene, rng, speed=rng.choice([1.0, 5.0]))
        n, w = scene.numbers, new_workspace()
        alpha, left = rng.uniform(-6.0, 6.0), rng.choice([0.02, 0.2])
        (x, y), (vx, vy) = (state[3:5] - state[0:2]).tolist(), (state[9:11] - state[6:8]).tolist()
        angle, omega, jack_angle, jack_omega = state[[2, 8, 5, 11]].tolist()
        flight = kernel.Flight(
            x, y, vx, vy, angle, omega, jack_angle, jack_omega, scene.gravity, alpha, 0.0, 0.5 * left, False, False
        )
        bounds = kernel.bounds_of(n, flight, left, abs(alpha), 0.0)
        curvature = bounds.bend + bounds.swing
        for wall, foot in rng.integers(0, 4, (4, 2)).tolist():
            gap, rate = kernel.gap_at(n, flight, w, wall, foot, 0.0)
            for s in np.linspace(0.0, left, 9)[1:]:
                later, _ = kernel.gap_at(n, flight, w, wall, foot, float(s))
                assert later >= gap + rate * s - 0.5 * curvature * s * s - 1e-12
                broken += later < gap + rate * s - 0.25 * curvature * s * s - 1e-12
    assert broken > 0


def test_each_bound_holds_over_the_whole_flight() -> None:
    # Distance of the centres, and the second derivative of the distance from a wall, over flights that bend most.
    rng = np.random.default_rng(6)
    scene = Scene()
    n, w = scene.numbers, new_workspace()
    tightest = math.inf
    for number in range(300):
        left, alpha = rng.choice([0.02, 0.5, 1.0]), rng.uniform(-50.0, 50.0)
        x, y, vx, angle, jack_angle, jack_omega = rng.uniform(-3.0, 3.0, 6).tolist()
        omega = 0.0 if number % 2 else float(rng.uniform(-5.0, 5.0))
        vy = 0.5 * scene.gravity * left  # thrown up and back again: both ends say nothing of the way between
        flight = kernel.Flight(
            x, y, vx, vy, angle, omega, jack_angle, jack_omega, scene.gravity, alpha, 0.0, 0.5 * left, False, False
        )
        bounds = kernel.bounds_of(n, flight, left, abs(alpha), 0.0)
        for s in np.linspace(0.0, left, 9).tolist():
            pose = kernel.pose_at(flight, w, s)
            distance = math.hypot(pose.x, pose.y)
            assert distance <= bounds.far
            assert distance <= kernel.reach_of(n, flight, left, 0.0)
            cosine, sine = math.cos(pose.angle), math.sin(pose.angle)
            ahead, aside = cosine * pose.x + sine * pose.y, cosine * pose.y - sine * pose.x
            rate_aside = cosine * pose.vy - sine * pose.vx
            bent = -sine * scene.gravity + 2.0 * pose.omega * rate_aside + alpha * aside - pose.omega**2 * ahead
            assert abs(bent) <= bounds.bend
            spin = jack_omega - pose.omega
            assert scene.jack_arm * math.hypot(spin * spin, alpha) <= bounds.swing
            tightest = min(tightest, bounds.far - distance, bounds.bend / max(abs(bent), 1e-9) - 1.0)
    assert tightest < 0.5  # the bounds are no wild exaggeration


def test_an_uncertified_step_would_let_feet_through(monkeypatch: pytest.MonkeyPatch) -> None:
    # With a hundredth of K the walk to the parabola's root passes impacts of a foot that turns away and comes back.
    scene, state, dt = MISSED["fast spin, whole turns in a step"]()
    first = plain_step(scene, state, dt, 0.0)[2][0]
    honest = kernel.bounds_of

    def brazen(*given: Any) -> kernel.Bounds:
        far, bend, swing = honest(*given)
        return kernel.Bounds(far, 0.01 * bend, 0.01 * swing)

    monkeypatch.setattr(kernel, "bounds_of", brazen)
    hasty = plain_step(scene, state, dt, 0.0)[2]
    assert not hasty or hasty[0] != first


# -- resting, grazing, touching ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.0, math.pi / 4.0])
def test_a_jack_at_rest_on_the_floor_stays_there(angle: float) -> None:
    scene = Scene(drive=None)
    state = np.zeros(12)
    state[5] = angle
    state[4] = -(6.0 - math.cos(angle))
    run = simulator(scene, state)
    impulse = 0.0
    for _ in range(25):
        run.step(0.02)
        impulse += sum(hit.impulse for hit in run.impacts)
        assert -1e-9 < clearance(scene, run.state.tolist()) < 1e-8
    # Carried by the box, both sink with the common centre of mass: m_j g t^2 / 2 (m_j + m_b).
    assert run.state[1] == pytest.approx(-4.0 / 404.0 * 9.81 * 0.5**2 / 2.0, rel=1e-3)
    assert impulse == pytest.approx(4.0 * 400.0 / 404.0 * 9.81 * 0.5, rel=1e-2)
    assert energy(scene, run.state) == pytest.approx(energy(scene, state), abs=1e-9)


@pytest.mark.parametrize("dt", [0.02, 0.2, 1.0])
@pytest.mark.parametrize("angle", [0.0, math.pi / 4.0])
def test_a_foot_that_slides_along_a_wall_is_let_slide(dt: float, angle: float) -> None:
    # It touches the wall and nothing presses on it: the jack falls along the wall.
    scene = Scene(drive=None)
    state = np.zeros(12)
    state[3], state[5] = 6.0 - math.cos(angle), angle
    run = simulator(scene, state)
    run.step(dt)
    assert [hit for hit in run.impacts if hit.impulse > 1e-6] == []
    assert run.state[4] == pytest.approx(-0.5 * 9.81 * dt * dt, abs=1e-9)
    assert clearance(scene, run.state.tolist()) > -1e-9


def test_a_foot_at_rest_on_a_wall_without_weight_is_left_alone() -> None:
    state = np.zeros(12)
    state[3] = 5.0
    run = simulator(WEIGHTLESS, state)
    run.step(1.0)
    np.testing.assert_array_equal(run.state, state)
    assert run.impacts == []


@pytest.mark.parametrize("speed", [1e-9, 1e-3, 1.0, 7000.0])
def test_an_approach_at_any_speed_is_reflected(speed: float) -> None:
    scene = Scene(gravity=0.0, drive=None, box_mass=1e30, box_inertia=1e30)
    for gap in (0.0, 1e-6 * min(speed, 1.0)):
        state = np.zeros(12)
        state[3], state[9] = 5.0 - gap, speed
        run = simulator(scene, state)
        run.step(1e-4)
        assert run.impacts[0][1:3] == (0, 0)
        assert abs(run.state[9]) == pytest.approx(speed, rel=1e-12)
    state[3], state[9] = 5.0, -speed  # leaves: nothing happens
    run = simulator(scene, state)
    run.step(1e-6)
    assert run.impacts == []


def test_a_wall_far_off_and_a_foot_outside_by_rounding() -> None:
    rng = np.random.default_rng(4)
    for _ in range(50):
        state, wall, foot = one_foot_on_wall(WEIGHTLESS, rng)
        state[[0, 3]] += 2.0**30
        run = simulator(WEIGHTLESS, state)
        run.step(1e-5)
        assert (wall, foot) in [hit[1:3] for hit in run.impacts]


# -- drives ------------------------------------------------------------------------------------------------------------


def chirp_motion(chirp: Chirp, time: float, dt: float) -> tuple[float, float]:
    """Change of omega_box and of theta_box from rest over a step, by quadrature with 40 digits."""
    with mp.workdps(40):
        start, length = mp.mpf(time), mp.mpf(dt)
        turns = int(chirp.fastest(time, dt) * dt * 4.0) + 2
        pieces = [length * k / turns for k in range(turns + 1)]

        def torque(since: Any) -> Any:
            t = start + since
            return mp.sin(2 * mp.pi * (mp.mpf(chirp.start_frequency) * t + mp.mpf(chirp.rate) * t * t / 2))

        spun = mp.quad(torque, pieces)
        turned = mp.quad(lambda since: (length - since) * torque(since), pieces)
        return float(spun * chirp.amplitude / 14400.0), float(turned * chirp.amplitude / 14400.0)


@pytest.mark.parametrize(
    ("chirp", "time", "dt"),
    [
        (Chirp(), 0.0, 0.02),
        (Chirp(), 9.98, 0.02),
        (Chirp(), 9.0, 1.0),
        (Chirp(), 1e4, 0.02),
        (Chirp(rate=0.0), 123.0, 0.02),
        (Chirp(rate=0.0, start_frequency=0.0), 5.0, 0.02),
        (Chirp(rate=-2.0, start_frequency=3.0), 1.49, 0.02),  # the frequency passes through zero
        (Chirp(rate=-2.0), 50.0, 0.1),
        (Chirp(rate=0.9), -50.0, 0.02),
        (Chirp(amplitude=-1e4, rate=1e-9), 7.0, 0.3),
    ],
    ids=str,
)
def test_any_chirp_at_any_time_moves_the_box_as_it_should(chirp: Chirp, time: float, dt: float) -> None:
    run = simulator(Scene(gravity=0.0, drive=chirp), np.zeros(12), time)
    run.step(dt)
    spun, turned = chirp_motion(chirp, time, dt)
    assert run.state[8] == pytest.approx(spun, abs=1e-13, rel=1e-13)
    assert run.state[2] == pytest.approx(turned, abs=1e-13, rel=1e-13)
    assert run.torque == pytest.approx(14400.0 * spun / dt, abs=1e-8)


def test_the_chirp_after_a_million_seconds() -> None:
    chirp, time, dt = Chirp(), 1e6, 0.02
    spun, turned = chirp_motion_by_fresnel(chirp, 14400.0, time, dt)
    run = simulator(Scene(gravity=0.0, drive=chirp), np.zeros(12), time)
    run.step(dt)
    assert run.state[8] == pytest.approx(spun, abs=1e-13)
    assert run.state[2] == pytest.approx(turned, abs=1e-15)
    assert abs(spun) > 1e-10


def test_a_chirp_that_turns_too_often_is_refused() -> None:
    run = simulator(Scene(), np.zeros(12), 1e8)
    with pytest.raises(ValueError, match=r"the chirp turns 1.8e\+06 times in the 0.02 s after .* at most 83333"):
        run.step(0.02)
    run.step(0.02, torque=0.0)


def test_functions_drive_as_the_chirp_does() -> None:
    law = Chirp()
    one = simulator(Scene(), np.zeros(12))
    other = simulator(Scene(drive=Drive(torque=law.torque)), np.zeros(12))
    for _ in range(140):  # five impacts
        one.step(0.02)
        other.step(0.02)
        assert [hit[1:3] for hit in one.impacts] == [hit[1:3] for hit in other.impacts]
        assert one.torque == pytest.approx(other.torque, rel=1e-9, abs=1e-6)
    np.testing.assert_allclose(one.state, other.state, atol=1e-9)


def test_functions_are_followed_to_rounding_over_long_steps() -> None:
    law = Chirp(amplitude=2e4)
    one = simulator(Scene(gravity=0.0, drive=law), np.zeros(12))
    other = simulator(Scene(gravity=0.0, drive=Drive(torque=law.torque)), np.zeros(12))
    for _ in range(8):
        one.step(0.7)
        other.step(0.7)
    np.testing.assert_allclose(other.state, one.state, rtol=0.0, atol=1e-13)


def float32_sine(time: float) -> Any:
    return np.float32(9e4 * math.sin(time))


@pytest.mark.parametrize(
    ("torque", "dt", "times"),
    [
        (lambda t: 9e4 * math.sin(2.0 * math.pi * t), 0.02, [81.48, 81.98, 1e3, 1e6, 1e8]),
        (lambda t: 9e4 * math.sin(2.0 * math.pi * t), 1e-4, [0.5, 8.0, 100.0]),
        (lambda t: 9e4 * math.sin(20.0 * math.pi * t), 0.02, [32.64, 1e4]),
        (Chirp().torque, 0.02, [24.28, 100.0, 1000.0]),
        (float32_sine, 0.02, [0.0, 3.14, 50.0]),
    ],
    ids=["1 Hz", "small steps", "10 Hz", "chirp", "float32"],
)
def test_the_rounding_of_a_function_is_not_taken_for_its_shape(torque: Any, dt: float, times: list[float]) -> None:
    # Near a zero the rounding of t * omega is large against the function's values in the step.
    for time in times:
        run = simulator(Scene(gravity=0.0, drive=Drive(torque=torque)), np.zeros(12), time)
        run.step(dt)
        with mp.workdps(30):
            mean = mp.quad(lambda s, time=time: mp.mpf(float(torque(float(time + s)))), [0, dt / 2, dt]) / dt
        assert run.torque == pytest.approx(float(mean), abs=0.1 + 9e4 * 100.0 * math.ulp(time))


def test_jumps_of_a_drive_are_found() -> None:
    # A square wave of 9e4 N m: 6.25 rad/s^2 for 0.25 s, then back: omega is a triangle, theta grows by 0.390625 rad.
    scene = Scene(gravity=0.0, drive=Drive(torque=lambda t: 9e4 if t % 0.5 < 0.25 else -9e4))
    run = simulator(scene, np.zeros(12))
    for _ in range(50):
        run.step(0.03)
    assert run.state[8] == pytest.approx(0.0, abs=1e-11)
    assert run.state[2] == pytest.approx(3.0 * 6.25 * 0.25**2, abs=1e-11)


def test_a_drive_of_noise_is_refused() -> None:
    rng = np.random.default_rng(0)
    run = simulator(Scene(drive=Drive(torque=lambda t: rng.uniform(-1.0, 1.0))), np.zeros(12))
    before = run.state
    with pytest.raises(ValueError, match="drive must be smooth but for some jumps: over the 0.02 s after t = 0 s"):
        run.step(0.02)
    np.testing.assert_array_equal(run.state, before)


@pytest.mark.parametrize("drive", [Drive(), Drive(force_x=lambda t: 0.0), None], ids=["none", "zero", "no drive"])
def test_a_drive_that_does_nothing_changes_nothing(drive: Drive | None) -> None:
    rng = np.random.default_rng(6)
    start = inside(Scene(), rng)
    one, other = simulator(Scene(drive=None), start), simulator(Scene(drive=drive), start)
    for _ in range(100):
        one.step(0.02)
        other.step(0.02)
    np.testing.assert_allclose(one.state, other.state, atol=1e-9)


def test_a_held_torque_costs_no_more_where_it_replaces_a_function(monkeypatch: pytest.MonkeyPatch) -> None:
    # Where no side force acts there is nothing to interpolate: the step is, bit for bit, that of a scene without drive.
    function, none = Scene(drive=Drive(torque=lambda t: 1e4 * math.sin(t))), Scene(drive=None)
    rng = np.random.default_rng(7)
    start, torques = inside(none, rng), rng.uniform(-9e4, 9e4, 200)
    one, other = simulator(function, start), simulator(none, start)
    asked: list[float] = []

    def interpolate(drive: Drive, time: float, dt: float) -> Any:
        asked.append(time)
        return functions.function_pieces(drive, time, dt)

    monkeypatch.setattr(exact, "function_pieces", interpolate)
    for torque in torques.tolist():
        one.step(0.02, torque)
        other.step(0.02, torque)
        np.testing.assert_array_equal(one.state, other.state)
    np.testing.assert_array_equal(rollout(function, start, torques, 0.02), rollout(none, start, torques, 0.02))
    batches = [make_vec(scene, start) for scene in (function, none)]
    for actions in rng.uniform(-1.0, 1.0, (50, 3)):
        seen, expected = (batch.step(actions) for batch in batches)
        np.testing.assert_array_equal(seen[0], expected[0])
        np.testing.assert_array_equal(seen[1], expected[1])
    assert asked == []
    one.step(0.02)
    assert asked == pytest.approx([4.0])
    batches[0].step(None)
    assert asked == pytest.approx([4.0, 1.0])


def make_vec(scene: Scene, start: Array) -> JackInBoxVectorEnv:
    made = JackInBoxVectorEnv(3, contact="exact", scene=scene)
    made.reset(options={"state": start})
    return made


def test_impacts_under_side_forces_keep_momentum() -> None:
    force = 3e4
    scene = Scene(gravity=0.0, drive=Drive(force_x=lambda t: force * math.cos(9.0 * t), force_y=lambda t: -1e3))
    run = simulator(scene, np.zeros(12))
    hits = 0
    for _ in range(300):
        run.step(0.02, torque=2e4)
        hits += len(run.impacts)
        assert clearance(scene, run.state.tolist()) > -1e-9
    assert hits > 3
    momentum = 400.0 * run.state[6:8] + 4.0 * run.state[9:11]
    np.testing.assert_allclose(momentum, [force / 9.0 * math.sin(54.0), -6e3], atol=1e-8)


# -- limits and refusals -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0 - 1e-12])
def test_scenes_that_lose_energy_are_refused(restitution: float) -> None:
    with pytest.raises(
        ValueError, match="contact='exact' is elastic only, restitution 1, got .*; contact='pymunk' takes"
    ):
        ExactSimulator(Scene(restitution=restitution))


def test_work_is_bounded_and_says_so() -> None:
    run = simulator(Scene(gravity=0.0, drive=None), np.array([0, 0, 0, 5.5, 0, 0.7, 0, 0, 0, 0, 0, 0]))
    state = run.state
    state[11] = 1e9
    run.reset(state)
    with pytest.raises(RuntimeError, match="the jack needs more than 1,000,000 gap evaluations in the dt = 1 s after"):
        run.step(1.0)
    np.testing.assert_array_equal(run.state, state)
    assert (run.time, run.impacts) == (0.0, [])
    state[11] = 1.0
    run.reset(state)
    run.step(0.02)


def test_motion_that_would_overflow_is_refused() -> None:
    run = simulator(WEIGHTLESS, np.array([0, 0, 0, 0, 0, 0.7, 0, 0, 0, 1e90, 0, 0]))
    before = run.state
    with pytest.raises(RuntimeError, match="the jack moves too fast to be followed in the dt = 0.02 s after t = 0 s"):
        run.step(0.02)
    np.testing.assert_array_equal(run.state, before)


@pytest.mark.parametrize("drive", [Chirp(amplitude=1e60), Drive(torque=lambda t: 1e300), None])
def test_torque_that_would_overflow_is_refused_also_in_mid_air(drive: Chirp | Drive | None) -> None:
    run = simulator(Scene(gravity=0.0, drive=drive, box_inertia=1e-60), np.zeros(12))
    before = run.state
    with pytest.raises(RuntimeError, match="the jack moves too fast to be followed in the dt = 0.02 s after t = 0 s"):
        run.step(0.02, None if drive else 1e300)
    np.testing.assert_array_equal(run.state, before)
    assert run.time == 0.0


@pytest.mark.parametrize("place", [2, 5, 6, 10])
def test_states_that_float64_can_not_resolve_are_refused_where_it_matters(place: int) -> None:
    state = np.zeros(12)
    state[3], state[5], state[9] = 5.2, 0.785, 10.0
    state[place] = 1e14
    if place in (6, 10):
        state[[6, 9] if place == 6 else [7, 10]] = 1e14
    run = simulator(WEIGHTLESS, state)
    with pytest.raises(RuntimeError, match="too fast to be followed .* or is too far off"):
        run.step(0.02)
    np.testing.assert_array_equal(run.state, state)


def test_many_impacts_of_one_step_are_all_recorded() -> None:
    scene = Scene(gravity=0.0, drive=None, box_mass=1e12, box_inertia=1e14, jack_arm=0.5)
    run = simulator(scene, np.array([0, 0, 0, 0, 0, 0.1, 0, 0, 0, 3000.0, 0, 0]))
    run.step(1.0)
    assert 100 < len(run.impacts) < 300
    times = [hit.time for hit in run.impacts]
    assert times == sorted(times)
    assert all(hit.impulse > 0.0 for hit in run.impacts)


# -- compiled and plain ------------------------------------------------------------------------------------------------


def test_compiled_and_plain_give_the_same_bits() -> None:
    rng = np.random.default_rng(8)
    hits = 0
    for scene in (Scene(), Scene(jack_arm=5.9), Scene(jack_arm=6.5), Scene(drive=Drive(force_x=lambda t: 1e4 * t))):
        state = np.zeros(12)
        state[5] = math.pi / 4.0
        state[6:] = rng.standard_normal(6) * (2.0, 2.0, 0.5, 8.0, 8.0, 3.0)
        run = simulator(scene, state)
        for number in range(100):
            torque = rng.uniform(-9e4, 9e4) if number % 2 else None
            ended, after, found = plain_step(scene, run.state, 0.02, torque, run.time)
            run.step(0.02, torque)
            assert ended == Status.DONE
            np.testing.assert_array_equal(run.state, after)
            assert [(hit.wall, hit.foot) for hit in run.impacts] == [hit[1:] for hit in found]
            hits += len(found)
    assert hits > 30


def test_starts_are_inside_for_every_arm() -> None:
    rng = np.random.default_rng(9)
    for arm in (1e-3, 1.0, 5.999999, 6.0, 7.0, 8.48):
        scene = Scene(jack_arm=arm)
        run = simulator(scene, sample_start(scene, rng))
        for _ in range(200):
            run.step(0.02, rng.uniform(-9e4, 9e4))
            assert clearance(scene, run.state.tolist()) > -1e-9


def test_compiled_functions_are_made_once() -> None:
    assert compiled(step.step_one) is compiled(step.step_one)
