"""The jack in a box as a reinforcement-learning environment. Importing registers ``JackInBox-v0`` with Gymnasium."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from gymnasium.envs.registration import register

from jackbox_env.scene import Chirp, Drive, Scene

if TYPE_CHECKING:
    from jackbox_env.env import JackInBoxEnv
    from jackbox_env.simulators import Impact, Simulator, make_simulator

__version__ = "0.1.0"
__all__ = ["Chirp", "Drive", "Impact", "JackInBoxEnv", "Scene", "Simulator", "make_simulator"]

register(
    id="JackInBox-v0",
    entry_point="jackbox_env.env:JackInBoxEnv",
    max_episode_steps=500,  # 10 s
)


def __getattr__(name: str) -> Any:
    """Load what needs pymunk only when it is asked for."""
    if name == "JackInBoxEnv":
        from jackbox_env.env import JackInBoxEnv

        return JackInBoxEnv
    if name in ("Impact", "Simulator", "make_simulator"):
        from jackbox_env import simulators

        return getattr(simulators, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
