"""Films, as GIF or MP4; they need the extra video."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from jackbox_env.recording.motion import Motion
from jackbox_env.recording.samples import samples_of
from jackbox_env.render.canvas import SIZE, import_pygame
from jackbox_env.render.renderer import Renderer
from jackbox_env.tools import checks as check
from jackbox_env.tools.command_line import bar
from jackbox_env.tools.files import check_new_file, new_file

Frame = NDArray[np.uint8]
SUFFIXES = (".gif", ".mp4")
_SPACING = 0.04  # of frames [s]
_VIDEO = "a film", "imageio_ffmpeg", "video"


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
    with check.extra(*_VIDEO):
        import imageio_ffmpeg  # type: ignore[import-untyped]  # noqa: F401


def film_motion(motion: Motion, path: Path) -> None:
    """Write a motion as a film of 25 frames per second to a new file that :func:`check_film` accepts, with a bar."""
    samples, renderer = samples_of(motion), Renderer(motion.scene, "rgb_array", 1.0 / _SPACING, size=(SIZE, SIZE))
    renderer.reset(motion.states[0], float(motion.t[0]))
    moments = np.arange(motion.t[0], motion.t[-1] + 0.5 * _SPACING, _SPACING)
    hits, frames, shown = motion.hits, list[Frame](), 0
    with bar(len(moments), True, "frame") as moving:
        for moment in moments:
            index = int(np.searchsorted(samples.times, moment + 1e-9, "right")) - 1
            count = int(np.searchsorted(motion.impacts["time"], samples.times[index], "right"))
            state, time, torque = samples.states[index], float(samples.times[index]), float(samples.torques[index])
            renderer.record(state, time, torque, hits[shown:count])
            frames.append(renderer.drawn())
            shown = count
            moving.update(1)
    renderer.close()
    write_film(frames, path, 1.0 / _SPACING)


def write_film(frames: list[Frame], path: Path, fps: float) -> None:
    """Write frames to a new file."""
    with new_file(path) as partial, check.extra(*_VIDEO):
        import imageio.v3
        from PIL import Image

        if path.suffix.lower() == ".gif":
            # One palette for all frames keeps the background still and the file small.
            palette = Image.fromarray(np.concatenate(frames[:: max(1, len(frames) // 24)])).quantize()
            first, *others = (
                Image.fromarray(one).quantize(palette=palette, dither=Image.Dither.NONE) for one in frames
            )
            first.save(partial, save_all=True, append_images=others, duration=round(1000.0 / fps), loop=0)
        else:
            imageio.v3.imwrite(partial, np.stack(frames), fps=fps, codec="libx264", macro_block_size=4)
