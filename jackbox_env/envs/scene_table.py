"""The scenes of a batch of the exact contact model: one for all environments, or one for each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from jackbox_env.exact.glide import write_scene_params
from jackbox_env.exact.workspace import SCENE_PARAMS, Scenes
from jackbox_env.jit.compiler import compiled
from jackbox_env.model.scene import Chirp, Drive, Scene, SceneNumbers
from jackbox_env.model.states import Array, Counts, Flags
from jackbox_env.simulators.exact import NO_PIECES, WITH_PIECES, cut, drive_kind

AnyDrive = Chirp | Drive | None

_FIELDS = tuple(part.name for part in fields(Scene) if part.name in SceneNumbers._fields)
_RESTITUTION = SceneNumbers._fields.index("restitution")
_COLUMNS = [SceneNumbers._fields.index(name) for name in _FIELDS]


class SceneTable:
    """Scenes as numbers. Rows change in place.

    Args:
        originals: the scenes that environments were made with, one for all or one each.
        several: whether each environment has its own row.
        shape: blocks, 16, width of the environments.
        count: environments.
        dt: control step [s].
    """

    def __init__(
        self, originals: Sequence[Scene], several: bool, shape: tuple[int, ...], count: int, dt: float
    ) -> None:
        self.originals, self.dt, self.count = originals, dt, count
        self._made_with: Array = np.array([scene.numbers for scene in originals])  # never changed
        rows = self._made_with.copy()
        self.drives: list[AnyDrive] = [scene.drive for scene in originals]
        if several and len(originals) < count:
            rows, self.drives = np.repeat(rows, count, axis=0), self.drives * count
        self.values: Array = rows  # (1 or N, numbers of a scene)
        self.scene_params: Array = np.zeros((shape[0] if several else 1, SCENE_PARAMS, shape[2]))
        compiled(write_scene_params)(self.values, dt, self.scene_params, np.arange(count if several else shape[2]))
        self._derive_kinds()

    @property
    def lossy(self) -> bool:
        """Whether a restitution is below 1."""
        return bool((self.values[:, _RESTITUTION] < 1.0).any())

    def _derive_kinds(self) -> None:
        # Of each environment, or of all: whether its drive is not the original one; what turns the box under the drive
        # and under a constant torque. And whether functions of any are cut into pieces then.
        self.driven_otherwise: Flags = np.array(
            [drive is not self.original_of(number).drive for number, drive in enumerate(self.drives)]
        )
        self.drive_kinds: list[Counts] = [
            np.array([drive_kind(drive, held) for drive in self.drives], dtype=np.int64) for held in (False, True)
        ]
        self.cutting = [bool(np.isin(kinds, WITH_PIECES).any()) for kinds in self.drive_kinds]
        # For steps that need no pieces: the same object until kinds change.
        self.plain = [Scenes(self.values, self.scene_params, kinds, *NO_PIECES) for kinds in self.drive_kinds]

    def spread_out(self, shape: tuple[int, ...]) -> SceneTable:
        """This table with a row for each environment."""
        if self.several or self.count == 1:
            return self
        twin = SceneTable(self.originals, True, shape, self.count, self.dt)
        twin.set_scenes(np.arange(self.count), [self.scene(0)] * self.count)
        return twin

    @property
    def several(self) -> bool:
        """Whether each environment has its own row."""
        return len(self.values) > 1

    def original_of(self, number: int) -> Scene:
        """The scene that an environment was made with."""
        return self.originals[number if len(self.originals) > 1 else 0]

    def original_rows(self, numbers: Counts) -> Array:
        """The numbers of the scenes that some environments were made with, a row each, to be changed."""
        return self._made_with[numbers if len(self.originals) > 1 else np.zeros(len(numbers), dtype=np.int64)]

    def column(self, name: str) -> Array:
        """A field of the scenes, shape (1,) or (N,)."""
        column: Array = self.values[:, SceneNumbers._fields.index(name)]
        return column

    def rows(self, numbers: Counts) -> Array:
        """A copy of the rows of some environments; of the only row if they share a scene."""
        return self.values[numbers] if self.several else self.values.copy()

    def of_steps(self, torque: int, times: Array, steps: Counts, ahead: int) -> Scenes:
        """The scenes with the pieces of drives of functions, cut once for each drive, time and number of steps.

        A drive has no pieces from ``ahead`` steps on, nor over a later step that it fails over.

        Args:
            torque: 1 if torques are held, 0 if the drives act.
            times: at which the environments are [s], (N,).
            steps: that each of them makes at most, (N,).
            ahead: steps for which pieces are cut, at most.

        Raises:
            Exception: a drive fails over a first step.
        """
        pieces = cut(self.drives, self.drive_kinds[torque], times, steps, self.dt, 0.0 if torque else None, ahead)
        return Scenes(self.values, self.scene_params, self.drive_kinds[torque], *pieces)

    def set_scenes(self, numbers: Counts, scenes: Array | list[Scene]) -> None:
        """Set the scenes of some environments, or the one of all. Rows have their numbers; they leave the drives."""
        if isinstance(scenes, list):
            for number, scene in zip(numbers.tolist() if self.several else [0], scenes, strict=False):
                self.drives[number] = scene.drive
            self._derive_kinds()
            scenes = np.array([scene.numbers for scene in scenes])
        if self.several:
            self.values[numbers] = scenes
        else:
            self.values[0], scenes, numbers = scenes[0], scenes[:1], np.arange(self.scene_params.shape[2])
        compiled(write_scene_params)(scenes, self.dt, self.scene_params, numbers)

    def scene(self, number: int) -> Scene:
        """The scene that an environment has."""
        return self.scene_of(number, self.values[number if self.several else 0])

    def scene_of(self, number: int, row: Array) -> Scene:
        """The scene that an environment has with the numbers of ``row``."""
        original, drive = self.original_of(number), self.drives[number if self.several else 0]
        numbers: dict[str, Any] = dict(zip(_FIELDS, row[_COLUMNS].tolist(), strict=True))
        changed = {name: value for name, value in numbers.items() if value != getattr(original, name)}
        if drive is not original.drive:
            changed["drive"] = drive
        if not changed:
            return original
        follows = original.changed(**{name: value for name, value in changed.items() if name not in original.derived})
        inertias = {name: numbers[name] for name in original.derived if numbers[name] != getattr(follows, name)}
        return follows.changed(**inertias) if inertias else follows
