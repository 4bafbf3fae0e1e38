"""Gymnasium's environments: the single one, and many together on the CPU or on a GPU."""

from __future__ import annotations

from typing import Any


def make_vec(num_envs: int = 1, device: str | None = None, **settings: Any) -> Any:
    """Many environments, on a GPU if ``device`` is "cuda"; ``gymnasium.make_vec`` calls this."""
    if device is None:
        from jackbox_env.envs.vector import JackInBoxVectorEnv

        return JackInBoxVectorEnv(num_envs, **settings)
    from jackbox_env.envs.on_card import CardVectorEnv

    return CardVectorEnv(num_envs, device=device, **settings)
