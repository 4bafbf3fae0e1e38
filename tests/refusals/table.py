"""The table of refusals: what is called, its arguments, and of which kind each is."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from operator import attrgetter
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

import jackbox_env
from agents.settings import EPISODE_STEPS, TrainSettings
from jackbox_env import Chirp, Drive, JackInBoxEnv, JackInBoxVectorEnv, Scene, make_simulator, mechanics, states
from jackbox_env.planning.icem import Search
from jackbox_env.randomization import NUMBERS
from jackbox_env.sb3 import JackInBoxVecEnv, make_sb3_vec_env
from jackbox_env.sb3_wrappers import HoldingVecEnv, LandingControlVecEnv, LookaheadVecEnv
from jackbox_env.simulators import CONTACT_MODELS, Simulator
from jackbox_env.simulators.fidelity import FIDELITIES
from jackbox_env.states import STATE_NAMES
from jackbox_env.tasks import TASKS
from tests.refusals.kinds import (
    Argument,
    FailsToConvert,
    array,
    choice,
    each,
    flag,
    instance,
    mask,
    out,
    real,
    size,
    whole,
    wrong,
)

START = np.array([0.125, 0.25, 0.5, 0.5, -0.375, 0.25, 0.125, 0.0, 0.25, 3.0, 1.0, 2.0])
ROWS = np.stack([START, START + 0.125, START - 0.125])
Kinds = dict[str, Argument]


def nothing(_: Any) -> None:
    return None


class Subject(NamedTuple):
    """An object that is called, how it is put back to its start, and what shows how it is."""

    make: Callable[[], Any]
    start: Callable[[Any], object] = nothing
    shown: Callable[[Any], Any] = nothing


NO_OBJECT = Subject(lambda: None)


@dataclass(frozen=True)
class Row:
    """A callable, as an attribute of its subject, with arguments: a dot in a name is a key of a dict."""

    name: str
    called: Callable[[Any], Callable[..., Any]]
    arguments: Kinds
    subject: Subject = NO_OBJECT
    given: Mapping[str, Any] = field(default_factory=dict)  # good values of arguments that are of no kind here
    contact: str = ""

    def call(self, one: Any, **values: Any) -> Any:
        """Call it with good values but for those given here."""
        keywords: dict[str, Any] = dict(self.given)
        for name, value in values.items():
            outer, _, inner = name.partition(".")
            keywords[outer] = {inner: value} if inner else value
        return self.called(one)(**keywords)

    @property
    def good(self) -> dict[str, Any]:
        """The good values but for those within dicts."""
        return {name: one.good for name, one in self.arguments.items() if "." not in name}


# -- kinds that several share ------------------------------------------------------------------------------------------

DT = real(0.03125, above=0.0)
THREADS = whole(None, 1, none=True)
SEED = whole(5, 0)
CONTACT = choice("pymunk", CONTACT_MODELS, none=True)
SUBSTEPS = whole(2, 1, 1_000_000, none=True)
UNNAMED = jackbox_env.Task(("a", "a"), lambda scene, state, torque, impulse: (1.0, 1.0))
TASK = instance(
    "spin", "text", "empty_text", "long_text", unknown=out("fly", "'fly'", *map(repr, TASKS)),
    no_names=out(UNNAMED._replace(terms=()), "terms", "()", named="task"),
    same_names=out(UNNAMED, "terms", "('a', 'a')", named="task"),
    a_name=out(UNNAMED._replace(terms="a"), "terms", "'a'", named="task"),
    no_plain_function=wrong(UNNAMED._replace(terms=("a",), values=math.sin), "values", named="task"),
)  # fmt: skip


def moved(place: int, value: float) -> Any:
    return np.where(np.arange(12) == place, value, START)


def state(deepest: float | None = None) -> Argument:
    """12 numbers, with every foot at most so deep in a wall [m]."""
    more = {f"nan_{name}": out(moved(place, math.nan), f"{name} = nan") for place, name in enumerate(STATE_NAMES)}
    more["beyond_squares"] = out(moved(8, 1e101), "omega_box = 1e+101")
    if deepest is not None:
        more["outside"] = out(moved(3, 8.0), "outside", f"{deepest:g} m")
        more["far_off"] = out(START + 1e15, "1e+15 m")
    return array(START).but(**more)


def rows_of(one: Argument, deepest: float) -> Argument:
    """Three states, each checked like one."""
    bad = np.stack([START, START, moved(3, 8.0)])
    return one.but("state", outside=out(bad, "[2]", f"{deepest:g} m"))


def fields_of() -> Kinds:
    """Fields of a scene that are numbers."""
    tiny = partial(real, at_least=1e-60, at_most=1e60)
    lengths = {"box_half_width": tiny(6.0, ends=False), "jack_arm": tiny(1.0, ends=False)}
    lengths["jack_arm"] = lengths["jack_arm"].but(too_long=out(8.5, "8.48528", "8.5"))
    lengths["box_half_width"] = lengths["box_half_width"].but(too_short=out(0.5, "jack_arm", "0.707107"))
    masses = {name: tiny(64.0) for name in ("box_mass", "jack_mass", "torque_limit")}
    inertias = {name: tiny(64.0, none=True) for name in ("box_inertia", "jack_inertia")}
    others = {"gravity": real(1.5, at_least=0.0, at_most=1e60), "restitution": real(0.5, at_least=0.0, at_most=1.0)}
    return lengths | masses | inertias | others | {"drive": DRIVE}


CHIRP: Kinds = {"amplitude": real(64.0, at_least=-1e60, at_most=1e60)}
CHIRP |= {name: real(0.5, at_least=-1e9, at_most=1e9) for name in ("start_frequency", "rate")}
DRIVE = instance(Chirp(rate=0.5), "nothing", class_of_it=wrong(Chirp), dict=out({"gain": 3.0}, "'gain'", "'rate'"))
DRIVES = {name: instance(math.cos, "nothing", "function") for name in ("torque", "force_x", "force_y")}
DICTS = {"dict": out({"mass": 3.0}, "'mass'", "'box_mass'"), "bad": out({"gravity": -1.0}, "-1.0", named="gravity")}
ONE_SCENE = replace(
    instance(Scene(gravity=1.5), "nothing", no_name=out({1: 2}, "1", "'box_mass'"), **DICTS),
    taken=(None, {"gravity": 1.5, "drive": {"rate": 0.0}}),
)
SCENES = ONE_SCENE.but(
    bytes=wrong(b"1", "[0]", "49"),
    list=wrong([None, 3.0], "[1]", "3.0"),
    ragged=wrong([[1.0]], "[0]", "[1.0]"),
    no_scene=out([], "empty"),
)
ONLY_A_SCENE = instance(Scene(gravity=1.5), dict=wrong({"gravity": 1.5}))
CHANGES = instance({"gravity": 1.5}, "nothing", no_name=wrong({1: 2}, "1"), **DICTS)
RANDOMIZE = instance(
    {"jack_mass": (3.0, 5.0)}, "nothing", "function",
    dict=out({"mass": (1.0, 2.0)}, "'mass'", "'box_mass'"), one_end=wrong({"gravity": [1.0]}, "'gravity'", "[1.0]"),
    no_ends=wrong({"gravity": 1.0}, "'gravity'", "1.0"), text=wrong({"gravity": "ab"}, "'gravity'", "'ab'"),
    words=wrong({"gravity": ("a", 2.0)}, "'gravity'", "'a'"), nan=out({"gravity": (math.nan, 2.0)}, "'gravity'", "nan"),
    turned=out({"gravity": (2.0, 1.0)}, "'gravity'", "(2.0, 1.0)"),
    refused_scene=out({"gravity": (-1.0, 2.0)}, "gravity=-1", "-1.0"),
)  # fmt: skip
DRAWN = instance({"gravity": 1.5}, "dict").but(
    no_name=wrong({1: 2.0}, "1"), unknown=out({"mass": 3.0}, "'mass'", named="scene")
)
OPTIONS = instance({}, "nothing", dict=out({"stat": 1.0}, "'stat'", "'state'", "'time'", "'scene'"))

# -- objects that go on ------------------------------------------------------------------------------------------------


def simulator(contact: str) -> Subject:
    def start(one: Simulator) -> None:
        one.reset(START, 1.0)
        one.step(0.25, 1000.0)

    def shown(one: Simulator) -> Any:
        return one.state, one.time, one.torque, one.impacts

    return Subject(lambda: make_simulator({"gravity": 1.5}, contact=contact), start, shown)


def driven(contact: str) -> Callable[[Any], Callable[..., Any]]:
    """A step under functions that return these values from the middle of the step on."""

    def step(**returned: Any) -> Any:
        late = {name: lambda time, value=value: value if time > 0.013 else 1.0 for name, value in returned.items()}
        one = make_simulator(Scene(drive=Drive(**late)), contact=contact)
        one.step(0.02)
        return one.state

    return lambda _: step


def single(contact: str) -> Subject:
    def start(env: JackInBoxEnv) -> None:
        env.reset(seed=4, options={"scene": {}})
        env.set_state(START, 1.0)

    def shown(env: JackInBoxEnv) -> Any:
        return env.state, env.time, env.np_random.bit_generator.state, env.scene, env.observation

    return Subject(partial(JackInBoxEnv, contact=contact), start, shown)


def several(contact: str) -> Subject:
    def start(env: JackInBoxVectorEnv) -> None:
        env.reset(seed=4, options={"scene": {}})
        env.set_states(START, 1.0)

    def shown(env: JackInBoxVectorEnv) -> Any:
        generators: Any = env._batch._generators  # type: ignore[attr-defined]
        drawn = generators if contact == "exact" else [one.bit_generator.state for one in generators]
        return env.states, env.times, env.np_random_seed, env.scenes, drawn

    return Subject(partial(JackInBoxVectorEnv, 3, contact=contact, with_infos=True), start, shown)


def of_sb3(contact: str) -> Subject:
    inner = several(contact)

    def start(env: JackInBoxVecEnv) -> None:
        env.seed(4)
        env.set_options({"scene": {}})
        env.reset()
        env.vector_env.set_states(START, 1.0)

    return Subject(partial(make_sb3_vec_env, 3, contact=contact), start, lambda env: inner.shown(env.vector_env))


def reset_of_sb3(env: JackInBoxVecEnv) -> Callable[..., Any]:
    def reset(options: Any) -> Any:
        env.set_options([options, {}, {}])
        return env.reset()

    return reset


ACTION = array([0.25], none=True).but(scalar=out(np.array(math.nan), "nan"), square=out(np.zeros((1, 1)), "(1, 1)"))
ACTIONS = array([[0.25], [0.5], [-0.25]], none=True).but(
    "action", nan_inside=out([[0.25], [0.5], [math.nan]], "nan", "environment 2"),
    masked_in_a_list=out([[0.25], [0.5], np.ma.array([0.5], mask=[True])], "masked"),
    transposed=out(np.zeros((1, 3)), "(1, 3)"),
)  # fmt: skip
TIMES = array([1.0, 2.0, 3.0], scalar=True).but(
    late=out([0.0, 0.0, 2e9], "2000000000.0", "1e+09"), early=out(-2e9, "-2000000000.0", "-1e+09")
)
SEEDS = whole(5, 0, none=True).but(
    list=out([1.0], "3", "1 of them"), array=None, ragged=out([[1.0], [2.0]], "2 of them"),
    in_the_list=wrong([1, 2, "3"], "'3'"),
)  # fmt: skip
FROM = "options.state"


def methods_of(contact: str) -> Iterator[Row]:
    """The methods of everything that steps."""
    one, env, vector, sb3 = simulator(contact), single(contact), several(contact), of_sb3(contact)
    held, start, time = state(1.0), state(1e-9).but(nothing=None), real(1.0, at_least=-1e9, at_most=1e9)
    moves = DT.but(no_time=out(1e-300, "1e-300"), too_late=out(2e9, "2e+09", "1e+09"))

    def row(name: str, arguments: Kinds, subject: Subject, called: Any = None) -> Row:
        return Row(name, called or attrgetter(name.rpartition(".")[2]), arguments, subject, contact=contact)

    yield row("Simulator.reset", {"state": held, "time": time}, one)
    yield row("Simulator.step", {"dt": moves, "torque": real(1000.0, none=True)}, one)
    yield row("Drive", {name: real(0.5).but(f"{name}(") for name in DRIVES}, NO_OBJECT, driven(contact))
    own = {"options": OPTIONS, FROM: start, "options.time": time.but("options['time']", nothing=None)}
    own["options.scene"] = CHANGES
    yield row("JackInBoxEnv.reset", own, env)
    yield row("JackInBoxEnv.step", {"action": ACTION}, env)
    yield row("JackInBoxEnv.set_state", {"state": held, "time": time}, env)
    own = {
        **own,
        "seed": SEEDS,
        FROM: rows_of(array(ROWS, none=True), 1e-9),
        "options.time": TIMES.but("options['time']", nothing=None),
    }
    own["options.reset_mask"] = mask([True, False, True]).but(
        "options['reset_mask']", nothing=None, none=out(np.zeros(3, dtype=bool), "got none")
    )
    yield row("JackInBoxVectorEnv.reset", own, vector)
    seen_first = {name: one for name, one in own.items() if name not in (FROM, "options.scene")}
    yield row("JackInBoxVectorEnv.check_reset", seen_first, vector)
    yield row("JackInBoxVectorEnv.scene_of", {"number": whole(1, 0, 2)}, vector)
    numbers = (*NUMBERS, "speed_scale")
    yield row("JackInBoxVectorEnv.field", {"name": choice("gravity", numbers)}, vector)
    yield row("JackInBoxVectorEnv.impacts", {"number": whole(1, 0, 2)}, vector)
    yield row("JackInBoxVectorEnv.step", {"actions": ACTIONS, "repeat": whole(2, 1, 1_000_000)}, vector)
    placed = {"states": rows_of(array(ROWS), 1.0), "times": TIMES, "chosen": mask([True, False, True])}
    yield row("JackInBoxVectorEnv.set_states", placed, vector)
    tiles = {"first": whole(2, 1, 1024), "size": size((16, 24), 16, 1024)}
    yield row("JackInBoxVectorEnv.tiled", tiles, vector)
    yield row("JackInBoxVecEnv.step", {"actions": ACTIONS}, sb3)
    yield row("JackInBoxVecEnv.reset", {FROM: start}, sb3, reset_of_sb3)
    times = {name: one for name, one in TIMES.refused.items() if "inside" not in name and name != "late"}
    put = {"state": held, "time": Argument(1.0, times)}
    yield row("EnvView.set_state", put, sb3, lambda env: env.get_attr("set_state")[1])


# -- functions and constructors ----------------------------------------------------------------------------------------

PLACE = whole(1, 0, 3)
CONTACTS = Argument(
    [(0, 0), (1, 2)],
    {
        **each(wrong, {"nothing": None, "number": 1.5, "fails": FailsToConvert(), "function": print}),
        **{name: wrong([(0, 0), pair], str(pair), named="pair") for name, pair in (("one", 5), ("three", (1, 2, 3)))},
        "text": wrong("ab", "'a'", named="pair"),
        "wall": out([(4, 0)], "4", named="wall"), "foot": wrong([(0, 1.5)], "1.5", named="foot"),
        "again": out([(2, 3), (0, 1), (np.int64(2), np.int64(3))], "distinct", "(2, 3)"),
    },
)  # fmt: skip
IN_A_SCENE: Kinds = {"scene": ONLY_A_SCENE, "state": state()}
SETTINGS: Kinds = {
    "contact": CONTACT,
    "substeps": SUBSTEPS,
    "scene": ONE_SCENE,
    "task": TASK,
    "control_dt": DT,
    "torque": choice("chirp", ("agent", "chirp")),
    "render_mode": choice("rgb_array", ("human", "rgb_array"), none=True),
    "fidelity": choice(None, FIDELITIES, none=True),
    "randomize": RANDOMIZE,
    "render_size": size((16, 24), 16, 4096),
    "render_overlay": flag(True),
}
STEPS = replace(whole(100, 1, 10**15), taken=(-1, 1))
OF_VECTORS: Kinds = {
    **SETTINGS,
    "num_envs": whole(2, 1, 10**9),
    "render_mode": SETTINGS["render_mode"].but(human=out("human", "several", "'human'")),
    "max_episode_steps": STEPS,
    "num_threads": THREADS,
    "with_infos": flag(False),
    "scene": SCENES.but(short=out([None], "list of 2", "1 of them")),
}
LOOKING: Kinds = {
    "hold": whole(5, 1, 1000),
    "turns": whole(3, 0, 999).but(even=out(4, "odd", "4")),
    "samples": whole(8, 0, 100_000).but(few=out(7, "8", "7")),
    "pieces": whole(8, 8, 10_000),
    "follow": flag(False),
    "seed": SEED,
    "num_threads": THREADS,
}
ROLLOUT: Kinds = {
    "scene": SCENES.but(long=out([None] * 4, "list of 3", "4 of them")),
    "states": rows_of(array(ROWS), 1.0).but(fewer=out(ROWS[:2], "as many", "2", "3")),
    "torques": array(np.array([[0.0, 64.0], [1.0, 2.0], [3.0, 4.0]])),
    "dt": DT,
    "time": real(1.0, at_least=-1e9, at_most=1e9, ends=False),
    "energy": flag(True),
    "impacts": flag(True),
    "rewards": TASK.but(nothing=None),
    "repeat": whole(2, 1, 1_000_000),
    "trajectories": flag(True),
    "num_threads": THREADS,
}
ROLLOUT["torques"] = ROLLOUT["torques"].but(one_too_many=None, empty=None, scalar=out(1.0, "()"))
LINEARIZING: Kinds = {
    **{name: ROLLOUT[name] for name in ("scene", "states", "dt", "time", "repeat", "num_threads")},
    "torques": ROLLOUT["torques"].but(nothing=None),
    "fields": Argument(
        ("gravity",),
        {
            **each(wrong, {"text": "gravity", "number": 3.0, "fails": FailsToConvert()}),
            "unknown": out(("weight",), "'gravity'", "'weight'", named="field"),
            "another": out((3,), "3", named="field"),
        },
    ),
}
CHOOSING: Kinds = {
    "scene": SCENES.but(many=out([None] * 3, "cases", "3", "2")),
    **{name: real(8.0, above=0.0).but(inf=None, float16_inf=None) for name in ("first_impact_error", "penetration")},
    "states": Argument(
        [moved(9, 8.0)],
        {
            **each(wrong, {"number": 3.0, "function": print, "fails": FailsToConvert()}),
            "none": out([], "none"),
            "numbers": out([1.0], "(12,)", named="state"),
            "text": wrong("up", "'u'", named="state"),
            "outside": out([START, moved(3, 8.0)], "outside", named="start"),
        },
    ),
    "cases": whole(2, 1, 10_000),
    "steps": replace(whole(60, 1, 1_000_000), taken=()),
    "control_dt": DT,
    "seed": Argument(5, SEED.refused, {"numpy": np.int64(5), "0-d": np.array(5)}),
    "contact": CONTACT,
}
SEARCHING: Kinds = {
    "task": TASK,
    "control_dt": DT,
    "piece": whole(5, 1),
    "pieces": whole(8, 2),
    "samples": whole(8, 2),
    "elites": whole(2, 1, 8),
    "iterations": whole(1, 1),
    "seed": SEED,
    "num_threads": THREADS,
}
COUNTS = ("total_steps", "num_envs", "rollout_steps", "epochs", "checkpoint_steps", "eval_steps", "eval_episodes")
TRAINING: Kinds = {
    "seed": whole(5, 0, 2**32 - 1),
    **{name: whole(4, 1).but(absurd=out(10**13, str(10**13))) for name in COUNTS},
    "batch_size": whole(4, 2),
    "torch_threads": whole(2, 1).but(absurd=out(1025, "1024", "1025")),
    "hold": whole(5, 1, EPISODE_STEPS).but(odd=out(3, "divide", "500", "3")),
    "preview": flag(True),
    "lookahead": whole(8, 0, 4096).but(few=out(7, "8", "7")),
    **{name: real(0.5, above=0.0) for name in ("learning_rate", "clip_range")},
    **{name: real(0.5, at_least=0.0, at_most=1.0) for name in ("gamma", "gae_lambda")},
    **{name: real(0.5) for name in ("entropy_coefficient", "initial_log_std")},
    "max_minutes": real(0.5, above=0.0, none=True),
    "hidden_units": instance((8, 4), "list", "ragged", zero=out((8, 0), "0"), floats=wrong((8.0,), "8.0")),
    "fidelity": SETTINGS["fidelity"],
}


def cheapest(**given: Any) -> Any:
    return jackbox_env.cheapest(**given)._replace(microseconds=0.0)


def drawn_alone(randomize: Any) -> Any:
    """Draw the scene by a function of the generator that returns this."""
    return JackInBoxEnv(randomize=lambda rng: randomize).reset(seed=1)


def drawn_together(randomize: Any) -> Any:
    return JackInBoxVectorEnv(2, randomize=lambda rng: randomize).reset(seed=1)


def constructors() -> Iterator[Row]:
    """All that makes or computes something, and keeps nothing."""

    def row(function: Callable[..., Any], arguments: Kinds, **given: Any) -> Row:
        return Row(function.__qualname__, lambda _: function, arguments, given=given)

    yield row(states.as_state, {"state": state()})
    yield row(states.as_start, {"scene": ONLY_A_SCENE, "state": state(1e-9)})
    yield row(states.as_restored, {"scene": ONLY_A_SCENE, "state": state(1.0)})
    yield row(mechanics.gaps, IN_A_SCENE)
    yield row(mechanics.energy, IN_A_SCENE)
    yield row(mechanics.gap_jacobian, {**IN_A_SCENE, "wall": PLACE, "foot": PLACE})
    yield row(mechanics.impact_map, {**IN_A_SCENE, "wall": PLACE, "foot": PLACE})
    yield row(mechanics.simultaneous_impact_map, {**IN_A_SCENE, "contacts": CONTACTS})
    yield row(Scene, fields_of())
    yield row(Scene().changed, fields_of())
    yield row(Scene.of, {"given": ONE_SCENE.but("scene")})
    yield row(Chirp, CHIRP)
    yield row(Drive, DRIVES)
    contact = choice("pymunk", CONTACT_MODELS)
    of_pymunk = {"scene": ONE_SCENE, "contact": contact, "substeps": SUBSTEPS, "iterations": SUBSTEPS}
    yield row(make_simulator, of_pymunk)
    yield row(JackInBoxEnv, SETTINGS)
    modes = choice("SAME_STEP", ("NEXT_STEP", "SAME_STEP", "DISABLED"))
    yield row(JackInBoxVectorEnv, {**OF_VECTORS, "autoreset_mode": modes})
    yield row(make_sb3_vec_env, OF_VECTORS)
    yield row(drawn_alone, {"randomize": DRAWN})
    yield row(drawn_together, {"randomize": DRAWN})
    yield row(jackbox_env.rollout, ROLLOUT)
    yield row(jackbox_env.linearize, LINEARIZING, steps=None)
    yield row(cheapest, CHOOSING)
    inner = JackInBoxVectorEnv(2, autoreset_mode="SAME_STEP")
    yield row(jackbox_env.Lookahead, LOOKING, env=gym.make("JackInBox-v0"))
    yield row(jackbox_env.LookaheadVector, LOOKING, env=inner)
    yield row(LookaheadVecEnv, {**LOOKING, "hold": whole(5, 1)}, venv=make_sb3_vec_env(2))
    yield row(HoldingVecEnv, {"hold": whole(5, 1)}, venv=make_sb3_vec_env(2))
    yield row(
        jackbox_env.LandingControl, {"period": real(0.4, above=0.0, at_most=20000.0)}, env=gym.make("JackInBox-v0")
    )
    yield row(jackbox_env.LandingControlVector, {"period": real(0.4, above=0.0, at_most=20000.0)}, env=inner)
    yield row(LandingControlVecEnv, {"period": real(0.4, above=0.0, at_most=20000.0)}, venv=make_sb3_vec_env(2))
    yield row(Search, SEARCHING)
    yield row(TrainSettings, TRAINING, landing=False)


TABLE = [*constructors(), *(row for contact in CONTACT_MODELS for row in methods_of(contact))]
