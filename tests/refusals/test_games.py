"""Texts of games that cannot be played, and games that a text cannot have, are refused in one sentence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from jackbox_env import JackLostError
from jackbox_env.commands.game import read_game, write_game
from tests.commands.test_replay import GAME, START, encoded, held, text
from tests.refusals.sentences import Refusal, assert_refused, rows


def reading(**changes: Any) -> Callable[[Any], object]:
    return lambda _: read_game(text(**changes))


TEXTS = [
    Refusal(
        lambda _: read_game(text()[:500]),
        ValueError,
        'a game must be a JSON object, got \'{"version": 1, "package": "...", "task": "rattle", '
        '"scene": {"jack_mass": ...',
    ),
    Refusal(lambda _: read_game("[1]"), ValueError, "a game must be a JSON object, got '[1]'"),
    Refusal(
        lambda _: read_game("[" * 60_000),
        ValueError,
        "a game must be a JSON object, got "
        "'[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[...",
    ),
    Refusal(reading(package="a" * 65_536), ValueError, "a game must have at most 65,536 characters, got 69,..."),
    Refusal(reading(version=2), ValueError, "a game's version must be 1, which jackbox ... reads, got 2"),
    Refusal(reading(version=True), ValueError, "a game's version must be 1, which jackbox ... reads, got True"),
    Refusal(
        reading(code="f()"),
        ValueError,
        "a game accepts only 'version', 'package', 'task', 'scene', 'dt', 'start', 'shares', "
        "'counts', 'checks', 'digest', got 'code'",
    ),
    Refusal(reading(task="fly"), ValueError, "task must be one of 'juggle', 'spin', 'rattle', got 'fly'"),
    Refusal(reading(dt=2), ValueError, "dt must be a finite number at least 0.001 and at most 1, got 2"),
    Refusal(reading(dt="0.02"), ValueError, "dt must be a finite number at least 0.001 and at most 1, got '0.02'"),
    Refusal(
        reading(scene={"gravity": -1}),
        ValueError,
        "gravity must be a finite number at least 0 and at most 1e+60, got -1",
    ),
    Refusal(
        reading(scene={"jack_arm": float("nan")}),
        ValueError,
        'a game must be a JSON object, got \'{"version": 1, "package": "...", "task": "rattle", '
        '"scene": {"jack_arm": N...',
    ),
    Refusal(
        reading(package=float("inf")),
        ValueError,
        'a game must be a JSON object, got \'{"version": 1, "package": Infinity, "task": "rattle", '
        '"scene": {"jack_mass":...',
    ),
    Refusal(
        reading(package=[{"a": -float("inf")}]),
        ValueError,
        'a game must be a JSON object, got \'{"version": 1, "package": [{"a": -Infinity}], "task": '
        '"rattle", "scene": {"j...',
    ),
    Refusal(reading(dt=1.0, **held(1001)), ValueError, "a game must last at most 1,000 s, got 1,001 s"),
    Refusal(reading(dt=0.75, **held(1334, 32768)), ValueError, "a game must last at most 1,000 s, got 1,000.5 s"),
    Refusal(
        reading(scene={"jack_arm": 9}),
        ValueError,
        "jack_arm must be below sqrt(2) * box_half_width = 8.48528 m to fit, got 9 m",
    ),
    Refusal(
        reading(scene={"torque_limit": 0}),
        ValueError,
        "torque_limit must be a finite number at least 1e-60 and at most 1e+60, got 0",
    ),
    Refusal(
        reading(scene={"box_mass": 9e59}),
        ValueError,
        "box_inertia must be a finite number at least 1e-60 and at most 1e+60, got 3.24e+61",
    ),
    Refusal(
        reading(scene={"box_inertia": 9}),
        ValueError,
        "a game's scene accepts only 'jack_mass', 'jack_arm', 'restitution', 'gravity', "
        "'torque_limit', 'box_mass', got 'box_inertia'",
    ),
    Refusal(reading(scene=[1]), ValueError, "scene must be a Scene, a dict of its fields or None, got [1]"),
    Refusal(
        reading(start=None),
        ValueError,
        "start must be a list of 12 numbers, or 4 words of a generator, each below 2^64 and the last one odd, got None",
    ),
    Refusal(reading(start=[0.0] * 11), ValueError, "state must have shape (12,), got shape (11,)"),
    Refusal(
        reading(start=[True, *START[1:]]),
        ValueError,
        "start must be a list of 12 numbers, or 4 words of a generator, each below 2^64 and the last "
        "one odd, got [True, 0.0, 0.0, -0.8287016657127513, -0.5263789868078006, "
        "0.3012744652063969...",
    ),
    Refusal(
        lambda _: read_game(text(start=[0.5, *START[1:]]).replace("0.5", "1e999", 1)),
        ValueError,
        "a number of start must be a finite number at least -1e+06 and at most 1e+06, got inf",
    ),
    Refusal(
        reading(start=[*START[:3], 8.0, *START[4:]]),
        ValueError,
        "a start must have every foot inside the box (at most 1e-09 m outside), got a foot 2.95496 m "
        "outside; set_state restores states in contact",
    ),
    Refusal(
        reading(start=["1", "2", "3", "4"]),
        ValueError,
        "start must be a list of 12 numbers, or 4 words of a generator, each below 2^64 and the last "
        "one odd, got ['1', '2', '3', '4']",
    ),
    Refusal(
        reading(start=["1", "2", str(2**64), "5"]),
        ValueError,
        "start must be a list of 12 numbers, or 4 words of a generator, each below 2^64 and the last "
        "one odd, got ['1', '2', '18446744073709551616', '5']",
    ),
    Refusal(
        reading(shares=None), ValueError, "shares must be base64url without padding, of 8 bytes a number, got None"
    ),
    Refusal(
        reading(shares=GAME["shares"] + "="),
        ValueError,
        "shares must be base64url without padding, of 8 bytes a number, got "
        "'AAAAAAAAAAAAAAAAAADQPwAAAAAAAACAAAAAAAAAAAAAAAAAAADwv-tDY31orO-_1ofG-tBY77_B...",
    ),
    Refusal(
        reading(shares="AAAA"), ValueError, "shares must be base64url without padding, of 8 bytes a number, got 'AAAA'"
    ),
    Refusal(
        reading(shares=encoded("d", 0.5, 0.5)),
        ValueError,
        "a game must have a count of at least 1 step for each share, and a check for each step, got "
        "2 shares, 201 counts of 600 steps, and 600 checks",
    ),
    Refusal(
        reading(counts=encoded("H", 0, *[3] * 200)),
        ValueError,
        "a game must have a count of at least 1 step for each share, and a check for each step, got "
        "201 shares, 201 counts of 600 steps, and 600 checks",
    ),
    Refusal(
        reading(checks=GAME["checks"][:-4]),
        ValueError,
        "a game must have a count of at least 1 step for each share, and a check for each step, got "
        "201 shares, 201 counts of 600 steps, and 597 checks",
    ),
    Refusal(
        reading(shares=encoded("d", 1.5), counts=encoded("H", 600)),
        ValueError,
        "shares must be from -1 to 1, and 0 where the scene's drive acts, got 1.5",
    ),
    Refusal(
        reading(shares=encoded("d", float("nan")), counts=encoded("H", 600)),
        ValueError,
        "shares must be from -1 to 1, and 0 where the scene's drive acts, got nan",
    ),
    Refusal(
        reading(shares=encoded("d", 0.5), counts=encoded("H", 600 + 32768)),
        ValueError,
        "shares must be from -1 to 1, and 0 where the scene's drive acts, got 0.5",
    ),
    Refusal(reading(digest="0x12"), ValueError, "digest must be 16 digits of 0-9 and a-f, got '0x12'"),
]
GAMES = [
    Refusal(
        lambda _: write_game({"box_half_width": 7.0}, START),
        ValueError,
        "scene may differ from the default in jack_mass, jack_arm, restitution, gravity, "
        "torque_limit, box_mass only, got Scene(box_half_width=7.0, box_mass=400.0, "
        "box_inertia=19600.0, jack_arm=1.0, ...",
    ),
    Refusal(
        lambda _: write_game(None, START, [2]),
        ValueError,
        "a share must be a finite number at least -1 and at most 1, got 2",
    ),
    Refusal(
        lambda _: write_game(None, [0.0] * 11 + [2e5], [0.0, 1.0], dt=1.0),
        JackLostError,
        "step 2 of 2 cannot be followed: the jack needs more than 1,000,000 gap evaluations in the "
        "dt = 1 s after t = 1 s; use a smaller time step or less torque",
    ),
]


@rows([*TEXTS, *GAMES])
def test_a_bad_game_is_refused_in_one_sentence(row: Refusal) -> None:
    assert_refused(row)
