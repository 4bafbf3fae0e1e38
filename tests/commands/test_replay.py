"""Games as text: `jackbox replay`, and `jackbox play`, whose page shares them."""

from __future__ import annotations

import json
import re
import struct
import sys
import tempfile
import webbrowser
from base64 import urlsafe_b64decode, urlsafe_b64encode
from pathlib import Path
from typing import Any
from urllib.parse import quote

import gymnasium as gym
import numpy as np
import pytest

from jackbox_env import JackLostError, Scene, make_simulator
from jackbox_env.commands import game, play
from jackbox_env.commands.game import read_game, replay_game, write_game
from jackbox_env.model.tasks import sample_start
from jackbox_env.simulators.exact import ExactSimulator
from tests.script import jackbox
from tests.states import started

SCENE: dict[str, Any] = {"jack_mass": 5.0, "gravity": 3.7, "torque_limit": 60000.0, "box_mass": 500.0}
START = sample_start(Scene(**SCENE), np.random.default_rng(3)).tolist()
SHARES = [None] * 200 + [0.25] * 150 + [-0.0] * 3 + [0.0] * 50 + np.linspace(-1.0, 1.0, 197).tolist()
GAME: dict[str, Any] = json.loads(write_game(SCENE, START, SHARES, "rattle"))


def text(**changes: Any) -> str:
    """The game's text with other values; None: without that key."""
    return json.dumps({key: value for key, value in {**GAME, **changes}.items() if value is not None})


def rewards_of(shared: game.Game) -> list[float]:
    differs, steps = replay_game(shared)
    assert differs is None
    return [step.result.reward for step in steps]


RETURN = f"{sum(rewards_of(read_game(text()))[:500]):.1f}"


def encoded(kind: str, *numbers: float) -> str:
    return urlsafe_b64encode(struct.pack(f"<{len(numbers)}{kind}", *numbers)).decode().rstrip("=")


def held(steps: int, mark: int = 0) -> dict[str, str]:
    """Steps of one run without torque, or with the mark of the drive."""
    return {"shares": encoded("d", 0.0), "counts": encoded("H", steps + mark), "checks": encoded("B", *[0] * steps)}


def decoded(name: str, kind: str) -> list[Any]:
    return [number for (number,) in struct.iter_unpack(f"<{kind}", urlsafe_b64decode(GAME[name] + "=="))]


def test_a_text_has_the_runs_of_torques_and_the_hash_of_all_states() -> None:
    simulator, number, checks = started(make_simulator(SCENE, "exact"), START), 0xCBF29CE484222325, bytearray()
    for share, count in zip(decoded("shares", "d"), decoded("counts", "H"), strict=True):
        for _ in range(count % 32768):
            simulator.step(0.02, None if count >= 32768 else share * SCENE["torque_limit"])
            for word in struct.unpack("<12Q", simulator.state.tobytes()):
                number = (number ^ word) * 0x100000001B3 % 2**64
            checks.append(number >> 56)
    assert bytes(decoded("checks", "B")) == checks
    assert int(GAME["digest"], 16) == number


@pytest.mark.parametrize("link", [False, True])
def test_a_text_or_link_replays_with_the_environments_rewards(link: bool) -> None:
    shared = read_game(f"https://a.b/play.html#{quote(text())}" if link else text())
    assert (repr(shared.shares), shared.start.tolist(), shared.task) == (repr(SHARES), START, "rattle")
    env: Any = started(
        gym.make("JackInBox-v0", fidelity="exact", task="rattle", scene=SCENE, episode_steps=None),
        options={"state": START},
    )
    rewards = [env.step(None if share is None else np.array([share]))[1] for share in SHARES]
    assert sum(map(abs, rewards)) > 1.0
    assert rewards_of(shared) == rewards


def test_equal_torques_make_one_run_up_to_its_longest() -> None:
    long = write_game(None, START, [None] * 40_000, "spin", 0.001)
    assert len(long) < 54_000
    assert read_game(long).shares == [None] * 40_000


@pytest.mark.parametrize(
    ("changes", "step"),
    [
        ({"scene": {**SCENE, "gravity": 3.71}}, 1),
        ({"dt": 0.021}, 1),
        ({"start": [*START[:5], START[5] + 1e-15, *START[6:]]}, 1),
        ({"checks": encoded("B", *decoded("checks", "B")[:99], 255 - decoded("checks", "B")[99], *[0] * 500)}, 100),
        ({"digest": "0123456789abcdef"}, 600),
    ],
)
def test_another_motion_is_seen_at_its_first_step(changes: dict[str, Any], step: int) -> None:
    differs, _ = replay_game(read_game(text(**changes)))
    assert differs is not None
    assert step <= differs <= step + 1


def test_the_words_of_a_generator_draw_the_start() -> None:
    state = np.random.default_rng(3).bit_generator.state["state"]
    words = [str(word) for number in (state["state"], state["inc"]) for word in divmod(number, 2**64)]
    assert read_game(text(start=words)).start.tolist() == START


def test_a_game_may_last_as_long_as_the_longest_text_of_the_page() -> None:
    assert len(read_game(text(dt=1.0, **held(1000, 32768))).shares) == 1000
    assert game.LONGEST * 3 / 4 * 0.02 < game.MOST_SECONDS  # its control steps have a byte each, in base64


def test_a_replay_ends_where_its_work_does(monkeypatch: pytest.MonkeyPatch) -> None:
    simulator, work = started(ExactSimulator(Scene(**SCENE)), START), 0.0
    for _ in range(200):
        simulator.step(0.02)
        work += simulator.evaluations
    assert work > 5.0
    monkeypatch.setattr(game, "MOST_WORK", work - 1.0)
    with pytest.raises(JackLostError, match=f"step [0-9]+ of 600 .* needs more than {work - 1.0:,.0f} gap eval"):
        replay_game(read_game(text()))


@pytest.mark.parametrize(
    ("shared", "status", "said"),
    [
        (text(), 0, f"600 steps of rattle, 12 s, return {RETURN} in the first 10 s: the same, bit for bit"),
        (text(digest="0" * 16), 1, "600 steps of rattle, 12 s: it differs from step 600 on"),
        (write_game(None, START), 0, "This game of juggle has no steps: there is nothing to compare"),
        (text()[:-1], 2, "a game must be a JSON object, got .*"),
    ],
)
def test_the_command_compares(shared: str, status: int, said: str, tmp_path: Path) -> None:
    done = jackbox("replay", shared, cwd=tmp_path, status=status)
    assert re.fullmatch(f"{said}\n", done.stderr if status == 2 else done.stdout)


# -- play -------------------------------------------------------------------------------------------------------------

HINT = "`jackbox play --out FILE` writes a copy to send.\n"


@pytest.mark.parametrize("opens", [True, False])
def test_play_opens_its_page_or_says_that_it_cannot_and_writes_a_new_file(
    opens: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def printed(*words: str) -> tuple[str, str]:
        monkeypatch.setattr(sys, "argv", ["jackbox play", *words])
        play.main()
        return capsys.readouterr()

    def show(address: str) -> bool:
        opened.append(address)
        return opens

    opened, page, copy = list[str](), tmp_path / "a b.html", tmp_path / "copy.html"
    monkeypatch.setattr(webbrowser, "open", show)
    monkeypatch.setattr(play, "PAGE", page)
    with pytest.raises(SystemExit):
        printed()
    assert "built without its page" in capsys.readouterr().err
    page.write_text("the page")
    out, err = printed()
    assert (out, "No browser" in err, HINT in err) == (f"Opening {page}\n", not opens, True)
    assert printed("--no-browser")[0] == f"{page}\n"
    assert (printed("--out", str(copy)), copy.read_text()) == ((f"{copy}\n", ""), "the page")
    assert opened == [f"{tmp_path.as_uri()}/a%20b.html"]


def test_without_a_folder_to_write_to_the_page_is_in_a_temporary_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    build = pytest.importorskip("scripts.site.build")
    page = build.ensure_page()
    (tmp_path / "file").touch()
    for owner in (play, build):
        monkeypatch.setattr(owner, "PAGE", tmp_path / "file" / "play.html")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    out, err = jackbox("play", "--no-browser", cwd=tmp_path)
    assert Path(out.strip()).read_bytes() == page.read_bytes()
    assert Path(out.strip()).is_relative_to(tmp_path)
    assert "file/play.html cannot be written (Not a directory): the page is in a temporary folder" in err
