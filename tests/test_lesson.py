"""The answers of docs/lesson.md are those of the exact model."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from jackbox_env import Impact, make_simulator
from jackbox_env.commands.game import Game, read_game
from jackbox_env.mechanics import gaps
from scripts.studies.baselines import threshold
from tests.states import Array, started

DOCS = Path(__file__).parents[1] / "docs"
LESSON = (DOCS / "lesson.md").read_text()
LINKS = re.findall("""<a href='play.html#([^']*)'>""", LESSON)
DROP, LOSS, SPIN, AGAIN, WEDGE, LEANING, NEARER, SPUN, WEIGHTLESS, LIGHT, LASTING = map(read_game, LINKS)


def played(game: Game, seconds: float) -> tuple[Array, list[Impact]]:
    """States every 0.02 s, and impacts, of a scene under no torque."""
    simulator = started(make_simulator(game.scene.changed(drive=None), contact="exact"), game.start)
    states, impacts = [np.array(simulator.state)], list[Impact]()
    for _ in range(round(seconds / 0.02)):
        simulator.step(0.02)
        states.append(np.array(simulator.state))
        impacts += simulator.impacts
    return np.array(states), impacts


def test_a_drop() -> None:
    states, _ = played(DROP, 10.0)
    assert f"{-states[60:150, 4].max():.2f} m below its start" in LESSON
    assert (states[:, 4] - states[:, 1]).max() == 0.0
    assert f"\n{-states[-1, 1]:.2f} m. Gravity" in LESSON
    assert AGAIN.start.tolist() == DROP.start.tolist()


def test_restitution_of_a_half() -> None:
    _, impacts = played(LOSS, 3.02)
    flights = np.diff([hit.time for hit in impacts])
    np.testing.assert_allclose(flights[:6], impacts[0].time * 0.5 ** np.arange(6))
    assert f"= {impacts[0].time:.2f} s. The flight" in LESSON
    assert f"= {3.0 * impacts[0].time:.2f} s. Then" in LESSON
    (_, early), (_, late) = played(LASTING, 9.0), played(LASTING, 9.1)
    assert f"= {9.0 * impacts[0].time:.2f} s: the flights" in LESSON
    assert early[-1].time < 9.0 * impacts[0].time < late[-1].time + 0.02


def test_a_spin() -> None:
    states, impacts = played(SPIN, 1.02)
    assert len(impacts) == 1
    assert f"with {states[50, 11]:.0f} rad/s. It arrives at\n{-states[50, 10]:.0f} m/s" in LESSON
    assert f"At {states[51, 10]:.0f} m/s upwards, with {states[51, 11]:.0f} rad/s left" in LESSON


def test_the_links_of_the_wedges_differ_as_the_page_says() -> None:
    angles = [game.start[5] for game in (WEDGE, LEANING, NEARER)]
    np.testing.assert_allclose(np.diff(angles), [1e-3, 1e-6 - 1e-3])


@pytest.mark.parametrize("by", [1e-3, 1e-6, 1e-9])
def test_two_wedges(by: float) -> None:
    game = WEDGE._replace(start=WEDGE.start + by * np.eye(12)[5])
    states, others = played(WEDGE, 11.0)[0], played(game, 11.0)[0]
    apart = 0.02 * (abs(states - others)[:, 4] > 0.1).argmax()
    assert f"fter {apart:.1f} s." in LESSON


def test_without_gravity() -> None:
    states, impacts = played(WEIGHTLESS, 10.0)
    energy, momentum, angular = 0.0, np.zeros(2), 0.0
    for mass, inertia, first in ((400.0, 14400.0, 0), (4.0, 4.0, 3)):
        (x, y, _), (vx, vy, omega) = states[:, first : first + 3].T, states[:, first + 6 : first + 9].T
        energy = energy + 0.5 * (mass * (vx**2 + vy**2) + inertia * omega**2)
        momentum = momentum + mass * np.stack([vx, vy], axis=1)
        angular = angular + mass * (x * vy - y * vx) + inertia * omega
    assert len(impacts) > 3
    np.testing.assert_allclose(energy, 112.0)
    np.testing.assert_allclose(momentum, [[24.0, 16.0]] * len(states))
    np.testing.assert_allclose(angular, 8.0)


def test_the_usual_program_pulls_the_jack_down_and_loses_it() -> None:
    program = started(threshold.Model(SPUN.scene.changed(drive=None), substeps=1), SPUN.start)
    impacts = list[Impact]()
    while program.time < 3.545:
        program.step(0.01)
        impacts += program.impacts
    bounce, pull = impacts[-2:]
    assert f"foot bounces off the floor at {bounce.time:.2f} s. At {pull.time:.2f} s another foot" in LESSON
    assert bounce.wall == pull.wall == 3
    assert bounce.foot != pull.foot
    assert f"an impulse of \N{MINUS SIGN}{-pull.impulse:.0f} N s. At {program.time:.2f} s" in LESSON
    assert f" a foot is\n{-gaps(program.scene, program.state).min():.1f} m below the floor" in LESSON
    assert len(played(SPUN, 3.5)[1]) < len(impacts)


def test_a_light_box() -> None:
    states, impacts = played(LIGHT, 1.2)
    assert len(impacts) == 1
    fell = 9.81 * impacts[0].time
    assert f"At {-states[-1, 7]:.2f} m/s, downwards: " in LESSON
    assert f"jack's {fell:.2f} m/s" in LESSON
    same, _ = played(LIGHT._replace(scene=LIGHT.scene.changed(box_mass=4.0, box_inertia=None)), 1.1)
    np.testing.assert_allclose([-same[-1, 7], same[-1, 10]], [fell, -9.81 * (1.1 - impacts[0].time)])
