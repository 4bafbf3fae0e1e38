"""Models of Stable-Baselines3 that were trained without this project's command, played as they were trained.

How a model acts is stored in env.json beside it (:func:`jackbox_env.sb3.save_model`), or comes from options.
"""

from __future__ import annotations

import json
import pickle
import sys
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.files import as_value_error, unpacked
from agents.policies.playing import Actions
from agents.policies.trained import Acting, TrainedPolicy
from agents.settings import EPISODE_STEPS, LANDING_FIELDS, EnvSettings
from jackbox_env import Scene
from jackbox_env import checks as check
from jackbox_env.landing import steps_until_impact
from jackbox_env.observation import BOUNDS
from jackbox_env.planning.features import Features, LookaheadOptions

# Algorithms by a name that only their models store; PPO's have A2C's too.
_ALGORITHMS = {
    "clip_range": "PPO", "target_entropy": "SAC", "target_policy_noise": "TD3", "normalize_advantage": "A2C",
}  # fmt: skip
_CIRCLES = [4, 5], [7, 8]  # components of an observation that are a cosine and a sine


class Options(NamedTuple):
    """How a model acts that env.json does not describe; None: a torque in each control step, not normalized."""

    landing: float | Literal["bounce"] | None = None  # period of landing control [s], or until an impact
    repeat: int | None = None  # control steps of an action
    vecnormalize: Path | None = None  # statistics that VecNormalize has saved


class ModelPolicy(TrainedPolicy):
    """A model of Stable-Baselines3 with the ten numbers of the ordinary environment; it draws no actions.

    Args:
        model: with ``predict``.
        acting: how it acts.
        normalize: mean, variance, clip and epsilon of its observations; None: they are not normalized.
        stored: the entry of env.json that describes it, if one does.
    """

    def __init__(
        self,
        model: Any,
        acting: Acting,
        normalize: dict[str, Any] | None = None,
        stored: dict[str, Any] | None = None,
    ) -> None:
        super().__init__(acting)
        self.model, self.stored, self._normalize = model, stored, normalize

    def act(self, observations: NDArray[Any]) -> Actions:
        """The model's actions, shape (n, action_size)."""
        values, by = np.asarray(observations, dtype=np.float32), self._normalize
        if by is not None:
            scaled = (values - by["mean"]) / np.sqrt(by["variance"] + by["epsilon"])
            values = np.clip(scaled, -by["clip"], by["clip"]).astype(np.float32)
        actions: Actions = self.model.predict(values, deterministic=True)[0]
        return np.clip(actions, -1.0, 1.0).astype(np.float32)


def load(file: Path) -> Any:
    """A model of PPO, A2C, SAC or TD3, which is unpickled.

    Raises:
        ValueError: the file is damaged, or of something else.
    """
    with as_value_error(f"{file} is no model of Stable-Baselines3"):
        import stable_baselines3

        stored = json.loads(unpacked(file.read_bytes(), file.name)["data"])
        names = [algorithm for key, algorithm in _ALGORITHMS.items() if key in stored]
        if not names:
            raise ValueError(f"it must be of {', '.join(_ALGORITHMS.values())}")
        return getattr(stable_baselines3, names[0]).load(file, device="cpu")


def stored_beside(file: Path) -> dict[str, Any] | None:
    """How a model acts by the env.json beside it; None if that has no entry for it.

    A model that was renamed has the only entry, if no other model is in its folder.

    Raises:
        ValueError: env.json is damaged.
    """
    from jackbox_env.saved_models import ENV, read_stored

    entries = read_stored(file.parent / ENV)
    if len(entries) == 1 and not (file.parent / next(iter(entries))).exists():
        return next(iter(entries.values())) if list(file.parent.glob(f"*{file.suffix}")) == [file] else None
    return entries.get(file.name)


def policy_of(file: Path, model: Any, settings: EnvSettings, options: Options) -> ModelPolicy:
    """The policy of a loaded model in an environment, as env.json beside it or the options describe it.

    Raises:
        TypeError, ValueError: the model does not fit, or statistics of its observations are missing; the message names
            the wrapper or the option that would fit. There are options, and env.json describes the model too. The model
            computes landings or rollouts in one scene, and scenes vary.
    """
    beside = stored_beside(file)
    if beside is not None and options != Options():
        chosen = " and ".join(f"--{name}" for name, value in options._asdict().items() if value is not None)
        raise ValueError(f"{file} acts as env.json beside it describes: leave {chosen} out, or move the model")
    stored = {"repeat": 1, "landing": None, "lookahead": None, "normalize": None, "unknown": [], **(beside or {})}
    stored |= {name: value for name, value in options._asdict().items() if value is not None}
    if options.landing is not None and options.repeat is not None:
        raise ValueError(
            f"{file} cannot act by --landing and --repeat {options.repeat}: a landing lasts for its period"
        )
    if options.vecnormalize is not None:
        stored["normalize"] = _statistics(options.vecnormalize)
    with as_value_error(f"{file} cannot act as env.json or the options describe"):
        unknown = ", ".join(map(str, stored["unknown"]))
        acting = _acting(stored, settings)
        if stored["normalize"] is not None:
            stored["normalize"] = _checked(stored["normalize"])
    if unknown:
        raise ValueError(f"{file} was trained under {unknown}, which cannot be played here")
    _refuse_unfit(file, model, acting)
    _refuse_varied(file, acting, settings)
    if stored["normalize"] is None and _is_normalized(model):
        raise ValueError(
            f"{file} was trained under VecNormalize, whose statistics are missing: use --vecnormalize FILE.pkl, or "
            "save it by jackbox_env.sb3.save_model"
        )
    if beside is None and options == Options():
        print(
            f"Note: no env.json beside {file} describes it, so it decides in every control step (--repeat)",
            file=sys.stderr,
        )
    return ModelPolicy(model, acting, stored["normalize"], beside)


def _checked(normalize: dict[str, Any]) -> dict[str, Any]:
    """Statistics of observations as arrays; raises KeyError, TypeError or ValueError if they are none."""
    mean, variance = (np.array(normalize[name], np.float64) for name in ("mean", "variance"))
    if (
        mean.shape != (len(BOUNDS),)
        or variance.shape != mean.shape
        or not (np.isfinite(mean).all() and (variance >= 0.0).all())
    ):
        raise ValueError(f"mean and variance must be {len(BOUNDS)} numbers each, at least 0 in the variance")
    clip, epsilon = (check.real(name, normalize[name], at_least=0.0) for name in ("clip", "epsilon"))
    return {"mean": mean, "variance": variance, "clip": clip, "epsilon": epsilon}


def _acting(stored: dict[str, Any], settings: EnvSettings) -> Acting:
    scene, dt, features = Scene.of(settings.scene_fields), settings.control_dt, None
    repeat, resting = check.whole("repeat", stored["repeat"], at_least=1, at_most=EPISODE_STEPS), 0
    if stored["landing"] == "bounce":
        repeat, resting = steps_until_impact(dt)
    elif stored["landing"] is not None:
        repeat = max(1, round(check.real("landing", stored["landing"], above=0.0, at_most=EPISODE_STEPS * dt) / dt))
    if stored["lookahead"] is not None:
        features = Features(settings.task, dt, LookaheadOptions(**{**stored["lookahead"], "num_threads": 1}))
    return Acting(scene, dt, repeat, resting, stored["landing"] is not None, features)


def _refuse_unfit(file: Path, model: Any, acting: Acting) -> None:
    """Raise ValueError for a model that observes or acts otherwise; the message names the wrapper that would fit."""
    extra = 0 if acting.features is None else len(acting.features.high)
    needed, got = (
        ((len(BOUNDS) + extra,), (1 + acting.landing,)),
        (model.observation_space.shape, model.action_space.shape),
    )
    if got == needed:
        return
    if got[1] == (2,) and not acting.landing:
        advice = "LandingControlVecEnv would fit: use --landing bounce, or --landing with its period [s]"
    elif got[1] == (1,) and acting.landing:
        advice = "actions are torques: leave --landing out"
    elif got[0] is not None and got[0][0] > needed[0][0]:
        wrapper = "VecFrameStack" if got[0][0] % len(BOUNDS) == 0 else "LookaheadVecEnv"
        advice = f"{wrapper} would perhaps fit: save the model by jackbox_env.sb3.save_model, which stores wrappers"
    else:
        advice = "no wrapper here would fit"
    sizes = f"{needed[0][0]} numbers and choose {needed[1][0]}"
    raise ValueError(f"{file} must observe {sizes}, got shapes {got[0]} and {got[1]}; {advice}")


def _refuse_varied(file: Path, acting: Acting, settings: EnvSettings) -> None:
    """Raise ValueError if landings or rollouts are computed in one scene, and scenes vary in what they depend on."""
    varied = [name for name in settings.randomized if acting.features or (acting.landing and name in LANDING_FIELDS)]
    if varied:
        computed = "its rollouts" if acting.features else "torques towards landings"
        raise ValueError(f"{file} computes {computed} in one scene: leave {' and '.join(varied)} out of --randomize")


def _is_normalized(model: Any) -> bool:
    """Whether the last observations in training had sines and cosines that are none."""
    last = getattr(model, "_last_obs", None)
    if not isinstance(last, np.ndarray) or last.ndim != 2 or last.shape[1] < len(BOUNDS):
        return False
    return any(abs(np.square(last[:, pair]).sum(axis=1) - 1.0).max() > 1e-3 for pair in _CIRCLES)


def _statistics(path: Path) -> dict[str, Any] | None:
    """The statistics in a file of ``VecNormalize``, which is unpickled."""
    from stable_baselines3.common.vec_env import VecNormalize

    from jackbox_env.saved_models import statistics_of

    with as_value_error(f"{path} has no statistics of VecNormalize"):
        normalize = pickle.loads(path.read_bytes())
        if not isinstance(normalize, VecNormalize):
            raise TypeError(f"it is {check.shown(normalize)}")
        return statistics_of(normalize)
