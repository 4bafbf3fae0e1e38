"""Other ways to simulate this system, which the accuracy study compares with this package's contact models.

The environment does not offer them.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable

from scripts.studies.baselines.base import Baseline

_PACKAGES = {"box2d": ("Box2D", "dev"), "mujoco": ("mujoco", "peers")}  # and the extra of this project that installs it
IN_JAVASCRIPT = ("rapier", "matter")  # adapters that Node runs


def missing() -> dict[str, str]:
    """Engines that are not installed, and how to install them."""
    return {
        name: f"not installed (pip install -e '.[{extra}]')"
        for name, (package, extra) in _PACKAGES.items()
        if importlib.util.find_spec(package) is None
    }


def baseline(name: str) -> Callable[..., Baseline]:
    """The model called threshold, solve_ivp, box2d or mujoco.

    Raises:
        ImportError: its engine is not installed.
    """
    model: Callable[..., Baseline] = importlib.import_module(f"{__name__}.{name}").Model
    return model
