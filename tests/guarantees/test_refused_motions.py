"""A jack never escapes silently: starts outside are refused, and so is motion that no contact model can follow."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from jackbox_env import Chirp, Drive, JackInBoxVectorEnv, JackLostError, Scene, make_simulator
from jackbox_env.mechanics import energy, simultaneous_impact_map
from jackbox_env.model.states import as_start, clearance
from jackbox_env.simulators.pymunk import PymunkSimulator
from tests.guarantees.poses import velocity_error
from tests.states import WEIGHTLESS, Array, lying, several_contacts, started


def test_the_tolerance_grows_far_from_the_origin() -> None:
    far = np.array([1e9, -1e9, 0.0, 1e9 + 5.0 + 2.4e-7, -1e9, *[0.0] * 7])  # 2 ulp outside
    np.testing.assert_array_equal(as_start(Scene(), far), far)


DRIVES = [
    None,
    Chirp(),
    *(Drive(torque=constant) for constant in (lambda t: 1.0, lambda t: -1.0, lambda t: 0.3)),
]
FIELDS: list[dict[str, float]] = [{}, {"gravity": 0.0}, {"box_half_width": 0.15, "jack_arm": 0.025}]


def beyond_the_floor(rng: np.random.Generator) -> tuple[Scene, Array]:
    """A scene, and a jack with a foot 1e-12 to 1 m below the floor that is at rest in the box, slow or fast."""
    fields, drive = FIELDS[rng.integers(3)], DRIVES[rng.integers(5)]
    scene = Scene(**fields, restitution=rng.choice([1.0, 1.0, 0.9, 0.0]), drive=drive)
    half, turned, tilt = scene.box_half_width, rng.choice([0.0, rng.uniform(-0.7, 0.7)]), rng.uniform(-3.0, 3.0)
    depth = 10.0 ** rng.uniform(-12.0, math.log10(min(1.0, half)))
    omega = rng.choice([0.0, rng.uniform(-3.0, 3.0)])
    state = lying(rng.uniform(-0.5, 0.5) * half, omega, tilt, turned, half + depth - scene.jack_arm * math.cos(turned))
    rate = rng.choice([0.0, -1.0, 1.0]) * 10.0 ** rng.uniform(-15.0, 0.5)
    state[9:11] += rate * np.array([-math.sin(tilt), math.cos(tilt)])
    return scene, state


def test_a_foot_outside_is_followed_whatever_its_rate_and_gets_no_deeper(cases: Callable[[int], int]) -> None:
    count, rng = cases(1000), np.random.default_rng(4)
    scenes, states = zip(*(beyond_the_floor(rng) for _ in range(count)), strict=True)
    batch = started(JackInBoxVectorEnv(count, contact="exact", scene=list(scenes), torque="chirp"), seed=0)
    batch.set_states(np.array(states), 0.0)
    trajectory = [batch.states for _ in range(4) if batch.step(np.zeros((count, 1)))]
    for row, (scene, state) in enumerate(zip(scenes, states, strict=True)):
        alone = started(make_simulator(scene, "exact"), state)
        for after in trajectory:
            alone.step(0.02)
            np.testing.assert_array_equal(alone.state, after[row])
            deeper = clearance(scene, state.tolist()) - clearance(scene, alone.state.tolist())
            assert deeper < 2.4e-10 * min(1.0, scene.box_half_width)


@pytest.mark.parametrize("outside", [1e-9, 1e-3])
def test_a_foot_outside_that_gravity_turns_round_rests_there_and_one_that_nothing_pulls_leaves(outside: float) -> None:
    rate = math.sqrt(9.81 * outside)  # rises by half the depth
    for scene, expected in ((Scene(drive=None), -0.5 * outside), (WEIGHTLESS, rate * 0.02 - outside)):
        simulator = started(
            make_simulator(scene, "exact"), lying(turned=0.0, depth=5.0 + outside) + rate * np.eye(12)[10]
        )
        simulator.step(0.02)
        assert clearance(scene, simulator.state.tolist()) == pytest.approx(expected, rel=1e-9, abs=2e-13)


def test_without_the_refusal_the_jack_would_be_out_of_the_box(monkeypatch: pytest.MonkeyPatch) -> None:
    simulator = started(PymunkSimulator(Scene(drive=None)), 1e5 * np.eye(12)[9])
    monkeypatch.setattr(PymunkSimulator, "_deepest", math.inf)
    simulator.step(0.02)
    assert clearance(simulator.scene, simulator.state.tolist()) < -1.0


def test_with_too_few_iterations_the_feet_would_not_obey_the_law(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(gravity=0.0, drive=None, jack_inertia=0.004)
    state, contacts = several_contacts(scene, np.random.default_rng(3), "corner")
    expected, _ = simultaneous_impact_map(scene, state, contacts)

    def error(iterations: int | None) -> float:
        simulator = started(PymunkSimulator(scene, substeps=1, iterations=iterations), state)
        simulator.step(1e-12, torque=0.0)  # poses move by 1e-10 m and less
        return velocity_error(scene, simulator.state[6:], expected[6:])

    assert error(None) < 1e-8
    with pytest.raises(JackLostError, match="is wedged between walls"):  # and the step is refused
        error(64)
    monkeypatch.setattr(PymunkSimulator, "_resolved", lambda *_: True)
    assert error(64) > 1e-3


def wedged(scenes: int = 15) -> tuple[list[str], float]:
    """Errors of courses with feet in opposite walls, and the largest share of energy lost in the others."""
    rng, refused, loss = np.random.default_rng(0), list[str](), 0.0
    for _ in range(scenes):
        scene = Scene(jack_arm=6.0 * (1.0 + 10.0 ** rng.uniform(-2.0, -1.0)), gravity=0.0, drive=None)
        simulator, state = PymunkSimulator(scene, substeps=1), np.zeros(12)
        state[5], state[6:] = math.pi / 4.0, 3.0 * rng.standard_normal(6)
        state[11] = rng.uniform(1.0, 20.0)
        simulator.reset(state)
        try:
            for _ in range(20):
                simulator.step(0.02, 0.0)
                loss = max(loss, abs(1.0 - energy(scene, simulator.state) / energy(scene, state)))
        except JackLostError as error:
            refused.append(str(error))
    return refused, loss


def test_a_wedged_jack_keeps_its_energy_or_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    refused, loss = wedged()
    assert refused
    assert all("the jack is wedged between walls" in sentence and "s after t = " in sentence for sentence in refused)
    assert loss < 1e-5
    monkeypatch.setattr(PymunkSimulator, "_resolved", lambda *_: True)
    refused, loss = wedged()
    assert not refused
    assert loss > 1e-4
