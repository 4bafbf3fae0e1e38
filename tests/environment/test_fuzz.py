"""Hostile values for every public function and constructor."""

from __future__ import annotations

import contextlib
import dataclasses
import inspect
import math
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium as gym
import pytest

import jackbox_env
from jackbox_env import (
    Chirp,
    Drive,
    JackInBoxEnv,
    JackInBoxVectorEnv,
    Lookahead,
    LookaheadVector,
    Scene,
    cheapest,
    make_simulator,
    mechanics,
    rollout,
    states,
    tasks,
)
from jackbox_env.sb3 import EnvView, JackInBoxVecEnv, make_sb3_vec_env
from jackbox_env.sb3_wrappers import LookaheadVecEnv
from jackbox_env.simulators import CONTACT_MODELS, Simulator
from tests.environment.subjects import CALLS, EVERY_MODEL, SHOWN_BY_GYMNASIUM, START, Values, hurt, simulator_of
from tests.hostile import EVERYTHING, NUMBERS, answer, arrays


def failures(call: Callable[[Any], Any], values: Values) -> list[str]:
    """The values that get a wrong answer."""
    found = []
    for name, make in values.items():
        try:
            answer(lambda make=make: call(make()))  # type: ignore[misc]
        except AssertionError as error:
            found.append(f"{name}: {error}")
    return found


# -- without an object -------------------------------------------------------------------------------------------------


def of_scene(**fields: Any) -> None:
    """Make a scene, and let each contact model take a step of it."""
    scene = Scene(**fields)
    for contact in CONTACT_MODELS:
        if contact == "pymunk" or scene.restitution == 1.0:
            make_simulator(scene, contact=contact).step(0.02, 1000.0)
            make_simulator(scene, contact=contact).step(0.02)


def of_drive(**fields: Any) -> None:
    """Make a drive, and let each contact model take a step of it."""
    kind = Chirp if set(fields) <= {field.name for field in dataclasses.fields(Chirp)} else Drive
    for contact in CONTACT_MODELS:
        simulator = make_simulator(Scene(drive=kind(**fields)), contact=contact)
        with contextlib.suppress(ZeroDivisionError):  # raised by the user's own function: passed on unchanged
            simulator.step(0.02)


def of_env(maker: Callable[..., Any], **settings: Any) -> None:
    """Make an environment, step it and close it."""
    env = maker(**settings)
    try:
        env.reset(seed=0)
        env.step(env.action_space.sample())
    finally:
        env.close()


SCENE = Scene(gravity=1.0)


FUNCTIONS: dict[str, Callable[[Any], Any]] = {
    "states.as_state": states.as_state,
    "states.as_start": lambda state: states.as_start(SCENE, state),
    "states.as_held": lambda state: states.as_held(SCENE, state),
    "mechanics.gaps": lambda state: mechanics.gaps(SCENE, state),
    "mechanics.gap_jacobian": lambda state: mechanics.gap_jacobian(SCENE, state, 0, 0),
    "mechanics.impact_map": lambda state: mechanics.impact_map(SCENE, state, 0, 0),
    "mechanics.simultaneous_impact_map": lambda state: mechanics.simultaneous_impact_map(SCENE, state, [(0, 0)]),
    "mechanics.energy": lambda state: mechanics.energy(SCENE, state),
}


SCENES: dict[str, Callable[[Any], Any]] = {
    "mechanics.gaps": lambda scene: mechanics.gaps(scene, START),
    "mechanics.gap_jacobian": lambda scene: mechanics.gap_jacobian(scene, START, 0, 0),
    "mechanics.impact_map": lambda scene: mechanics.impact_map(scene, START, 0, 0),
    "mechanics.simultaneous_impact_map": lambda scene: mechanics.simultaneous_impact_map(scene, START, [(0, 0)]),
    "mechanics.energy": lambda scene: mechanics.energy(scene, START),
    "states.as_start": lambda scene: states.as_start(scene, START),
    "states.as_held": lambda scene: states.as_held(scene, START),
    "Scene.of": Scene.of,
    "make_simulator": make_simulator,
    "rollout": lambda scene: rollout(scene, START, [0.0], 0.02),
    "cheapest": lambda scene: cheapest(scene, cases=1, steps=60),
    "JackInBoxEnv": lambda scene: of_env(JackInBoxEnv, scene=scene),
    "JackInBoxVectorEnv": lambda scene: of_env(JackInBoxVectorEnv, scene=scene, contact="exact"),
}


INDICES: dict[str, Callable[[Any], Any]] = {
    "gap_jacobian wall": lambda wall: mechanics.gap_jacobian(SCENE, START, wall, 0),
    "gap_jacobian foot": lambda foot: mechanics.gap_jacobian(SCENE, START, 0, foot),
    "impact_map wall": lambda wall: mechanics.impact_map(SCENE, START, wall, 0),
    "impact_map foot": lambda foot: mechanics.impact_map(SCENE, START, 0, foot),
    "simultaneous contacts": lambda contacts: mechanics.simultaneous_impact_map(SCENE, START, contacts),
    "simultaneous contact": lambda contact: mechanics.simultaneous_impact_map(SCENE, START, [(0, 0), contact]),
    "simultaneous wall": lambda wall: mechanics.simultaneous_impact_map(SCENE, START, [(wall, 0)]),
}


# These check nothing, for speed: their caller has checked the arguments. And records of results.
UNCHECKED = {
    "mechanics.clearance", "mechanics.start_tolerance", "mechanics.deepest_held", "mechanics.energy_of",
    "mechanics.contacts_of", "mechanics.impact_maps",
    "tasks.juggle", "tasks.spin", "tasks.rattle", "tasks.sample_start", "tasks.start_pose", "tasks.Task",
    "tasks.task_of", "tasks.checked_terms", "tasks.reward_of", "Task", "Impact", "Rollout", "FIDELITIES",
}  # fmt: skip


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_of_a_state(name: str) -> None:
    assert not failures(FUNCTIONS[name], EVERYTHING | arrays(12))


@pytest.mark.parametrize("name", SCENES)
def test_functions_of_a_scene(name: str) -> None:
    assert not failures(SCENES[name], EVERYTHING)


@pytest.mark.parametrize("name", INDICES)
def test_functions_of_walls_and_feet(name: str) -> None:
    assert not failures(INDICES[name], EVERYTHING | {f"pairs: {key}": value for key, value in arrays(2, 2).items()})


BOUNDS = ("first_impact_error", "penetration", "states", "cases", "steps", "control_dt", "seed", "contact")


@pytest.mark.parametrize("name", BOUNDS)
def test_arguments_of_the_helper_that_chooses_a_setting(name: str) -> None:
    assert [*inspect.signature(cheapest).parameters] == ["scene", *BOUNDS]
    short: dict[str, Any] = {"cases": 1, "steps": 60}
    large = ("cases", "steps")  # valid, but so large that the call takes long
    values = {key: value for key, value in EVERYTHING.items() if name not in large or not key.startswith("1")}
    assert not failures(lambda value: cheapest(SCENE, **{**short, name: value}), values)
    assert not failures(lambda value: cheapest(SCENE, states=[value], **short), arrays(12) if name == "states" else {})


@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(Scene)])
def test_fields_of_a_scene(name: str) -> None:
    assert not failures(lambda value: of_scene(**{name: value}), EVERYTHING)
    assert not failures(lambda value: SCENE.changed(**{name: value}), EVERYTHING)


@pytest.mark.parametrize("name", [field.name for kind in (Chirp, Drive) for field in dataclasses.fields(kind)])
def test_fields_of_a_drive(name: str) -> None:
    assert not failures(lambda value: of_drive(**{name: value}), EVERYTHING)


@EVERY_MODEL
@pytest.mark.parametrize("name", ["torque", "force_x", "force_y"])
def test_what_a_drives_functions_return(name: str, contact: str) -> None:
    def step(value: Any) -> None:
        simulator = make_simulator(Scene(drive=Drive(**{name: lambda time: value})), contact=contact)
        try:
            simulator.step(0.02)
        finally:
            assert simulator.time in (0.0, 0.02)

    assert not failures(step, EVERYTHING)


@pytest.mark.parametrize("name", ["contact", "substeps", "iterations", "something"])
def test_settings_of_a_simulator(name: str) -> None:
    assert not failures(lambda value: make_simulator(Scene(), **{name: value}), EVERYTHING)
    assert not failures(lambda value: make_simulator(Scene(), **{"contact": "exact", name: value}), EVERYTHING)


ENV_SETTINGS = [name for name in inspect.signature(JackInBoxEnv).parameters if name != "scene"]


VECTOR_SETTINGS = [name for name in inspect.signature(JackInBoxVectorEnv).parameters if name != "scene"]


def values_for(name: str, values: Values = EVERYTHING) -> Values:
    """Hostile values of a setting. An error of the user's own function is the user's, and comes back as it is."""
    own = "function of time that fails" if name == "randomize" else ""
    return {kind: value for kind, value in values.items() if kind != own}


@EVERY_MODEL
@pytest.mark.parametrize("name", [*ENV_SETTINGS, "something"])
def test_settings_of_an_environment(name: str, contact: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    assert not failures(lambda value: of_env(JackInBoxEnv, **{"contact": contact, name: value}), values_for(name))
    if name == "render_mode":
        return  # gym.make checks it first
    made = partial(gym.make, "JackInBox-v0")
    assert not failures(
        lambda value: of_env(made, **{"contact": contact, name: value}), values_for(name, SHOWN_BY_GYMNASIUM)
    )


@EVERY_MODEL
@pytest.mark.parametrize("name", [*VECTOR_SETTINGS, "something"])
def test_settings_of_a_vector_environment(name: str, contact: str) -> None:
    given = {"num_envs": 2, "contact": contact}
    assert not failures(lambda value: of_env(JackInBoxVectorEnv, **{**given, name: value}), values_for(name))
    assert not failures(lambda value: make_sb3_vec_env(**{**given, name: value}).close(), values_for(name))


@pytest.mark.parametrize("name", [*VECTOR_SETTINGS, "something"])
def test_settings_of_make_vec(name: str) -> None:
    made = partial(gym.make_vec, "JackInBox-v0", vectorization_mode="vector_entry_point")
    given = {"num_envs": 2, "contact": "exact"}
    assert not failures(lambda value: of_env(made, **{**given, name: value}), values_for(name))


ROLLOUTS: dict[str, Values] = {
    "states": EVERYTHING | arrays(12) | {f"rows: {key}": value for key, value in arrays(2, 12).items()},
    "torques": EVERYTHING | arrays(3) | {f"rows: {key}": value for key, value in arrays(2, 3).items()},
    "dt": EVERYTHING,
    "time": EVERYTHING,
    "energy": EVERYTHING,
    "impacts": EVERYTHING,
    "rewards": EVERYTHING,
    "repeat": EVERYTHING,
    "trajectories": EVERYTHING,
    "num_threads": EVERYTHING,
}


@pytest.mark.parametrize("name", ROLLOUTS)
@pytest.mark.parametrize("drive", [Chirp(), Drive(force_x=math.cos)], ids=["chirp", "functions"])
def test_arguments_of_rollout(name: str, drive: Any) -> None:
    given = {"scene": Scene(drive=drive), "states": START, "torques": [0.0, 1.0], "dt": 0.02}
    assert not failures(lambda value: rollout(**{**given, name: value}), ROLLOUTS[name])


LOOKING = sorted(set(inspect.signature(Lookahead.__init__).parameters) - {"self"})


@pytest.mark.parametrize("name", LOOKING)
def test_settings_of_looking_ahead(name: str) -> None:
    env, vector = gym.make("JackInBox-v0"), JackInBoxVectorEnv(2, autoreset_mode="SAME_STEP")
    several = make_sb3_vec_env(2)
    given: dict[str, Any] = {"samples": 8, "turns": 3, "pieces": 8}
    assert not failures(lambda value: Lookahead(**{"env": env, **given, name: value}), EVERYTHING)
    assert not failures(lambda value: LookaheadVector(**{"env": vector, **given, name: value}), EVERYTHING)
    own = "venv" if name == "env" else name
    assert not failures(lambda value: LookaheadVecEnv(**{"venv": several, **given, own: value}), EVERYTHING)


# -- that nothing is left out, and that the fuzz can fail --------------------------------------------------------------


def own_methods(kind: type) -> set[str]:
    """Methods that the class itself defines and that take something."""
    found = set()
    for name, member in vars(kind).items():
        if not name.startswith("_") and inspect.isfunction(member) and len(inspect.signature(member).parameters) > 1:
            found.add(f"{kind.__name__}.{name}")
    return found


def test_every_public_name_has_a_case() -> None:
    covered = {*FUNCTIONS, *SCENES, *UNCHECKED, "Scene", "Chirp", "Drive", "Simulator", "JackLostError"}
    covered |= {method for _, method, _, _ in CALLS.values()} | {"Lookahead", "LookaheadVector"}
    assert set(jackbox_env.__all__) <= covered
    for module in (mechanics, tasks):
        short = module.__name__.rsplit(".", 1)[1]
        functions = {
            f"{short}.{name}"
            for name, member in vars(module).items()
            if inspect.isroutine(member) and member.__module__ == module.__name__ and not name.startswith("_")
        }
        assert len(functions) > 3
        assert functions <= covered, functions - covered
    methods = set().union(*map(own_methods, (Simulator, JackInBoxEnv, JackInBoxVectorEnv, JackInBoxVecEnv, EnvView)))
    # Stable-Baselines3's and Gymnasium's own: step is these two, and names of attributes fail as Python's do.
    others = {f"JackInBoxVecEnv.{name}" for name in ("step_async", "get_attr", "set_attr", "env_method")}
    others |= {"JackInBoxVecEnv.env_is_wrapped", "EnvView.get_wrapper_attr", "EnvView.has_wrapper_attr"}
    others |= {"JackInBoxVectorEnv.close_extras"}
    assert methods - others <= covered, methods - others - covered
    assert set(ROLLOUTS) == set(inspect.signature(rollout).parameters) - {"scene"}
    for kind, names in {
        Scene: {"of", "changed"},
        Chirp: {"torque", "fastest", "torque_means"},
        Drive: {"torque_means"},
    }.items():
        found = {name for name in vars(kind) if not name.startswith("_") and callable(getattr(kind, name))}
        assert found - {field.name for field in dataclasses.fields(kind)} - names == set(), kind


@pytest.mark.parametrize(
    ("raised", "complaint"),
    [
        (KeyError("x"), "raised KeyError"),
        (RuntimeError("something else went wrong"), "raised RuntimeError: something else"),
        (ValueError("line\nbreak and more"), "line\nbreak"),
        (ValueError("x" * 400), "400 characters"),
        (UserWarning("a warning as an error"), "raised UserWarning"),
    ],
)
def test_a_bad_answer_is_found(raised: Exception, complaint: str) -> None:
    def call(value: Any) -> None:
        if value is None:
            raise raised

    (found,) = failures(call, NUMBERS)
    assert found.startswith("None: ")
    assert complaint in found


def test_an_object_hurt_by_what_it_refuses_is_found() -> None:
    def careless(simulator: Simulator, value: Any) -> None:
        simulator.step(0.02, 0.0)
        simulator.step(0.02, value)

    assert len(hurt(simulator_of("exact"), careless, {"nan": lambda: math.nan, "1": lambda: 1.0})) == 1
