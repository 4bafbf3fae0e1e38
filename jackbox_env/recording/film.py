"""Films, as GIF or MP4; they need the extra video."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from jackbox_env.recording.motion import Motion
from jackbox_env.recording.samples import samples_of
from jackbox_env.render.canvas import SIZE, import_pygame
from jackbox_env.render.renderer import Renderer
from jackbox_env.tools import checks as check
from jackbox_env.tools.command_line import bar
from jackbox_env.tools.files import check_new_file, new_file

if TYPE_CHECKING:
    from PIL import Image

Frame = NDArray[np.uint8]
SUFFIXES = (".gif", ".mp4")
_SPACING = 0.04  # of frames [s]


def check_film(path: Path) -> None:
    """Check, before anything is computed, that a film can be written to a file.

    Raises:
        ValueError: another suffix than .gif and .mp4.
        FileExistsError: there is something at ``path``.
        OSError: there is no such folder, or nothing can be written to it.
        ImportError: the extra video is missing.
        gymnasium.error.DependencyNotInstalled: pygame is missing.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise ValueError(f"a film must be a .gif or .mp4 file, got {str(path)!r}")
    check_new_file(path)
    import_pygame()
    _library("PIL.Image" if path.suffix.lower() == ".gif" else "imageio_ffmpeg")


def film_motion(motion: Motion, path: Path, progress: bool = False) -> Path:
    """Write a motion as a film of 25 frames per second to a new file, with a bar if ``progress``.

    Raises:
        OSError, ValueError, ImportError: as :func:`check_film`.
    """
    check_film(path)
    samples, renderer = samples_of(motion), Renderer(motion.scene, "rgb_array", 1.0 / _SPACING, size=(SIZE, SIZE))
    renderer.reset(motion.states[0], float(motion.t[0]))
    moments = np.arange(motion.t[0], motion.t[-1] + 0.5 * _SPACING, _SPACING)
    hits, frames, shown = motion.hits, list[Frame](), 0
    with bar(len(moments), progress, "frame") as moved:
        for moment in moments:
            index = int(np.searchsorted(samples.times, moment + 1e-9, "right")) - 1
            count = int(np.searchsorted(motion.impacts["time"], samples.times[index], "right"))
            state, time, torque = samples.states[index], float(samples.times[index]), float(samples.torques[index])
            renderer.record(state, time, torque, hits[shown:count])
            frames.append(renderer.drawn())
            shown = count
            moved(1)
    renderer.close()
    write_film(frames, path, 1.0 / _SPACING, progress)
    return path


def write_film(frames: list[Frame], path: Path, fps: float, progress: bool = False) -> None:
    """Write frames to a new file, with a bar if ``progress``."""
    with new_file(path) as partial, bar(len(frames), progress, "frame") as moved:
        if path.suffix.lower() == ".gif":
            # One palette for all frames keeps the background still and the file small.
            palette = _palette(np.concatenate(frames[:: max(1, len(frames) // 24)]).reshape(-1, 3))
            pages = _pages(frames, palette, moved)
            next(pages).save(partial, save_all=True, append_images=pages, duration=round(1000.0 / fps), loop=0)
        else:
            imageio = _library("imageio.v3")
            imageio.imwrite(partial, np.stack(frames), fps=fps, codec="libx264", macro_block_size=4)


def _pages(frames: list[Frame], palette: Image.Image, moved: Callable[[int], object]) -> Iterator[Image.Image]:
    """The frames in the colours of a palette."""
    from PIL import Image

    for frame in frames:
        moved(1)
        yield Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE)


def _palette(pixels: Frame) -> Image.Image:
    """A palette of 256 colours: the widest areas' own, and others so that small things (flash, gauge) keep theirs."""
    from PIL import Image

    packed = pixels @ np.array([1 << 16, 1 << 8, 1], np.uint32)  # colours as whole numbers
    areas = np.bincount(packed, minlength=1 << 24)
    numbers = np.flatnonzero(areas)
    colours = np.stack([numbers >> 16, numbers >> 8 & 255, numbers & 255], axis=1).astype(np.uint8)
    widest = colours[np.argsort(areas[numbers], kind="stable")[-32:]]
    spread = Image.fromarray(colours[None]).quantize(256 - len(widest), method=Image.Quantize.MEDIANCUT)
    palette = Image.new("P", (1, 1))
    palette.putpalette(widest.ravel().tolist() + (spread.getpalette() or []))
    return palette


def _library(module: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ImportError(check.extra_needed("a film", module.partition(".")[0], "video")) from error
