"""The physics in the browser: the bits of the page's WebAssembly module are those of the package."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray

from jackbox_env import Scene
from jackbox_env.exact.geometry import _QUARTER_HIGH
from jackbox_env.exact.pcg64 import generator_of, seeded
from jackbox_env.model.tasks import TASKS, sample_start
from scripts.site.build import HERE, ROOT, ensure_page
from scripts.site.entries import MOST_IMPACTS
from tests.browser import Opened


class Case(NamedTuple):
    """Steps in a scene, under torques that last for ten steps or under the chirp."""

    task: str
    fields: dict[str, Any]
    chirp: bool = False
    dt: float = 0.02
    steps: int = 11_000


CASES = [
    Case("juggle", {}),
    Case("spin", {}, chirp=True),
    Case("rattle", {"restitution": 0.7}),
    Case("juggle", {"restitution": 0.0}, chirp=True),
    Case("spin", {"restitution": 0.5, "jack_arm": 2.0}, dt=0.1),
    Case("rattle", {"jack_arm": 6.5}),
    Case("juggle", {"gravity": 1.62, "jack_mass": 400.0}),
    Case("spin", {"jack_mass": 0.4, "gravity": 25.0}),
    Case(
        "rattle",
        {"box_half_width": 2.0, "box_mass": 50.0, "torque_limit": 500.0, "drive": {"amplitude": 500.0}},
        chirp=True,
    ),
    Case("juggle", {"restitution": 0.9, "jack_arm": 0.2}, dt=0.005),
]


def shares(case: Case) -> list[float | None]:
    """The torque of each step as a share of the limit; None: the chirp."""
    drawn = np.random.default_rng(len(str(case))).uniform(-1.0, 1.0, case.steps // 10).astype(np.float32)
    return [None] * case.steps if case.chirp else list(np.repeat(drawn, 10).tolist())


def by_python(case: Case) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """The numbers that ``stepping.js`` returns, by the environment."""
    scene = Scene.of(case.fields)
    keywords: dict[str, Any] = {"task": case.task, "control_dt": case.dt, "observation": "landing"}
    env: Any = gym.make("JackInBox-v0", scene=scene, contact="exact", episode_steps=None, **keywords).unwrapped
    env.reset()
    env.set_state(sample_start(scene, generator_of(seeded(1))))
    numbers, observations = list[float](), list[NDArray[np.float32]]()
    for share in shares(case):
        observation, reward, *_, info = env.step(None if share is None else [share])
        numbers += [*info["state"].tolist(), info["impacts"], info["impulse"], info["torque"], reward]
        for impact in env.impacts[:MOST_IMPACTS]:
            numbers += impact
        observations.append(observation)
    return np.array(numbers), np.concatenate(observations)


def run(opened: Opened, module: str, cases: Sequence[Case] = (), episodes: Sequence[tuple[str, int]] = ()) -> Any:
    """What ``stepping.js`` returns in the page, by a module, base64; an episode is a task and the seed of its start."""
    asked = [
        {"task": one.task, "values": list(Scene.of(one.fields).numbers), "dt": one.dt, "shares": shares(one)}
        for one in cases
    ]
    starts = [(task, _words(seed)) for task, seed in episodes]
    physics, steps = (HERE / "physics.js").read_text(), Path(__file__).with_name("stepping.js").read_text()
    script = f"(argument) => {{ {physics} return ({steps})(argument); }}"
    return opened.page.evaluate(script, [module, _words(1), asked, starts])


def _words(seed: int) -> list[str]:
    return [str(word) for word in seeded(seed)[:4].tolist()]


def _numbers(text: str, kind: str) -> NDArray[Any]:
    return np.frombuffer(base64.b64decode(text), kind)


def by_browser(
    opened: Opened, module: str, cases: Sequence[Case]
) -> list[tuple[NDArray[np.float64], NDArray[np.float32]]]:
    """The numbers of the cases, by the page."""
    return [
        (_numbers(numbers, "<f8"), _numbers(observations, "<f4"))
        for numbers, observations in run(opened, module, cases)["steps"]
    ]


def differing(numbers: NDArray[Any], expected: NDArray[Any]) -> int:
    """The number of bits that differ; of arrays of other lengths, all."""
    if numbers.shape != expected.shape:
        return 8 * max(numbers.nbytes, expected.nbytes)
    return int(np.unpackbits(numbers.view(np.uint8) ^ expected.view(np.uint8)).sum())


@pytest.fixture(scope="module")
def opened(browser: Any) -> Any:
    opened = Opened(browser, ensure_page())
    yield opened
    opened.close()


@pytest.fixture(scope="module")
def module(opened: Opened) -> str:
    return str(json.loads(opened.page.locator("#data").text_content())["module"])


def test_no_bit_of_110_000_steps_differs(opened: Opened, module: str, cases: Callable[[int], int]) -> None:
    chosen = [case._replace(steps=cases(case.steps)) for case in CASES]
    for case, (numbers, observations) in zip(chosen, by_browser(opened, module, chosen), strict=True):
        expected_numbers, expected_observations = by_python(case)
        assert differing(numbers, expected_numbers) == 0, case
        assert differing(observations, expected_observations) == 0, case
        assert numbers.size > 16 * case.steps  # impacts among them


def test_another_last_bit_of_one_constant_is_noticed(opened: Opened, module: str) -> None:
    code = base64.b64decode(module)
    changed = code.replace(struct.pack("<d", -_QUARTER_HIGH), struct.pack("<d", -np.nextafter(_QUARTER_HIGH, 0.0)))
    assert changed != code
    case = CASES[0]._replace(steps=1000)
    ((numbers, _),) = by_browser(opened, base64.b64encode(changed).decode(), [case])
    assert differing(numbers, by_python(case)[0]) > 0


@pytest.mark.parametrize("task", TASKS)
def test_the_agent_in_the_page_earns_its_return(task: str, opened: Opened, module: str) -> None:
    rows = json.loads((ROOT / "docs" / "benchmark.json").read_text())["policies"]
    (row,) = [one for one in rows if (one["task"], one["policy"], one["contact"]) == (task, "ppo", "exact")]
    returns = run(opened, module, episodes=[(task, seed) for seed in range(2, 130)])["returns"]
    deviation = np.std(returns) / np.sqrt(len(returns))
    assert abs(np.mean(returns) - row["mean"]) < 3.0 * np.sqrt(2.0) * deviation < 0.2 * row["mean"], np.mean(returns)
