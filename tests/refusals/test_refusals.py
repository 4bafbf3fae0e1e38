"""Every public callable, argument by argument: hostile values are refused in one sentence, and change nothing."""

from __future__ import annotations

import functools
import inspect
import math
import subprocess
import sys
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import jackbox_env
from jackbox_env import JackInBoxEnv, JackInBoxVectorEnv, Scene, make_simulator, mechanics, states
from jackbox_env.sb3 import make_sb3_vec_env
from jackbox_env.simulators import CONTACT_MODELS, Simulator
from tests.refusals.kinds import Hostile, out, real
from tests.refusals.table import TABLE, Row, simulator


def flat(seen: Any) -> list[Any]:
    """Everything in nested results, as plain values that compare by ==."""
    if isinstance(seen, Mapping):
        return [part for key in sorted(seen) for part in [key, *flat(seen[key])]]
    if isinstance(seen, tuple | list):
        return [part for value in seen for part in flat(value)]
    if isinstance(seen, np.ndarray):
        return [str(seen.dtype), seen.shape, seen.tobytes()]
    return [repr(seen) if isinstance(seen, Scene | float | int | np.generic) else type(seen).__name__]


@functools.cache
def made(row: int) -> Any:
    return TABLE[row].subject.make()


@functools.cache
def expected(row: int, argument: str) -> list[Any]:
    """What the good call gives."""
    return result(TABLE[row], made(row), argument, TABLE[row].arguments[argument].good)


def result(row: Row, one: Any, argument: str, value: Any) -> list[Any]:
    row.subject.start(one)
    returned = row.call(one, **{**row.good, argument: value})
    return flat([returned, row.subject.shown(one)])


def refusal(row: Row, one: Any, argument: str, hostile: Hostile) -> None:
    """Hold a call with a hostile value against what is promised."""
    row.subject.start(one)
    before = flat(row.subject.shown(one))
    with pytest.raises(hostile.error) as refused:
        row.call(one, **{**row.good, argument: hostile.value})
    sentence = str(refused.value)
    assert refused.type is hostile.error
    assert 10 < len(sentence) < 300
    assert "\n" not in sentence
    named = hostile.named or row.arguments[argument].named or argument.rpartition(".")[2]
    for word in (named, *hostile.told):
        assert word in sentence
    assert flat(row.subject.shown(one)) == before, "changed by what it refused"


CALLS = [
    pytest.param(number, argument, id=f"{row.name}({argument}){row.contact}")
    for number, row in enumerate(TABLE)
    for argument in row.arguments
]


@pytest.mark.parametrize(("row", "argument"), CALLS)
def test_hostile_values_are_refused_in_one_sentence_and_change_nothing(row: int, argument: str) -> None:
    one, good, kind = made(row), expected(row, argument), TABLE[row].arguments[argument]
    for name, hostile in kind.refused.items():
        print(name)  # shown where it fails
        refusal(TABLE[row], one, argument, hostile)
        if one is not None:
            assert result(TABLE[row], one, argument, kind.good) == good


@pytest.mark.parametrize(("row", "argument"), CALLS)
def test_other_forms_give_the_same_bits_and_the_ends_of_a_range_are_taken(row: int, argument: str) -> None:
    kind = TABLE[row].arguments[argument]
    for name, value in kind.alike.items():
        print(name)
        assert result(TABLE[row], made(row), argument, value) == expected(row, argument)
    for value in kind.taken:
        result(TABLE[row], made(row), argument, value)


ARRAYS = [
    pytest.param(row, argument, id=f"{row.name}({argument}){row.contact}")
    for row in TABLE
    for argument, kind in row.arguments.items()
    if isinstance(kind.good, np.ndarray)
]


@pytest.mark.parametrize(("row", "argument"), ARRAYS)
def test_a_given_array_is_not_kept(row: Row, argument: str) -> None:
    one, given = row.subject.make(), row.arguments[argument].good.copy()
    row.subject.start(one)
    returned = row.call(one, **{**row.good, argument: given})
    before = flat([returned, row.subject.shown(one)])
    given[...] = 0
    assert flat([returned, row.subject.shown(one)]) == before


# -- what is refused for another argument's sake -----------------------------------------------------------------------

MAKERS: dict[str, Any] = {
    "class": JackInBoxEnv,
    "make": functools.partial(gym.make, "JackInBox-v0"),
    "sync": functools.partial(gym.make_vec, "JackInBox-v0", num_envs=2, vectorization_mode="sync"),
    "vector class": functools.partial(JackInBoxVectorEnv, 2),
    "make_vec": functools.partial(gym.make_vec, "JackInBox-v0", num_envs=2),
}


@pytest.mark.parametrize("maker", MAKERS)
def test_an_unknown_argument_is_told_the_closest_and_one_of_others_where_it_belongs(maker: str) -> None:
    with pytest.raises(TypeError, match="no argument 'contct' .*'contact'.*: it takes .*randomize") as refused:
        MAKERS[maker](contct="exact")
    assert "\n" not in str(refused.value)
    for name in () if "vec" in maker else ("with_infos", "num_threads"):
        with pytest.raises(TypeError, match=f"no argument '{name}': it belongs to the native vector environment"):
            MAKERS[maker](**{name: True})


def test_unknown_keys_are_told_the_closest() -> None:
    with pytest.raises(ValueError, match=r"takes only .*, got 'with_info' \(did you mean 'with_infos'"):
        make_sb3_vec_env(2, with_info=True)
    with pytest.raises(ValueError, match=r"got 'scen' \(did you mean 'scene'\?\)"):
        JackInBoxEnv().reset(options={"scen": {}})
    with pytest.raises(ValueError, match="takes only 'substeps', 'iterations', got 'something'"):
        make_simulator(None, "exact", something=1)


@pytest.mark.parametrize("make", [make_simulator, JackInBoxEnv, functools.partial(JackInBoxVectorEnv, 2)])
def test_the_exact_model_has_no_substeps(make: Any) -> None:
    with pytest.raises(ValueError, match="contact='exact' has no .*substeps=4"):
        make(contact="exact", substeps=4)
    if make is not make_simulator:
        with pytest.raises(ValueError, match=r"fidelity='exact' stands for .*substeps=4"):
            make(fidelity="exact", substeps=4)


def test_a_tensor_with_gradients_is_told_to_detach() -> None:
    torch = pytest.importorskip("torch")
    for env, shape in ((JackInBoxEnv(), (1,)), (JackInBoxVectorEnv(2), (2, 1))):
        env.reset()
        with pytest.raises(TypeError, match=r"actions? must .*requires grad: pass its detach\(\)"):
            env.step(torch.ones(shape, requires_grad=True))
        env.step(torch.ones(shape, requires_grad=True).detach())


def test_a_step_needs_a_reset_of_all() -> None:
    env = JackInBoxVectorEnv(2, contact="exact")
    for mask in ([True, False], [True, True]):
        with pytest.raises(RuntimeError, match="step must come after a reset of all environments"):
            env.step(None)
        env.reset(options={"reset_mask": np.array(mask)})
    env.step(None)


@pytest.mark.parametrize("contact", CONTACT_MODELS)
def test_an_unusable_action_is_ignored_only_where_an_episode_waits(contact: str) -> None:
    env = JackInBoxVectorEnv(2, contact=contact, max_episode_steps=2)
    env.reset(seed=0)
    env.step(None)
    env.reset(options={"reset_mask": np.array([False, True])})
    assert env.step(None)[3].tolist() == [True, False]
    before = env.states
    with pytest.raises(ValueError, match="action must be a finite number .* got nan for environment 1"):
        env.step(np.full((2, 1), math.nan))
    np.testing.assert_array_equal(env.states, before)
    env.step(np.array([[math.nan], [0.5]]))
    assert env.times.tolist() == [0.0, 0.04]


def test_times_run_out() -> None:
    env = JackInBoxVectorEnv(2, contact="exact", scene={"drive": None})
    env.reset(options={"time": [0.0, 1e9]})
    with pytest.raises(ValueError, match="dt must move the time and end by 1e[+]09 s, got 0.02 at t = 1e[+]09 s"):
        env.step(None)


def test_more_environments_than_there_is_room_for_are_refused_at_once() -> None:
    # A child process with little address space stands for a machine without free memory.
    code = (
        "import resource, jackbox_env, gymnasium\n"
        "resource.setrlimit(resource.RLIMIT_AS, (6 * 2**30, 6 * 2**30))\n"
        "for contact in ('exact', 'pymunk'):\n"
        "    try:\n        gymnasium.make_vec('JackInBox-v0', num_envs=50_000_000, contact=contact)\n"
        "    except MemoryError as error:\n        print(error)"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert ran.stdout.count("Unable to allocate") == 2


# -- that nothing is left out, and that the checks can fail ------------------------------------------------------------

# Records and errors; a protocol; checked where it is used.
WITHOUT_ARGUMENTS = {"Impact", "Fit", "Linearization", "Rollout", "JackLostError", "Simulator", "Task", "TaskError"}
WITHOUT_ARGUMENTS |= {"Recording", "fit"}  # tests/measuring/test_fitting.py
# These check nothing, for speed: their caller has checked the arguments.
UNCHECKED = {
    "contacts_of", "impact_maps", "energy_of", "clearance", "deepest_restored", "start_tolerance", "refuse_no_scene",
}  # fmt: skip
# Gymnasium checks it, or there is no end to what is right.
ELSEWHERE = {"JackInBoxEnv.reset": {"seed"}}


def parameters(function: Any) -> set[str]:
    kinds = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
    return {name for name, one in inspect.signature(function).parameters.items() if one.kind not in kinds} - {"self"}


def test_every_public_callable_and_each_of_its_parameters_is_in_the_table() -> None:
    rows = {row.name: {name.partition(".")[0] for name in (*row.arguments, *row.given)} for row in TABLE}
    public = {name: getattr(jackbox_env, name) for name in jackbox_env.__all__}
    expected = {name: one for name, one in public.items() if callable(one) and name not in WITHOUT_ARGUMENTS}
    for module in (mechanics, states):
        for name, one in inspect.getmembers(module, inspect.isfunction):
            if one.__module__ == module.__name__ and not name.startswith("_"):
                expected[name] = one
    for kind in (Simulator, JackInBoxEnv, JackInBoxVectorEnv):
        for name, one in inspect.getmembers(kind, inspect.isfunction):
            if one.__qualname__ == f"{kind.__name__}.{name}" and name[0] != "_" and parameters(one):
                expected[f"{kind.__name__}.{name}"] = one
    assert len(expected) > 20
    missing = {name: parameters(one) - rows.get(name, set()) for name, one in expected.items() if name not in UNCHECKED}
    assert {name: left for name, left in missing.items() if left} == ELSEWHERE


def controlled(call: Any) -> Row:
    """A row of a function that is called with a simulator and a number."""
    return Row("control", lambda one: lambda dt: call(one, dt), {"dt": real(0.5, above=0.0)}, simulator("exact"))


def raising(error: Exception) -> Any:
    def refuse(one: Simulator, dt: Any) -> None:
        raise error

    return refuse


def careless(one: Simulator, dt: Any) -> None:
    one.step(0.02, 0.0)
    one.step(dt)


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        (lambda one, dt: None, "DID NOT RAISE"),
        (raising(KeyError("dt must be above 0, got nan")), "dt must"),
        (raising(TypeError("dt must be above 0, got nan")), "dt must"),
        (raising(ValueError("it must be above 0, got nan")), "dt"),
        (raising(ValueError("dt must be above 0, got what?")), "nan"),
        (raising(ValueError("dt must be above 0,\ngot nan")), "not in"),
        (raising(ValueError("dt must be above 0, got nan" + 400 * "!")), "<"),
        (careless, "changed by what it refused"),
    ],
)
def test_a_bad_answer_would_be_seen(call: Any, complaint: str) -> None:
    with pytest.raises((AssertionError, KeyError, TypeError, pytest.fail.Exception), match=complaint):
        refusal(controlled(call), simulator("exact").make(), "dt", out(math.nan, "nan", "0"))
