"""How others simulate this system: contact models that :mod:`jackbox_env.accuracy` can follow beside this package's.

None of them is offered to users of the environment; they are here to be measured.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import NamedTuple

from jackbox_env.scene import Scene
from scripts.studies.rivals.base import Rival

Factory = Callable[[Scene, int], Rival]  # of a scene and substeps per control step


class _Entry(NamedTuple):
    factory: Factory
    package: str | None  # that must be there
    extra: str | None  # of this project that brings it


def _naive(scene: Scene, substeps: int) -> Rival:
    from scripts.studies.rivals.naive import NaiveSimulator

    return NaiveSimulator(scene, substeps)


def _box2d(scene: Scene, substeps: int) -> Rival:
    from scripts.studies.rivals.box2d import Box2DSimulator

    return Box2DSimulator(scene, substeps)


def _mujoco(scene: Scene, substeps: int) -> Rival:
    from scripts.studies.rivals.mujoco import MujocoSimulator

    return MujocoSimulator(scene, substeps)


_ENTRIES = {
    "naive": _Entry(_naive, None, None),
    "box2d": _Entry(_box2d, "Box2D", "dev"),
    "mujoco": _Entry(_mujoco, "mujoco", "peers"),
}


def _is_missing(entry: _Entry) -> bool:
    return entry.package is not None and importlib.util.find_spec(entry.package) is None


def available() -> dict[str, Factory]:
    """What makes each rival whose package is installed: a function of (scene, substeps)."""
    return {name: entry.factory for name, entry in _ENTRIES.items() if not _is_missing(entry)}


def missing() -> dict[str, str]:
    """The other rivals, and what to do about it."""
    return {
        name: f"not installed (pip install -e '.[{entry.extra}]')"
        for name, entry in _ENTRIES.items()
        if _is_missing(entry)
    }


__all__ = ["Factory", "Rival", "available", "missing"]
