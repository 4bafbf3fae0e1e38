"""The table of refusals: every public callable with its arguments and their kinds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from operator import attrgetter
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

import jackbox_env
from agents.settings import TrainSettings
from jackbox_env import Chirp, Drive, JackInBoxEnv, JackInBoxVectorEnv, Scene, make_simulator, mechanics
from jackbox_env.model import states
from jackbox_env.model.randomization import NUMBERS
from jackbox_env.model.states import STATE_NAMES
from jackbox_env.model.tasks import SLOPES, TASKS
from jackbox_env.sb3 import make_sb3_vec_env
from jackbox_env.simulators import CONTACT_MODELS
from jackbox_env.simulators.fidelity import FIDELITIES
from tests.refusals.kinds import Argument, array, choice, each, flag, instance, mask, out, real, size, whole, wrong
from tests.refusals.sentences import START, Subject, several, simulator, single

ROWS = np.stack([START, START + 0.125, START - 0.125])
Kinds = dict[str, Argument]


class Row(NamedTuple):
    """A callable, as an attribute of its subject, with arguments: a dot in a name is a key of a dict."""

    name: str
    called: Callable[[Any], Callable[..., Any]]
    arguments: Kinds
    subject: Subject = Subject()
    contact: str = ""

    def call(self, one: Any, **values: Any) -> Any:
        """Call it with good values, except for these; entries of dicts are passed only if they are among these."""
        keywords = {name: one.good for name, one in self.arguments.items() if "." not in name}
        for name, value in values.items():
            outer, _, inner = name.partition(".")
            keywords[outer] = {inner: value} if inner else value
        return self.called(one)(**keywords)


# -- kinds that several share ------------------------------------------------------------------------------------------

DT = real(0.03125, above=0.0)
THREADS = whole(None, 1, none=True)
SEED = whole(5, 0)
CONTACT = choice("pymunk", CONTACT_MODELS, none=True)
SUBSTEPS = whole(2, 1, 1_000_000, none=True)
UNNAMED = jackbox_env.Task(("a", "a"), lambda scene, state, torque, impulse: (1.0, 1.0))
TASK = instance(
    "spin", "text", "empty_text", unknown=out("fly", "'fly'", *map(repr, TASKS)),
    plain_function=wrong(UNNAMED.values, "jackbox_env.Task", 'write Task(("reward",), f)'),
    no_names=out(replace(UNNAMED, terms=()), "terms", "()", named="task"),
    same_names=out(UNNAMED, "terms", "('a', 'a')", named="task"),
    no_plain_function=wrong(replace(UNNAMED, terms=("a",), values=math.sin), "values", named="task"),
)  # fmt: skip


changed: Any = replace  # to values of wrong types
SEEN = jackbox_env.Observation(("height",), -1.0, 1.0, lambda scene, state, time: (state.y_jack,))
OBSERVATION = instance(
    "landing", "text", "empty_text", "dict", mapping=out({"something": 1}, "'size'", "'something'"),
    unknown=out("pixel", "'pixel'", "'state'", "'landing'", "'pixels'"),
    small=out("pixels-15x84x1", "size", "16", "(15, 84)", named="Pixels"),
    deep=out("pixels-84x36x36", "stack", "35", "36", named="Pixels"),
    plain_function=wrong(SEEN.values, "jackbox_env.Observation"), no_names=out(changed(SEEN, names=()), "names", "()"),
    same_names=out(changed(SEEN, names=("a", "a")), "names", "('a', 'a')"),
    infinite=out(changed(SEEN, high=math.inf), "high", "finite", "inf"),
    beyond=out(changed(SEEN, low=-1e40), "low", "float32", "-1e+40"),
    equal=out(changed(SEEN, low=1.0 - 1e-12), "below", "1.0"),
    turned=out(changed(SEEN, low=2.0), "below", "2.0", "1.0"), shape=out(changed(SEEN, low=[0.0, 0.0]), "low", "0."),
    words=wrong(changed(SEEN, low="a"), "low", "'a'"), no_plain=wrong(changed(SEEN, values=math.sin), "values"),
)  # fmt: skip
TURN = jackbox_env.Action(gym.spaces.Discrete(2), lambda scene, state, action, time, dt: 0.5)
ACTING: Argument = instance(
    "landing", "text", "empty_text", unknown=out("turn", "'turn'", "'torque'", "'landing'", "'discrete'"),
    plain_function=wrong(TURN.torque, "jackbox_env.Action"), from_one=out(
        changed(TURN, space=gym.spaces.Discrete(2, start=1)), "space", "start=1"
    ),
    square=out(changed(TURN, space=gym.spaces.Box(-1, 1, (2, 2))), "space", "(2, 2)"),
    other=out(changed(TURN, space=gym.spaces.MultiBinary(3)), "space", "MultiBinary(3)"),
    no_space=wrong(changed(TURN, space=3), "space", "3"), no_plain=wrong(changed(TURN, torque=math.sin), "torque"),
)  # fmt: skip


def moved(index: int, value: float) -> Any:
    return np.where(np.arange(12) == index, value, START)


def state(deepest: float | None = None) -> Argument:
    """12 numbers, with every foot at most so deep in a wall [m]."""
    more = {f"nan_{name}": out(moved(index, math.nan), f"{name} = nan") for index, name in enumerate(STATE_NAMES)}
    if deepest is not None:
        more["outside"] = out(moved(3, 8.0), "outside", f"{deepest:g} m")
    return array(START).but(**more)


def rows_of(one: Argument, deepest: float) -> Argument:
    """Three states, each checked like one."""
    bad = np.stack([START, START, moved(3, 8.0)])
    return one.but("state", outside=out(bad, "[2]", f"{deepest:g} m"))


DRIVE = instance(Chirp(rate=0.5), "nothing", class_of_it=wrong(Chirp), dict=out({"gain": 3.0}, "'gain'", "'rate'"))
TINY = partial(real, at_least=1e-60, at_most=1e60)
FIELDS: Kinds = {
    "box_half_width": TINY(6.0, ends=False).but(too_short=out(0.5, "jack_arm", "0.707107")),
    "jack_arm": TINY(1.0, ends=False).but(too_long=out(8.5, "8.48528", "8.5")),
    **{name: TINY(64.0) for name in ("box_mass", "jack_mass", "torque_limit")},
    **{name: TINY(64.0, none=True) for name in ("box_inertia", "jack_inertia")},
    "gravity": real(1.5, at_least=0.0, at_most=1e60),
    "restitution": real(0.5, at_least=0.0, at_most=1.0),
    "drive": DRIVE,
}
CHIRP: Kinds = {
    "amplitude": real(64.0, at_least=-1e60, at_most=1e60),
    **{name: real(0.5, at_least=-1e9, at_most=1e9) for name in ("start_frequency", "rate")},
}
DRIVES = {name: instance(math.cos, "nothing", "function") for name in ("torque", "force_x", "force_y")}
DICTS = {"dict": out({"mass": 3.0}, "'mass'", "'box_mass'"), "bad": out({"gravity": -1.0}, "-1.0", named="gravity")}
ONE_SCENE = replace(
    instance(Scene(gravity=1.5), "nothing", **DICTS),
    accepted=(None, {"gravity": 1.5, "drive": {"rate": 0.0}}),
)
SCENES = ONE_SCENE.but(
    list=wrong([None, 3.0], "[1]", "3.0"),
    ragged=wrong([[1.0]], "[0]", "[1.0]"),
    no_scene=out([], "empty"),
)
ONLY_A_SCENE = instance(Scene(gravity=1.5), dict=wrong({"gravity": 1.5}))
CHANGES = instance({"gravity": 1.5}, "nothing", **DICTS)
RANDOMIZE = instance(
    {"jack_mass": (3.0, 5.0)}, "nothing", "function",
    dict=out({"mass": (1.0, 2.0)}, "'mass'", "'box_mass'"), one_end=wrong({"gravity": [1.0]}, "'gravity'", "[1.0]"),
    no_ends=wrong({"gravity": 1.0}, "'gravity'", "1.0"), text=wrong({"gravity": "ab"}, "'gravity'", "'ab'"),
    words=wrong({"gravity": ("a", 2.0)}, "'gravity'", "'a'"), nan=out({"gravity": (math.nan, 2.0)}, "'gravity'", "nan"),
    turned=out({"gravity": (2.0, 1.0)}, "'gravity'", "(2.0, 1.0)"),
    refused_scene=out({"gravity": (-1.0, 2.0)}, "gravity=-1", "-1.0"), drive=out({"drive": (1.0, 2.0)}, "'drive'"),
    misfit=out({"jack_arm": (1.0, 5.0), "box_half_width": (3.0, 9.0)}, "jack_arm=5", "jack_arm must be below"),
)  # fmt: skip
DRAWN = instance({"gravity": 1.5}, "dict", unknown=out({"mass": 3.0}, "'mass'", named="scene"))
OPTIONS = instance({}, "nothing", dict=out({"stat": 1.0}, "'stat'", "'state'", "'time'", "'scene'"))

# -- objects that go on ------------------------------------------------------------------------------------------------


def driven(contact: str, **returned: Any) -> Any:
    """A step under functions that return these values from the middle of the step on."""
    late = {name: lambda time, value=value: value if time > 0.013 else 1.0 for name, value in returned.items()}
    one = make_simulator(Scene(drive=Drive(**late)), contact=contact)
    one.step(0.02)
    return one.state


ACTION = array([0.25], none=True).but(scalar=out(np.array(math.nan), "nan"), square=out(np.zeros((1, 1)), "(1, 1)"))
ACTIONS = array([[0.25], [0.5], [-0.25]], none=True).but(
    "action", nan_inside=out([[0.25], [0.5], [math.nan]], "nan", "environment 2"),
    transposed=out(np.zeros((1, 3)), "(1, 3)"),
)  # fmt: skip
PAIR, PAIRS = array([0.25, -0.5], none=True), array([[0.25, -0.5], [0.5, 0.0], [-0.25, 1.0]], none=True).but("action")
FLOATS, FEW = (
    {"float": 1.0, "half": np.array(0.5), "text": "1", "bool": True, "array": np.zeros((2, 2))},
    ("from 0 to 2",),
)
CHOICE = Argument(
    1, {**each(wrong, FLOATS, *FEW), **each(out, {"below": -1, "above": 3}, *FEW),
        "two": out([1, 1], "(2,)")},
    {"0-d": np.array(1), "numpy": np.int64(1), "list": [1], "byte": np.uint8(1)}, (0, 2, None),
)  # fmt: skip
CHOICES = Argument(
    [1, 0, 2], {**each(wrong, {"floats": [1.0, 0.0, 2.0], "bools": [True] * 3}, *FEW), "two": out([1, 1], "(2,)"),
                "above": out([1, 0, 3], "3", "environment 2", *FEW, named="action")},
    {"array": np.array([1, 0, 2]), "column": np.array([[1], [0], [2]]), "bytes": np.array([1, 0, 2], np.uint8)},
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
    one, alone, batch = simulator(contact), single(contact=contact), several(contact=contact, with_infos=True)
    nouns: dict[str, dict[str, Any]] = {
        "landing": {"action": "landing", "observation": "landing", "action_repeat": "bounce"},
        "discrete": {"action": "discrete", "action_repeat": 3},
    }
    held, start, time = state(1.0), state(1e-9).but(nothing=None), real(1.0, at_least=-1e9, at_most=1e9)
    light = out({"jack_inertia": 1e-6}, "couple the feet", named="jack_inertia") if contact == "pymunk" else None
    options: Kinds = {"options": OPTIONS, "options.scene": CHANGES.but(light=light)}
    first: Kinds = {
        "seed": SEEDS,
        "options": OPTIONS,
        "options.time": TIMES.but("options['time']", nothing=None),
        "options.reset_mask": mask([True, False, True]).but(
            "options['reset_mask']", nothing=None, none=out(np.zeros(3, dtype=bool), "got none")
        ),
    }
    rows: list[tuple[str, Kinds, Subject]] = [
        ("Simulator.reset", {"state": held, "time": time}, one),
        ("Simulator.step", {"dt": DT.but(too_late=out(2e9, "2e+09", "1e+09")), "torque": real(1000.0, none=True)}, one),
        (
            "JackInBoxEnv.reset",
            {**options, FROM: start, "options.time": time.but("options['time']", nothing=None)},
            alone,
        ),
        ("JackInBoxEnv.step", {"action": ACTION}, alone),
        ("JackInBoxEnv.set_state", {"state": held, "time": time, "steps": whole(7, 0, 500, none=True)}, alone),
        ("JackInBoxVectorEnv.reset", {**options, **first, FROM: rows_of(array(ROWS, none=True), 1e-9)}, batch),
        ("JackInBoxVectorEnv.check_reset", first, batch),
        ("JackInBoxVectorEnv.scene_of", {"number": whole(1, 0, 2)}, batch),
        ("JackInBoxVectorEnv.field", {"name": choice("gravity", (*NUMBERS, "speed_scale"))}, batch),
        ("JackInBoxVectorEnv.impacts", {"number": whole(1, 0, 2)}, batch),
        ("JackInBoxVectorEnv.step", {"actions": ACTIONS}, batch),
        (
            "JackInBoxVectorEnv.set_states",
            {"states": rows_of(array(ROWS), 1.0), "times": TIMES, "chosen": mask([True, False, True])},
            batch,
        ),
        ("JackInBoxVectorEnv.tiled", {"first": whole(2, 1, 1024), "size": size((16, 24), 16, 1024)}, batch),
    ]
    for name, pair in {"landing": (PAIR, PAIRS), "discrete": (CHOICE, CHOICES)}.items():
        rows += [
            ("JackInBoxEnv.step", {"action": pair[0]}, single(contact=contact, **nouns[name])),
            ("JackInBoxVectorEnv.step", {"actions": pair[1]}, several(contact=contact, **nouns[name])),
        ]
    for name, arguments, subject in rows:
        yield Row(name, attrgetter(name.rpartition(".")[2]), arguments, subject, contact=contact)
    drives = {name: real(0.5).but(f"{name}(") for name in DRIVES}
    yield Row("Drive", lambda _: partial(driven, contact), drives, contact=contact)


# -- functions and constructors ----------------------------------------------------------------------------------------

INDEX = whole(1, 0, 3)
CONTACTS = Argument(
    [(0, 0), (1, 2)],
    {
        **each(wrong, {"nothing": None, "number": 1.5, "function": print}),
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
    "render_mode": choice("rgb_array", ("human", "rgb_array", "rgb_array_list"), none=True),
    "fidelity": choice(None, FIDELITIES, none=True),
    "randomize": RANDOMIZE,
    "render_size": size((16, 24), 16, 4096),
    "render_overlay": flag(True),
    "observation": OBSERVATION,
    "action": ACTING,
    "action_repeat": replace(
        whole(2, 1, 1_000_000).but(text=out("nan", '"bounce"'), empty_text=out("", '"bounce"')),
        accepted=(1, 1_000_000, "bounce"),
    ),
    "episode_steps": whole(100, 1, 10**15, none=True),
}
OF_VECTORS: Kinds = {
    **SETTINGS,
    "num_envs": whole(2, 1, 10**9),
    "render_mode": choice("rgb_array", ("human", "rgb_array"), none=True).but(
        human=out("human", "several", "'human'"), list_of_frames=out("rgb_array_list", "'rgb_array_list'")
    ),
    "max_episode_steps": whole(None, 1, 50, none=True),  # decisions of 2 of 100 control steps
    "num_threads": THREADS,
    "with_infos": flag(False),
    "scene": SCENES.but(short=out([None], "list of 2", "1 of them")),
}
ROLLOUT: Kinds = {
    "scene": SCENES.but(long=out([None] * 4, "list of 3", "4 of them")),
    "states": rows_of(array(ROWS), 1.0).but(fewer=out(ROWS[:2], "as many", "2", "3")),
    "torques": array(np.array([[0.0, 64.0], [1.0, 2.0], [3.0, 4.0]])).but(more=None, empty=None),
    "dt": DT,
    "time": real(1.0, at_least=-1e9, at_most=1e9, ends=False),
    "energy": flag(True),
    "impacts": flag(True),
    "rewards": TASK.but(nothing=None),
    "repeat": whole(2, 1, 1_000_000),
    "trajectories": flag(True),
    "num_threads": THREADS,
}
LINEARIZING: Kinds = {
    **{name: ROLLOUT[name] for name in ("scene", "states", "dt", "repeat", "num_threads")},
    "torques": ROLLOUT["torques"].but(nothing=None),
    "time": ROLLOUT["time"].but(list=out([1.0], "3"), ragged=wrong([[1.0]], "[1.0]"), array=wrong(np.eye(2), "0.")),
    "fields": Argument(
        ("gravity",),
        {
            **each(wrong, {"text": "gravity", "number": 3.0}),
            "unknown": out(("weight",), "'gravity'", "'weight'", named="field"),
        },
    ),
}
IMPROVING: Kinds = {
    **{name: ROLLOUT[name] for name in ("dt", "repeat")},
    "scene": ONE_SCENE, "state": state(1.0),
    "torques": array([0.0, 64.0]).but(beyond=out([0.0, 1e5], "90000", "100000"), more=None),
    "task": choice("juggle", SLOPES), "cost": Argument(None, {"number": wrong(3.0)}),
}  # fmt: skip
CHOOSING: Kinds = {
    "scene": SCENES.but(many=out([None] * 3, "cases", "3", "2")),
    **{name: real(8.0, above=0.0).but(inf=None) for name in ("first_impact_error", "penetration")},
    "cases": whole(2, 1, 10_000),
    "steps": replace(whole(120, 1, 1_000_000), accepted=()),
    "control_dt": DT,
    "seed": Argument(5, SEED.refused, {"numpy": np.int64(5), "0-d": np.array(5)}),
    "contact": choice("pymunk", ("pymunk", "exact"), none=True),
}
COUNTS = ("total_steps", "num_envs", "rollout_steps", "epochs", "checkpoint_steps", "eval_steps", "eval_episodes")
TRAINING: Kinds = {
    "seed": whole(5, 0, 2**32 - 1),
    **{name: whole(4, 1).but(absurd=out(10**13, str(10**13))) for name in COUNTS},
    "batch_size": whole(4, 2),
    "torch_threads": whole(2, 1).but(absurd=out(1025, "1024", "1025")),
    "observation": choice("state", ("state", "landing")),
    "action": choice("torque", ("torque", "landing", "discrete")),
    "action_repeat": SETTINGS["action_repeat"].but(word=out("landing", "bounce", "landing")),
    **{name: real(0.5, above=0.0) for name in ("learning_rate", "clip_range")},
    **{name: real(0.5, at_least=0.0, at_most=1.0) for name in ("gamma", "gae_lambda")},
    **{name: real(0.5) for name in ("entropy_coefficient", "initial_log_std")},
    "hidden_units": instance((8, 4), "list", "ragged", zero=out((8, 0), "0"), floats=wrong((8.0,), "8.0")),
    "fidelity": SETTINGS["fidelity"],
}


def cheapest(**arguments: Any) -> Any:
    return jackbox_env.cheapest(**arguments)._replace(microseconds=0.0)


def drawn(randomize: Any) -> Any:
    """Draw the scene by a function of the generator that returns this."""
    return JackInBoxEnv(randomize=lambda rng: randomize).reset(seed=1)


MODES = replace(
    choice("SAME_STEP", ("NEXT_STEP", "SAME_STEP", "DISABLED")).but(upper=None),
    accepted=("NextStep", "SameStep", "Disabled"),
)
# All that makes or computes something, and keeps nothing.
FUNCTIONS: list[tuple[Callable[..., Any], Kinds]] = [
    (states.as_state, {"state": state()}),
    (states.as_start, {"scene": ONLY_A_SCENE, "state": state(1e-9)}),
    (states.as_restored, {"scene": ONLY_A_SCENE, "state": state(1.0)}),
    (mechanics.gaps, IN_A_SCENE),
    (mechanics.energy, IN_A_SCENE),
    (mechanics.gap_jacobian, {**IN_A_SCENE, "wall": INDEX, "foot": INDEX}),
    (mechanics.impact_map, {**IN_A_SCENE, "wall": INDEX, "foot": INDEX}),
    (mechanics.simultaneous_impact_map, {**IN_A_SCENE, "contacts": CONTACTS}),
    (Scene, FIELDS),
    (Scene().changed, FIELDS),
    (Scene.of, {"given": ONE_SCENE.but("scene")}),
    (Chirp, CHIRP),
    (Drive, DRIVES),
    (
        make_simulator,
        {**{name: SETTINGS[name] for name in ("scene", "contact", "fidelity", "substeps")}, "iterations": SUBSTEPS},
    ),
    (JackInBoxEnv, SETTINGS),
    (JackInBoxVectorEnv, {**OF_VECTORS, "autoreset_mode": MODES}),
    (make_sb3_vec_env, OF_VECTORS),
    (jackbox_env.Pixels, {"size": size((84, 84), 16, 4096), "stack": whole(1, 1, 83)}),
    (drawn, {"randomize": DRAWN}),
    (jackbox_env.rollout, ROLLOUT),
    (jackbox_env.linearize, {**LINEARIZING, "steps": Argument(None, {})}),
    (jackbox_env.ilqr, IMPROVING),
    (cheapest, CHOOSING),
    (TrainSettings, TRAINING),
]

TABLE = [
    *(Row(made.__qualname__, partial(lambda made, _: made, made), arguments) for made, arguments in FUNCTIONS),
    *(row for contact in CONTACT_MODELS for row in methods_of(contact)),
]
