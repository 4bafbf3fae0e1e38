"""Every public callable, argument by argument: hostile values are refused in one sentence, and change nothing."""

from __future__ import annotations

import functools
import inspect
import math
import re
from collections.abc import Callable, Mapping
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import jackbox_env
from agents.policies.planner import Planner
from agents.policies.registry import find_policy
from agents.settings import EnvSettings, TrainSettings
from jackbox_env import (
    Chirp,
    JackInBoxEnv,
    JackInBoxVectorEnv,
    Motion,
    Scene,
    Task,
    make_simulator,
    mechanics,
    rollout,
    states,
)
from jackbox_env.model.tasks import juggle
from jackbox_env.sb3 import make_sb3_vec_env
from jackbox_env.simulators import Simulator
from tests.refusals.kinds import Hostile, out, real
from tests.refusals.motions import ROWS
from tests.refusals.table import START, Row, simulator
from tests.refusals.table import TABLE as OTHERS

TABLE = [*OTHERS, *ROWS]


def flat(seen: Any) -> list[Any]:
    """Everything in nested results, as plain values that compare by ==."""
    if isinstance(seen, Mapping):
        return flat([(key, seen[key]) for key in sorted(seen)])
    if isinstance(seen, tuple | list):
        return [part for value in seen for part in flat(value)]
    plain = repr(seen) if isinstance(seen, Scene | float | int | str | np.generic) else type(seen).__name__
    return [str(seen.dtype), seen.shape, seen.tobytes()] if isinstance(seen, np.ndarray) else [plain]


@functools.cache
def made(row: int) -> Any:
    return TABLE[row].subject.make()


@functools.cache
def expected(row: int, argument: str) -> list[Any]:
    """The result of the good call."""
    return result(TABLE[row], made(row), argument, TABLE[row].arguments[argument].good)


def result(row: Row, one: Any, argument: str, value: Any) -> list[Any]:
    row.subject.start(one)
    returned = row.call(one, **{argument: value})
    return flat([returned, row.subject.shown(one)])


def refusal(row: Row, one: Any, argument: str, hostile: Hostile) -> None:
    """Assert that a call with a hostile value raises the promised error and changes nothing."""
    row.subject.start(one)
    before = flat(row.subject.shown(one))
    with pytest.raises(hostile.error) as refused:
        row.call(one, **{argument: hostile.value})
    sentence = str(refused.value)
    assert refused.type is hostile.error
    assert len(sentence) < 300
    assert "\n" not in sentence
    named = hostile.named or row.arguments[argument].named or argument.rpartition(".")[2]
    assert [word for word in (named, *hostile.mentioned) if word not in sentence] == [], sentence
    assert flat(row.subject.shown(one)) == before, "changed by what it refused"


CALLS = [
    pytest.param(number, argument, id=f"{row.name}({argument}){row.contact}")
    for number, row in enumerate(TABLE)
    for argument in row.arguments
]


@pytest.mark.parametrize(("row", "argument"), CALLS)
def test_hostile_values_are_refused_in_one_sentence_and_change_nothing(row: int, argument: str) -> None:
    one, good, kind = made(row), expected(row, argument), TABLE[row].arguments[argument]
    for hostile in kind.refused.values():
        refusal(TABLE[row], one, argument, hostile)
        if one is not None:
            assert result(TABLE[row], one, argument, kind.good) == good


@pytest.mark.parametrize(("row", "argument"), CALLS)
def test_other_forms_give_the_same_bits_and_the_ends_of_a_range_are_accepted(row: int, argument: str) -> None:
    kind = TABLE[row].arguments[argument]
    for value in kind.alike.values():
        assert result(TABLE[row], made(row), argument, value) == expected(row, argument)
    for value in kind.accepted:
        result(TABLE[row], made(row), argument, value)


ARRAYS = [
    pytest.param(number, argument, id=f"{row.name}({argument}){row.contact}")
    for number, row in enumerate(TABLE)
    for argument, kind in row.arguments.items()
    if isinstance(kind.good, np.ndarray)
]


@pytest.mark.parametrize(("number", "argument"), ARRAYS)
def test_an_array_that_was_passed_may_change_later(number: int, argument: str) -> None:
    row, one = TABLE[number], made(number)
    passed = row.arguments[argument].good.copy()
    row.subject.start(one)
    returned = row.call(one, **{argument: passed})
    before = flat([returned, row.subject.shown(one)])
    passed[...] = 0
    assert flat([returned, row.subject.shown(one)]) == before


# -- what is refused for another argument's sake -----------------------------------------------------------------------


def with_gradients() -> Any:
    return pytest.importorskip("torch").ones(1, requires_grad=True)


MODELS: Any = np.array(["pymunk", "exact"])
ARRAY = "^fidelity='coarse' stands for contact='pymunk', got contact="
SENTENCES: list[tuple[Callable[[], object], type[Exception], str]] = [
    (lambda: JackInBoxEnv(contct="exact"), TypeError, "no argument 'contct' .*'contact'.*: it accepts .*randomize"),
    (lambda: gym.make("JackInBox-v0", contct="exact"), TypeError, "no argument 'contct' .*'contact'"),
    (lambda: JackInBoxEnv(num_threads=2), TypeError, "'num_threads': it belongs to the native vector environment"),
    (lambda: make_sb3_vec_env(2, with_info=True), ValueError, r"got 'with_info' \(did you mean 'with_infos'"),
    (lambda: JackInBoxEnv().reset(options={"scen": {}}), ValueError, r"got 'scen' \(did you mean 'scene'\?\)"),
    (lambda: make_simulator(None, "exact", something=1), ValueError, "accepts only 'substeps', 'iterations'"),
    (lambda: make_simulator(None, "exact", substeps=4), ValueError, "contact='exact' has no .*substeps=4"),
    (lambda: JackInBoxEnv(contact="exact", substeps=4), ValueError, "contact='exact' has no .*substeps=4"),
    (lambda: JackInBoxEnv(fidelity="exact", substeps=4), ValueError, "fidelity='exact' stands for .*substeps=4"),
    (lambda: make_simulator(fidelity="fine", substeps=4), ValueError, "fidelity='fine' stands for .*substeps=4"),
    (lambda: make_simulator(fidelity="exact", iterations=9), ValueError, "contact='exact' has no .*iterations=9"),
    (
        lambda: Scene(**dict[str, Any](mass=2.0)),
        TypeError,
        r"^Scene has no argument 'mass' \(did you mean 'box_mass'\?\)",
    ),
    (
        lambda: Chirp(**{"amplitud": 2.0}),
        TypeError,
        r"^Chirp has no argument 'amplitud' \(did you mean 'amplitude'\?\)",
    ),
    (lambda: Task(abs), TypeError, "names of its terms and a function, got <built-in function abs>$"),
    (
        lambda: Task(juggle),
        TypeError,
        r'write Task\(\("reward",\), juggle\) for juggle\(scene, state, torque, impulse\)$',
    ),
    (lambda: JackInBoxEnv().step(with_gradients()), TypeError, r"action must .*requires grad: pass its detach\(\)"),
    (lambda: JackInBoxEnv().step(None), gym.error.ResetNeeded, "step must come after a reset, got none yet"),
    (lambda: JackInBoxVectorEnv(2).step(None), RuntimeError, "step must come after a reset of all environments"),
    (lambda: JackInBoxEnv(randomize={"jack_inertia": (1e-6, 4.0)}), ValueError, "jack_inertia=1e-06"),
    (lambda: rollout(None, START, np.zeros(5), 0.02, time=1e9), ValueError, "dt .* end by 1e[+]09 s"),
    (
        lambda: make_sb3_vec_env(2, autoreset_mode=0.0),
        ValueError,
        "accepts only .* got 'autoreset_mode'",
    ),
    (lambda: make_sb3_vec_env(2, gravity=0.0), ValueError, "make_sb3_vec_env accepts only .* got 'gravity'"),
    (lambda: JackInBoxEnv(fidelity="coarse", contact=MODELS), ValueError, ARRAY),
    # settings of trainings, and policies
    (lambda: TrainSettings(scene="[1]"), ValueError, r"scene must .*\[1"),
    (lambda: TrainSettings(scene="{"), ValueError, "scene must .*{"),
    (lambda: find_policy("pid", EnvSettings(), 0), FileNotFoundError, "must be one of .*planner, .*ppo, .* got 'pid'"),
    (lambda: find_policy("value", EnvSettings(), 0), FileNotFoundError, "a policy must be one of .* got 'value'"),
    (lambda: Planner(Scene(), samples=1), ValueError, "samples must .*, got 1"),
    (lambda: Planner(Scene(), elites=300), ValueError, "elites must .*, got 300"),
    (lambda: Planner(Scene(), knots=1), ValueError, "knots must .*, got 1"),
    (lambda: Planner(Scene(), repeat=0), ValueError, "repeat must .*, got 0"),
    (lambda: Planner(Scene(), num_threads=0), ValueError, "num_threads must .*, got 0"),
    (lambda: Planner(Scene(), control_dt=0.0), ValueError, "control_dt must .*, got 0.0"),
    (lambda: Planner(Scene(), value="good"), TypeError, "value must be .*, got 'good'"),  # type: ignore[arg-type]
    (
        lambda: JackInBoxEnv(action_repeat="bounce", control_dt=1e-19),
        ValueError,
        "control_dt .* at least 2e-06, got 1e-19",
    ),
]


@pytest.mark.parametrize(("call", "error", "sentence"), SENTENCES)
def test_a_wrong_name_or_combination_is_refused(call: Any, error: type[Exception], sentence: str) -> None:
    with pytest.raises(error, match=sentence):
        call()


# -- that nothing is left out, and that the checks can fail ------------------------------------------------------------

# Records and errors; a protocol; checked where it is used.
WITHOUT_ARGUMENTS = {
    "Impact", "Fit", "Linearization", "Rollout", "State", "StepResult", "JackLostError", "Motion", "Simulator", "Task",
    "TaskError", "Recording", "fit",  # tests/measuring/test_fitting.py
}  # fmt: skip
# These check nothing, for speed: their caller has checked the arguments.
UNCHECKED = {
    "Action", "JackInBoxVectorEnv.set_attr", "Observation", "Simulator.restore", "Simulator.step_checked",
    "Simulator.stepped", "contacts_of",
    "impact_maps", "energy_of", "clearance", "deepest_restored", "start_tolerance", "refuse_no_scene",
}  # fmt: skip
# Gymnasium checks it, or there is no end to what is right.
ELSEWHERE = {"JackInBoxEnv.reset": {"seed"}, "Motion.save": {"path"}}


def parameters(function: Any) -> set[str]:
    kinds = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
    return {name for name, one in inspect.signature(function).parameters.items() if one.kind not in kinds} - {"self"}


def test_every_public_callable_and_each_of_its_parameters_is_in_the_table() -> None:
    rows = {row.name: {name.partition(".")[0] for name in row.arguments} for row in TABLE}
    public = {name: getattr(jackbox_env, name) for name in set(jackbox_env.__all__) - WITHOUT_ARGUMENTS}
    for owner in (mechanics, states, Simulator, JackInBoxEnv, JackInBoxVectorEnv, Motion):
        for name, one in inspect.getmembers(owner, inspect.isfunction):
            qualified = f"{owner.__name__}.{name}" if inspect.isclass(owner) else name
            if one.__module__ == getattr(owner, "__module__", owner.__name__) and one.__qualname__ == qualified:
                public[qualified] = one
    checked = {name: one for name, one in public.items() if callable(one) and not re.search(r"(^|\.)_", name)}
    assert len(checked) > 20
    missing = {name: parameters(one) - rows.get(name, set()) for name, one in checked.items() if name not in UNCHECKED}
    assert {name: names for name, names in missing.items() if names} == ELSEWHERE


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        (lambda one, dt: None, "DID NOT RAISE"),
        (lambda one, dt: one.reset({}), "state must"),
        (lambda one, dt: one.step(-1.0), "nan"),
        (lambda one, dt: (one.step(0.02), one.step(dt)), "changed by what it refused"),
    ],
)
def test_a_bad_answer_would_be_seen(call: Any, complaint: str) -> None:
    row = Row("control", lambda one: lambda dt: call(one, dt), {"dt": real(0.5, above=0.0)}, simulator("exact"))
    with pytest.raises((AssertionError, TypeError, pytest.fail.Exception), match=complaint):
        refusal(row, row.subject.make(), "dt", out(math.nan, "nan", "0"))
