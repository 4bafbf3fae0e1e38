"""All settings of the environment and of PPO, each with a line of help. The command lines derive from them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, make_dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, cast

import gymnasium as gym

from jackbox_env import Scene
from jackbox_env import checks as check
from jackbox_env.commands.options import SCENE_HELP, chosen_scene
from jackbox_env.landing import steps_until_impact
from jackbox_env.observation import BOUNDS
from jackbox_env.randomization import NUMBERS
from jackbox_env.simulators.fidelity import FIDELITIES, Setting, chosen, explicit, resolve
from jackbox_env.tasks import TASKS

with suppress(ImportError):  # command lines need it; settings are also read without it
    import tyro

if TYPE_CHECKING:
    TaskName = str
else:
    TaskName = Literal[tuple(TASKS)]  # command lines show and check the names

EPISODE_STEPS = cast(int, gym.spec("JackInBox-v0").max_episode_steps)  # control steps of an episode
PREVIEW_SIZE, LOOKAHEAD_SIZE = 11, 26  # numbers that they append to an observation
PREVIEW_FIELDS = ("box_half_width", "jack_arm", "gravity")  # of the scene, which the preview depends on
LANDING_FIELDS = (*PREVIEW_FIELDS, "box_mass", "box_inertia", "torque_limit")

# Beyond these an untrusted run folder could fill all memory.
MOST_STEPS = 10**12  # also of episodes and samples
MOST_ROLLOUT_SAMPLES = 5_000_000  # between updates
MOST_LAYERS = 32
MOST_LOOKAHEAD = 4096
MOST_WEIGHTS = 20_000_000  # of one network; there are two
MOST_THREADS = 1024


if TYPE_CHECKING:
    SceneFields = Any
else:
    SceneFields = make_dataclass("SceneFields", [(name, float | None, None) for name in SCENE_HELP], frozen=True)
    SceneFields.__doc__ = "\n".join(  # tyro reads the help of each option from it
        [
            "Fields of the scene, also in --scene.",
            "",
            "Attributes:",
            *(f"    {one}: {SCENE_HELP[one]}" for one in SCENE_HELP),
        ]
    )


def scene_as_json(scene: str, options: object) -> str:
    """The fields of :func:`chosen_scene` as JSON; ``scene`` itself if there are no options of single fields."""
    fields = chosen_scene(scene, options)
    return scene if fields == check.from_json("scene", scene, dict) else json.dumps(fields)


def renamed(values: dict[str, Any]) -> dict[str, Any]:
    """Settings under their present names: ``repeat`` was called ``hold``."""
    old = {} if "repeat" in values else {"hold": "repeat"}
    return {old.get(name, name): value for name, value in values.items()}


def as_stored(stored: Mapping[str, Any]) -> dict[str, Any]:
    """Stored settings in which fidelity, contact and substeps mean what they meant in all earlier versions.

    A contact model or substeps beside a fidelity overrode it, and without all three it was "balanced".
    """
    fidelity, contact, substeps = (stored.get(name) for name in ("fidelity", "contact", "substeps"))
    if (fidelity, contact, substeps) == (None, None, None):
        return {**stored, "fidelity": "balanced"}
    if isinstance(fidelity, str) and fidelity in FIDELITIES and (contact, substeps) != (None, None):
        named = FIDELITIES[fidelity]
        if contact in (None, named.contact):
            contact, substeps = named.contact, named.substeps if substeps is None else substeps
        return {**stored, "fidelity": None, "contact": contact, "substeps": substeps}
    return dict(stored)


@dataclass(frozen=True)
class EnvSettings:
    """Settings of the environment, each of a JSON type."""

    task: TaskName = "juggle"
    """What is rewarded."""
    contact: str | None = None
    """Contact model in place of a fidelity: pymunk or exact."""
    substeps: int | None = None
    """Engine steps of pymunk per control step, with contact; None: 4."""
    control_dt: Annotated[float, tyro.conf.arg(name="dt", aliases=["--control-dt"])] = 0.02
    """Duration of a control step [s]."""
    scene: str = "{}"
    """Fields of the scene that differ from the default, as JSON, e.g. '{"gravity": 1.62}'."""
    fidelity: str | None = None
    """How impacts are computed: coarse, balanced, fine or exact; None: exact, unless contact or substeps is set."""
    randomize: str = "{}"
    """Ranges of the scene's fields, drawn at each reset, as JSON, e.g. '{"jack_mass": [2, 6]}'."""

    def __post_init__(self) -> None:
        """Raises ValueError for an unknown fidelity or an invalid scene; the environment checks the rest."""
        Scene.of(self.scene_fields)
        check.real("control_dt", self.control_dt, above=0.0)
        object.__setattr__(self, "fidelity", chosen(self).get("fidelity"))  # exact if none is chosen
        resolve(**chosen(self))
        check.known_keys("randomize", self.randomized, NUMBERS)

    @classmethod
    def of(cls, values: Any) -> Self:
        """Make settings from a file's JSON, of this version or an earlier one.

        Raises:
            TypeError, ValueError: it is no dict, has an unknown key, or a setting is out of its range.
        """
        if not isinstance(values, dict):
            raise TypeError(f"settings must be a JSON object, got {check.shown(values)}")
        values = renamed(values)
        check.known_keys("settings", values, [field.name for field in fields(cls)])
        if isinstance(values.get("hidden_units"), list):
            values = {**values, "hidden_units": tuple(values["hidden_units"])}
        return cls(**as_stored({"contact": cls.contact, **values}))

    @property
    def scene_fields(self) -> dict[str, Any]:
        """The scene as a dict.

        Raises:
            ValueError: it is not a JSON object.
        """
        return check.from_json("scene", self.scene, dict)

    @property
    def randomized(self) -> dict[str, Any]:
        """The ranges of the fields that vary, as a dict.

        Raises:
            ValueError: it is not a JSON object.
        """
        return check.from_json("randomize", self.randomize, dict)

    @property
    def env_settings(self) -> dict[str, Any]:
        """Keyword arguments for ``gymnasium.make("JackInBox-v0", ...)``."""
        keywords = {part.name: getattr(self, part.name) for part in fields(EnvSettings)}
        return {**keywords, "scene": self.scene_fields, "randomize": self.randomized or None}

    @property
    def options(self) -> list[str]:
        """Command-line options that select this environment: the task, and what differs from the default."""
        others, default = [part.name for part in fields(EnvSettings) if part.name != "task"], EnvSettings()
        changed = [name for name in others if getattr(self, name) not in (None, getattr(default, name))]
        pairs = [(f"--{'dt' if name == 'control_dt' else name}", str(getattr(self, name))) for name in changed]
        return ["--task", self.task, *(word for pair in pairs for word in pair)]

    @property
    def setting(self) -> Setting:
        """The contact model and its settings, in one form."""
        return explicit(resolve(**chosen(self)))


# Defaults for stored settings that lack a name: those of the versions that did not know it.
_EARLIER_DEFAULTS: dict[str, Any] = {
    "total_steps": 1_000_000, "num_envs": 16, "rollout_steps": 256, "batch_size": 512, "epochs": 10,
    "learning_rate": 5e-4, "gae_lambda": 0.95, "hidden_units": (64, 64), "initial_log_std": 0.0, "repeat": 1,
    "preview": False, "landing": False, "gamma": 0.99, "checkpoint_steps": 100_000, "eval_steps": 100_000,
    "eval_episodes": 32,
}  # fmt: skip

# Bounds of the settings that are real numbers.
_REAL: dict[str, dict[str, float]] = {
    "learning_rate": {"above": 0.0}, "clip_range": {"above": 0.0}, "gamma": {"at_least": 0.0, "at_most": 1.0},
    "gae_lambda": {"at_least": 0.0, "at_most": 1.0}, "entropy_coefficient": {}, "initial_log_std": {},
}  # fmt: skip

# The best settings of training if actions last a number of control steps: for landings, and for torques.
_REPEATED: dict[str, Any] = {
    "repeat": 20, "total_steps": 2_000_000, "num_envs": 256, "rollout_steps": 32, "learning_rate": 1e-3, "gamma": 0.905,
    "initial_log_std": -0.7, "checkpoint_steps": 500_000, "eval_steps": 250_000,
}  # fmt: skip
_TORQUES: dict[str, Any] = {
    **_REPEATED, "landing": False, "repeat": 4, "total_steps": 4_000_000, "num_envs": 1024, "epochs": 5, "gamma": 0.99,
    "hidden_units": (128, 128),
}  # fmt: skip


@dataclass(frozen=True)
class TrainSettings(EnvSettings):
    """All settings of a training run. With the defaults, those of `make demo`, it takes about 45 s on one core.

    They are for juggle with one decision per bounce. :meth:`suited` has defaults for every task.
    """

    seed: int = 0
    """Seed of the network, the environments and the noise."""
    total_steps: int = 1_200_000
    """Steps to train for. A step is one action of one environment; `repeat` sets its duration."""
    max_minutes: float | None = None
    """Time limit [min]; None: no limit."""
    num_envs: int = 512
    """Environments stepped together."""
    rollout_steps: int = 12
    """Steps of each environment between updates."""
    batch_size: int = 1024
    """Samples per gradient step."""
    epochs: int = 10
    """Passes over each rollout."""
    learning_rate: float = 2e-3
    """Learning rate of Adam, falling linearly to 0 at total_steps."""
    gamma: float = 0.72
    """Discount per step; with `repeat` bounce, per second."""
    gae_lambda: float = 0.9
    """Lambda of the generalised advantage estimate: bias against variance."""
    clip_range: float = 0.2
    """Clip range of the probability ratio."""
    entropy_coefficient: float = 0.0
    """Weight of the entropy bonus."""
    hidden_units: tuple[int, ...] = (64, 64)
    """Width of each hidden layer, in policy and value network."""
    initial_log_std: float = -1.0
    """Initial logarithm of the actions' standard deviation."""
    repeat: Annotated[int | Literal["bounce"], tyro.conf.arg(aliases=["--hold"])] = "bounce"
    # Parentheses, because tyro's help would keep a docstring's line breaks.
    (
        "Action repeat: control steps of each action, a divisor of the episode's 500. Or bounce, with landing: an "
        "action lasts until the next impact, at most 2 s."
    )
    preview: bool = True
    (
        "Append landing features to the observation. Such a model.zip loads only if this checkout can be imported; "
        "scripts/export.py makes a policy from it that needs only numpy."
    )
    lookahead: int = 0
    (
        "Rollouts that improve a plan before each action; the networks observe its return, and those of 9 scripted "
        "manoeuvres."
    )
    landing: bool = True
    """Actions are the box's angle and rate at the landing, not torques: jackbox_env.LandingControl. For juggle."""
    checkpoint_steps: int = 200_000
    """Steps between checkpoints, from which an interrupted run resumes."""
    eval_steps: int = 100_000
    """Steps between the evaluations that select the best model."""
    eval_episodes: int = 64
    """Episodes of each evaluation."""
    torch_threads: int = 1
    """Threads of torch; small networks are fastest with one."""

    @classmethod
    def suited(cls, **settings: Any) -> Self:
        """Complete ``settings`` with the defaults that train best on their task with their kind of actions.

        Without ``landing`` actions are torques, except on juggle without a lookahead. With it they last until the next
        impact, unless ``repeat`` is a number.
        """
        by_landing = settings.get("task", cls.task) == "juggle" and not settings.get("lookahead")
        landing = settings.setdefault("landing", by_landing)
        by_bounce = landing and settings.get("repeat", "bounce") == "bounce"
        return cls(**({} if by_bounce else _REPEATED if landing else _TORQUES) | settings)

    @classmethod
    def of(cls, values: Any) -> Self:
        """As :meth:`EnvSettings.of`; missing settings have the defaults of the version that did not know them."""
        return super().of({**_EARLIER_DEFAULTS, **renamed(values)} if isinstance(values, dict) else values)

    def __post_init__(self) -> None:
        """Check all settings.

        Raises:
            TypeError, ValueError: a setting out of its range.
        """
        super().__post_init__()
        check.whole("seed", self.seed, at_least=0, at_most=2**32 - 1)
        counts = "total_steps num_envs rollout_steps batch_size epochs checkpoint_steps eval_steps eval_episodes"
        for name in [*counts.split(), "torch_threads"]:
            check.whole(name, getattr(self, name), at_least=2 if name == "batch_size" else 1)
        self._check_actions()
        for name, bounds in _REAL.items():
            check.real(name, getattr(self, name), **bounds)
        if self.max_minutes is not None:
            check.real("max_minutes", self.max_minutes, above=0.0)
        if not isinstance(self.hidden_units, list | tuple):
            raise TypeError(f"hidden_units must be a list of whole numbers, got {check.shown(self.hidden_units)}")
        for width in self.hidden_units:
            check.whole("hidden_units", width, at_least=1)
        self._check_sizes(counts.split())
        if self.num_envs * self.rollout_steps < 2:
            raise ValueError("num_envs * rollout_steps must be at least 2 for PPO, got 1")

    @property
    def period(self) -> float | Literal["bounce"]:
        """Duration of an action [s], or "bounce", for LandingControl."""
        return "bounce" if self.repeat == "bounce" else self.repeat * self.control_dt

    @property
    def longest(self) -> int:
        """The most control steps of an action."""
        return steps_until_impact(self.control_dt)[0] if self.repeat == "bounce" else self.repeat

    @property
    def resting(self) -> int:
        """Control steps after which an impact ends an action in any case; 0: impacts do not end it."""
        return steps_until_impact(self.control_dt)[1] if self.repeat == "bounce" else 0

    def _check_actions(self) -> None:
        """Check what an action is, and that preview, landing control and lookahead suit the scene."""
        if isinstance(self.repeat, str) and self.repeat == "bounce":
            if not self.landing:
                raise ValueError("repeat must be a number of control steps without landing, got 'bounce'")
        elif EPISODE_STEPS % check.whole("repeat", self.repeat, at_least=1, at_most=EPISODE_STEPS):
            raise ValueError(f"repeat must divide the {EPISODE_STEPS} control steps of an episode, got {self.repeat}")
        check.flag("preview", self.preview)
        check.flag("landing", self.landing)
        for name, scene_fields in (("preview", PREVIEW_FIELDS), ("landing", LANDING_FIELDS)):
            varied = [field for field in scene_fields if field in self.randomized]
            if getattr(self, name) and varied:
                raise ValueError(f"{name} must be off if {' and '.join(varied)} varies: it is computed for one scene")
        if check.whole("lookahead", self.lookahead, at_least=0, at_most=MOST_LOOKAHEAD) in range(1, 8):
            raise ValueError(f"lookahead must be 0 or from 8 to {MOST_LOOKAHEAD}, got {self.lookahead}")
        if self.lookahead and self.landing:
            raise ValueError("landing must be off with a lookahead: its plans are torques")
        if self.lookahead and self.randomized:
            raise ValueError("lookahead must be 0 if scenes vary: its rollouts use one scene")

    def _check_sizes(self, counts: list[str]) -> None:
        """Raise ValueError for sizes beyond any memory, before allocating."""
        for name in counts:
            check.whole(name, getattr(self, name), at_least=1, at_most=MOST_STEPS)
        check.whole("torch_threads", self.torch_threads, at_least=1, at_most=MOST_THREADS)
        samples = self.num_envs * self.rollout_steps
        if samples > MOST_ROLLOUT_SAMPLES:
            raise ValueError(f"num_envs * rollout_steps must be at most {MOST_ROLLOUT_SAMPLES:,}, got {samples:,}")
        if len(self.hidden_units) > MOST_LAYERS:
            raise ValueError(f"hidden_units must be at most {MOST_LAYERS} layers, got {len(self.hidden_units):,}")
        inputs = len(BOUNDS) + PREVIEW_SIZE * self.preview + LOOKAHEAD_SIZE * bool(self.lookahead)
        weights = sum(before * after for before, after in pairwise((inputs, *self.hidden_units, 1)))
        if weights > MOST_WEIGHTS:
            raise ValueError(
                f"hidden_units must make a network of at most {MOST_WEIGHTS:,} weights, got "
                f"{check.shown(self.hidden_units)}"
            )
