"""Films of policies side by side, as GIF or MP4."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import imageio.v3 as imageio
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from tqdm import tqdm

import jackbox_env  # noqa: F401
from agents.policies.scripted import Baseline
from agents.settings import EPISODE_STEPS
from jackbox_env.files import check_new, check_writable, new_file
from jackbox_env.render.canvas import import_pygame

Frame = NDArray[np.uint8]
SUFFIXES = (".gif", ".mp4")
WIDTH = 512  # of each picture [pixels]
_CAPTION_HEIGHT = 36  # [pixels] whatever the width: a page shows a wide film smaller


def check_film(path: Path) -> None:
    """Check, before anything is computed, that a film can be written to a file.

    Raises:
        ValueError: another suffix than .gif and .mp4.
        FileExistsError: there is something at ``path``.
        OSError: there is no such folder, or nothing can be written to it.
        gymnasium.error.DependencyNotInstalled: pygame is missing.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise ValueError(f"a film must be a .gif or .mp4 file, got {str(path)!r}")
    check_writable(path.parent)
    check_new(path)
    import_pygame()


def film_episode(acts: dict[str, Baseline], env_settings: dict[str, Any], path: Path, seed: int) -> None:
    """Film one whole episode of these policies, whose start ``seed`` decides; prints the path and the returns.

    Raises:
        FileExistsError: there is something at ``path``.
    """
    seconds = EPISODE_STEPS * float(env_settings.get("control_dt", 0.02))
    named = {Path(name).name: act for name, act in acts.items()}
    earned = film(named if len(named) == len(acts) else acts, env_settings, path, seed, seconds, WIDTH)
    print(f"Film of {', '.join(acts)}: {path}, the first episode")
    for name, one in zip(acts, earned.values(), strict=True):
        print(f"  {name}: return {one:.1f}")


def film(
    acts: dict[str, Baseline],
    env_settings: dict[str, Any],
    path: Path,
    seed: int,
    seconds: float = 10.0,
    width: int = WIDTH,
    progress: bool = True,
    begin: float = 0.0,
) -> dict[str, float]:
    """Let each policy act from the same start and write their frames side by side; return their sums of rewards.

    Args:
        acts: caption -> policy and its settings of the environment.
        env_settings: keyword arguments for ``gymnasium.make("JackInBox-v0", ...)``.
        path: .gif or .mp4; must not exist.
        seed: of the start.
        seconds: simulated time shown.
        width: of each picture [pixels].
        progress: show a progress bar.
        begin: simulated time before the first frame [s]; its rewards count.

    Raises:
        OSError, ValueError: no film can be written to ``path``.
    """
    check_film(path)
    picture: dict[str, Any] = {"render_mode": "rgb_array", "render_size": (width, width)}
    environments = {
        caption: gym.make("JackInBox-v0", **picture, **{**env_settings, **act.env_settings})
        for caption, act in acts.items()
    }
    observations = {caption: environment.reset(seed=seed)[0] for caption, environment in environments.items()}
    earned, states = dict.fromkeys(acts, 0.0), dict[str, Any].fromkeys(acts)
    control_dt = float(env_settings.get("control_dt", 0.02))
    every = max(1, round(0.04 / control_dt))  # 25 frames per second
    frames, first = [], round(begin / control_dt)
    steps = range(first + max(1, round(seconds / control_dt)))
    with tqdm(steps, desc="film", disable=not progress, unit="step", leave=False) as bar:
        for step in bar:
            if step >= first and (step - first) % every == 0:
                frames.append(_frame(environments, earned, width))
            for caption, act in acts.items():
                action, states[caption] = act.policy.predict(
                    observations[caption], states[caption], np.array([step == 0]), deterministic=True
                )
                observations[caption], reward, *_ = environments[caption].step(action)
                earned[caption] += float(reward)
    for environment in environments.values():
        environment.close()
    _write(frames, path, 1.0 / (every * control_dt), progress)
    return earned


def _frame(environments: dict[str, gym.Env[Any, Any]], earned: dict[str, float], width: int) -> Frame:
    """The pictures of all environments side by side, each with its caption and return so far."""
    pictures = [
        _captioned(environment.render(), f"{caption}: {earned[caption]:.0f}", width)
        for caption, environment in environments.items()
    ]
    return np.concatenate(pictures, axis=1)


def _captioned(picture: Any, caption: str, width: int) -> Frame:
    """The picture with a caption above it."""
    page = Image.new("RGB", (width, width + _CAPTION_HEIGHT), "white")
    page.paste(Image.fromarray(picture), (0, _CAPTION_HEIGHT))
    font = ImageFont.load_default(size=0.6 * _CAPTION_HEIGHT)
    centre = width / 2, _CAPTION_HEIGHT / 2
    ImageDraw.Draw(page).text(centre, caption, fill="#222222", font=font, anchor="mm")
    return np.asarray(page)


def _write(frames: list[Frame], path: Path, fps: float, progress: bool) -> None:
    if path.suffix.lower() == ".gif":
        # One palette for all frames keeps the background still and the file small.
        palette = _palette(np.concatenate(frames[:: max(1, len(frames) // 24)]).reshape(-1, 3))
        bar = tqdm(frames, desc=f"writing {path}", disable=not progress, unit="frame", leave=False)
        pages = (Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in bar)
        with new_file(path) as partial:
            next(pages).save(partial, save_all=True, append_images=pages, duration=round(1000.0 / fps), loop=0)
    else:
        with new_file(path) as partial:
            imageio.imwrite(partial, np.stack(frames), fps=fps, codec="libx264", macro_block_size=4)


def _palette(pixels: Frame) -> Image.Image:
    """A palette of 256 colours: the widest areas' own, and others so that small things (flash, gauge) keep theirs."""
    packed = pixels @ np.array([1 << 16, 1 << 8, 1], np.uint32)  # colours as whole numbers
    areas = np.bincount(packed, minlength=1 << 24)
    numbers = np.flatnonzero(areas)
    colours = np.stack([numbers >> 16, numbers >> 8 & 255, numbers & 255], axis=1).astype(np.uint8)
    widest = colours[np.argsort(areas[numbers], kind="stable")[-32:]]
    spread = Image.fromarray(colours[None]).quantize(256 - len(widest), method=Image.Quantize.MEDIANCUT)
    palette = Image.new("P", (1, 1))
    palette.putpalette(widest.ravel().tolist() + (spread.getpalette() or []))
    return palette
