"""How others simulate this system: models that :mod:`jackbox_env.measure.accuracy` measures beside this package's.

Users of the environment cannot choose them.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable

from scripts.studies.rivals.base import Rival

Factory = Callable[..., Rival]  # takes the scene and the substeps per control step
_RIVALS = {  # class in the module of that name, package needed, extra of this project that installs it
    "naive": ("NaiveSimulator", "numpy", "dev"),
    "box2d": ("Box2DSimulator", "Box2D", "dev"),
    "mujoco": ("MujocoSimulator", "mujoco", "peers"),
}


def missing() -> dict[str, str]:
    """Rivals whose package is not installed, and how to install it."""
    packages = {name: entry[1:] for name, entry in _RIVALS.items() if importlib.util.find_spec(entry[1]) is None}
    return {name: f"not installed (pip install -e '.[{extra}]')" for name, (_, extra) in packages.items()}


def available() -> dict[str, Factory]:
    """The other rivals."""
    modules = {name: importlib.import_module(f"{__name__}.{name}") for name in _RIVALS if name not in missing()}
    return {name: getattr(module, _RIVALS[name][0]) for name, module in modules.items()}


__all__ = ["Factory", "Rival", "available", "missing"]
