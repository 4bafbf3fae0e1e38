"""Contact models behind one interface, chosen by name; and what an agent observes, does and earns on them."""

from __future__ import annotations

import importlib
from types import MappingProxyType
from typing import Any

from jackbox_env.model.scene import Scene
from jackbox_env.simulators.base import Impact, JackLostError, Simulator, StepResult
from jackbox_env.simulators.fidelity import Setting, resolve
from jackbox_env.tools import checks as check

CONTACT_MODELS = MappingProxyType(  # where the class of each is
    {
        "pymunk": "jackbox_env.simulators.pymunk.PymunkSimulator",
        "exact": "jackbox_env.simulators.exact.ExactSimulator",
    }
)


def contact_model(name: str) -> type[Simulator]:
    """The class of a contact model; its module, and so its engine, is loaded now.

    Raises:
        TypeError, ValueError: there is none of that name.
    """
    module, _, kind = CONTACT_MODELS[check.choice("contact", name, CONTACT_MODELS)].rpartition(".")
    model: type[Simulator] = getattr(importlib.import_module(module), kind)
    return model


def make_simulator(
    scene: Scene | dict[str, Any] | None = None,
    contact: str | None = None,
    fidelity: str | None = None,
    **settings: Any,
) -> Simulator:
    """Make the simulator of a scene, by the same names as the environments.

    >>> simulator = make_simulator({"gravity": 1.62}, fidelity="exact")
    >>> simulator.step(0.02, torque=0.0).time
    0.02

    Args:
        scene: a Scene, a dict of some of its fields, or None for the default scene.
        contact: ``"pymunk"``, time stepping (:mod:`jackbox_env.simulators.pymunk`), or ``"exact"``, from impact to
            impact (:mod:`jackbox_env.simulators.exact`). None: the fidelity's, else pymunk.
        fidelity: a name of ``FIDELITIES``, for a contact model and its substeps.
        **settings: those that the model's class lists: ``substeps`` (4) and ``iterations`` (64) for pymunk, none for
            exact; None means the default.

    Raises:
        TypeError, ValueError: an unknown model or setting, one out of its range, or one that conflicts with the
            fidelity.
    """
    named = resolve(fidelity, contact, **{name: settings.pop(name, None) for name in Setting._fields[1:]})
    contact, scene = named.contact, Scene.of(scene)
    model = contact_model(contact)
    settings |= {name: value for name, value in named._asdict().items() if name != "contact"}
    chosen = {name: value for name, value in settings.items() if value is not None}
    for name, value in chosen.items():
        if name not in model.settings:
            every = dict.fromkeys(known for one in CONTACT_MODELS for known in contact_model(one).settings)
            check.known_keys(f"contact={contact!r}", [name], every)
            raise ValueError(f"contact={contact!r} has no {name}, got {name}={check.shown(value)}")
    return model(scene, **chosen)


__all__ = ["CONTACT_MODELS", "Impact", "JackLostError", "Simulator", "StepResult", "make_simulator"]
