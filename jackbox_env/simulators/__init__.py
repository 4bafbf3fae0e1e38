"""Contact models behind one interface, chosen by name."""

from __future__ import annotations

from typing import Any

from jackbox_env import _validation as check
from jackbox_env.scene import Scene
from jackbox_env.simulators.base import Impact, JackLostError, Simulator

CONTACT_MODELS = ("pymunk", "exact")


def make_simulator(scene: Scene | dict[str, Any] | None = None, contact: str = "pymunk", **settings: Any) -> Simulator:
    """Make the simulator of a scene with the contact model of that name.

    Args:
        scene: a Scene, a dict of some of its fields, or None for the default scene.
        contact: ``"pymunk"``, time stepping (:mod:`jackbox_env.simulators.pymunk`), or ``"exact"``, from impact to
            impact (:mod:`jackbox_env.simulators.exact`).
        **settings: the model's own: ``substeps`` (4) and ``iterations`` (64) for pymunk, none for exact; None stands
            for the default.

    Raises:
        TypeError, ValueError: an unknown model or setting, or a setting out of its range.
    """
    check.choice("contact", contact, CONTACT_MODELS)
    scene = Scene.of(scene)
    given = {name: value for name, value in settings.items() if value is not None}
    if contact == "exact":
        check.known_keys(f"contact={contact!r}", settings, ("substeps", "iterations"))
        for name, value in given.items():
            raise ValueError(f"contact='exact' has no substeps or iterations, got {name}={check.shown(value)}")
        from jackbox_env.simulators.exact import ExactSimulator

        return ExactSimulator(scene)
    check.known_keys(f"contact={contact!r}", settings, ("substeps", "iterations"))
    from jackbox_env.simulators.pymunk import PymunkSimulator

    return PymunkSimulator(scene, **given)


__all__ = ["CONTACT_MODELS", "Impact", "JackLostError", "Simulator", "make_simulator"]
