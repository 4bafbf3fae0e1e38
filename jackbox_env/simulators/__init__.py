"""Contact models behind one interface, chosen by name."""

from __future__ import annotations

from typing import Any

from jackbox_env import _validation as check
from jackbox_env.scene import Scene
from jackbox_env.simulators.base import Impact, Simulator

CONTACT_MODELS = ("pymunk",)


def make_simulator(scene: Scene | dict[str, Any] | None = None, contact: str = "pymunk", **settings: Any) -> Simulator:
    """Make the simulator of a scene with the contact model of that name.

    Args:
        scene: a Scene, a dict of some of its fields, or None for the default scene.
        contact: ``"pymunk"``, time stepping (:mod:`jackbox_env.simulators.pymunk`).
        **settings: the model's own: ``substeps`` (4) and ``iterations`` (64) for pymunk; None stands for the default.

    Raises:
        TypeError, ValueError: an unknown model or setting, or a setting out of its range.
    """
    check.choice("contact", contact, CONTACT_MODELS)
    from jackbox_env.simulators.pymunk import PymunkSimulator

    check.known_keys(f"contact={contact!r}", settings, ("substeps", "iterations"))
    given = {name: value for name, value in settings.items() if value is not None}
    return PymunkSimulator(Scene.of(scene), **given)


__all__ = ["CONTACT_MODELS", "Impact", "Simulator", "make_simulator"]
