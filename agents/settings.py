"""All settings of the environment and of PPO, each with a line of help. The command lines derive from them."""

from __future__ import annotations

import json
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, fields, make_dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from jackbox_env import Scene
from jackbox_env.commands.options import SCENE_HELP, chosen_scene
from jackbox_env.model.action import ACTIONS, action_of, repeat_of
from jackbox_env.model.observation import OBSERVATIONS, observation_parts
from jackbox_env.model.pixels import Pixels, pixels_named
from jackbox_env.model.randomization import NUMBERS
from jackbox_env.model.tasks import TASKS
from jackbox_env.simulators.fidelity import KEYWORDS, Setting, chosen, explicit, resolve
from jackbox_env.tools import checks as check
from jackbox_env.tools.model_files import check_sizes
from jackbox_env.tools.user_code import is_object, with_objects

with suppress(ImportError):  # command lines need it; settings are also read without it
    import tyro

NAMES: dict[str, Collection[str]] = {  # built-in ones; "pixels-64x64x4" too
    "task": TASKS, "observation": (*OBSERVATIONS, "pixels"), "action": ACTIONS,
}  # fmt: skip
INTERFACE = ("observation", "action", "action_repeat")  # keywords of the environment: what a policy observes and does
PER_POLICY = (*INTERFACE, "torque")  # of each policy; all other keywords are the same for all that are compared
# Beyond these an untrusted run folder could fill all memory.
MOST_STEPS = 10**12  # also of episodes and samples
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


def setting_of(keywords: dict[str, Any]) -> Setting:
    """The contact model and its settings in one form, from keywords of the environment."""
    return explicit(resolve(**{name: keywords[name] for name in KEYWORDS}))


@dataclass(frozen=True)
class EnvSettings:
    """Settings of the environment, each of a JSON type."""

    task: str = "juggle"
    """The task: juggle, spin, rattle, or one of your own, file.py:name."""
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
        for name in NAMES:
            if hasattr(self, name) and name not in self.objects and not self._has_sizes(name):
                check.choice(name, getattr(self, name), [*NAMES[name], "file.py:name"])

    @classmethod
    def of(cls, values: Any) -> Self:
        """Make settings from a file's JSON.

        Raises:
            TypeError, ValueError: it is no dict, has an unknown key, or a setting is out of its range.
        """
        if not isinstance(values, dict):
            raise TypeError(f"settings must be a JSON object, got {check.shown(values)}")
        check.known_keys("settings", values, [field.name for field in fields(cls)])
        if isinstance(values.get("hidden_units"), list):
            values = {**values, "hidden_units": tuple(values["hidden_units"])}
        return cls(**values)

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

    def _has_sizes(self, name: str) -> bool:
        """Whether a setting is a name of pictures with their size, which is checked."""
        value = getattr(self, name)
        return name == "observation" and isinstance(value, str) and pixels_named(value) is not None

    @property
    def env_settings(self) -> dict[str, Any]:
        """Keyword arguments for ``gymnasium.make("JackInBox-v0", ...)``.

        Raises:
            ValueError: a user's task is not loaded.
        """
        return with_objects(self.named)

    @property
    def named(self) -> dict[str, Any]:
        """The keywords :attr:`env_settings` of JSON types: objects of one's own are named."""
        names = (*(part.name for part in fields(EnvSettings)), *(name for name in INTERFACE if hasattr(self, name)))
        keywords = {name: getattr(self, name) for name in names}
        return {**keywords, "scene": self.scene_fields, "randomize": self.randomized or None}

    @property
    def objects(self) -> dict[str, str]:
        """The settings that name objects of one's own."""
        return {name: getattr(self, name) for name in NAMES if is_object(getattr(self, name, None))}

    @property
    def changed(self) -> dict[str, Any]:
        """The keywords that differ from the default, those that choose the contact model together."""
        keywords, default = self.env_settings, EnvSettings().env_settings
        names = [name for name in default if keywords[name] != default[name]]
        return {name: keywords[name] for name in {*names, *(KEYWORDS if {*names} & {*KEYWORDS} else ())}}

    @property
    def options(self) -> list[str]:
        """Command-line options that select this environment: the task, and what differs from the default."""
        others, default = [part.name for part in fields(EnvSettings) if part.name != "task"], EnvSettings()
        changed = [name for name in others if getattr(self, name) not in (None, getattr(default, name))]
        pairs = [(f"--{'dt' if name == 'control_dt' else name}", str(getattr(self, name))) for name in changed]
        return ["--task", self.task, *(word for pair in pairs for word in pair)]


# Bounds of the settings that are real numbers.
_REAL: dict[str, dict[str, float]] = {
    "learning_rate": {"above": 0.0}, "clip_range": {"above": 0.0}, "gamma": {"at_least": 0.0, "at_most": 1.0},
    "gae_lambda": {"at_least": 0.0, "at_most": 1.0}, "entropy_coefficient": {}, "initial_log_std": {},
}  # fmt: skip

# The best settings of training if actions last a number of control steps: for landings, and for torques.
_REPEATED: dict[str, Any] = {
    "action_repeat": 20, "total_steps": 2_000_000, "num_envs": 256, "rollout_steps": 32, "learning_rate": 1e-3,
    "gamma": 0.905, "initial_log_std": -0.7, "checkpoint_steps": 500_000, "eval_steps": 250_000,
}  # fmt: skip
_PICTURES: dict[str, Any] = {  # of landings
    **_REPEATED,
    "num_envs": 256,
    "rollout_steps": 16,
    "batch_size": 512,
    "epochs": 3,
    "learning_rate": 5e-4,
    "initial_log_std": -2.0,
    "total_steps": 1_500_000,
}
_TORQUES: dict[str, Any] = {
    **_REPEATED, "action": "torque", "action_repeat": 4, "total_steps": 4_000_000, "num_envs": 1024, "epochs": 5,
    "gamma": 0.99, "hidden_units": (128, 128),
}  # fmt: skip
_RATTLE: dict[str, Any] = {  # rollouts of a whole episode, and more exploration
    **_TORQUES, "observation": "state", "num_envs": 256, "rollout_steps": 125, "batch_size": 1000, "gae_lambda": 0.95,
    "initial_log_std": 0.0,
}  # fmt: skip


@dataclass(frozen=True)
class TrainSettings(EnvSettings):
    """All settings of a training run. With the defaults, those of `make demo`, it takes about 45 s on one core.

    They are for juggle with one decision per bounce. `suited` has defaults for every task.
    """

    seed: int = 0
    """Seed of the network, the environments and the noise."""
    total_steps: int = 1_200_000
    """Steps to train for. A step is one decision of one environment."""
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
    """Discount per step; with `action_repeat` bounce, per second."""
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
    observation: str = "landing"
    (
        "What the networks observe: state (ten numbers), landing (21, with the next landing), pixels (or "
        "pixels-48x48x4: width, height and number of pictures), or your file.py:name."
    )
    action: str = "landing"
    (
        "What they choose: torque, discrete (-1, 0 or 1 of its limit), landing (the box's angle and rate then), or "
        "your file.py:name."
    )
    action_repeat: int | Literal["bounce"] = "bounce"
    """Control steps of each action, or bounce: until the next impact, at most 2 s."""
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

        Actions are landings on juggle, else torques. Landings last until the next impact, unless ``action_repeat`` is
        a number, or pictures are observed: at an impact these do not show the velocities after it.
        """
        action = settings.setdefault("action", "landing" if settings.get("task", cls.task) == "juggle" else "torque")
        pictures = str(settings.get("observation", "")).startswith("pixels")
        by_bounce = settings.get("action_repeat", None if pictures or action != "landing" else "bounce") == "bounce"
        torques = _RATTLE if settings.get("task") == "rattle" else _TORQUES
        repeated = (_PICTURES if pictures else _REPEATED) if action == "landing" else torques
        return cls(**({} if by_bounce else repeated) | settings)

    @classmethod
    def of(cls, values: Any) -> Self:
        """Settings from stored values, as :meth:`EnvSettings.of`, but none may be missing."""
        if isinstance(values, dict):
            values = {name: value for name, value in values.items() if name != "max_minutes"}  # which old ones have
        missing = [part.name for part in fields(cls) if isinstance(values, dict) and part.name not in values]
        if missing:
            raise ValueError(
                f"settings of another version, without {', '.join(missing[:3])}, cannot be used: train again"
            )
        return super().of(values)

    @property
    def pixels(self) -> Pixels | None:
        """The pictures that the networks observe; None: they observe numbers. Raises as ``env_settings``."""
        return observation_parts(with_objects({"observation": self.observation})["observation"])[1]

    @property
    def interface(self) -> dict[str, Any]:
        """The keywords ``observation``, ``action`` and ``action_repeat``; raises as ``env_settings``."""
        return with_objects({name: getattr(self, name) for name in INTERFACE})

    @property
    def arguments(self) -> dict[str, Any]:
        """Keyword arguments of PPO, of JSON types, but for its seed; raises as ``env_settings``."""
        layers = {"net_arch": [*self.hidden_units]}
        continuous = action_of(self.interface["action"]).size
        return {
            "policy": "CnnPolicy" if self.pixels else "MlpPolicy", "learning_rate": self.learning_rate,
            "n_steps": self.rollout_steps, "batch_size": self.batch_size, "n_epochs": self.epochs, "gamma": self.gamma,
            "gae_lambda": self.gae_lambda, "clip_range": self.clip_range, "ent_coef": self.entropy_coefficient,
            "policy_kwargs": {**layers, "log_std_init": self.initial_log_std} if continuous else layers,
        }  # fmt: skip

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
        repeat_of(self.action_repeat, self.control_dt)
        for name, bounds in _REAL.items():
            check.real(name, getattr(self, name), **bounds)
        if not isinstance(self.hidden_units, list | tuple):
            raise TypeError(f"hidden_units must be a list of whole numbers, got {check.shown(self.hidden_units)}")
        for width in self.hidden_units:
            check.whole("hidden_units", width, at_least=1)
        self._check_sizes(counts.split())
        if self.num_envs * self.rollout_steps < 2:
            raise ValueError("num_envs * rollout_steps must be at least 2 for PPO, got 1")

    def _check_sizes(self, counts: list[str]) -> None:
        """Raise ValueError for sizes beyond any memory, before allocating."""
        for name in counts:
            check.whole(name, getattr(self, name), at_least=1, at_most=MOST_STEPS)
        check.whole("torch_threads", self.torch_threads, at_least=1, at_most=MOST_THREADS)
        shape: tuple[int, ...] = (1,)
        if "observation" not in self.objects:
            shape = self.pixels.shape if self.pixels else (len(OBSERVATIONS[self.observation].names),)
        check_sizes(self.num_envs, self.rollout_steps, shape, self.hidden_units)
