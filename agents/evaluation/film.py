"""Films of policies side by side, as GIF or MP4."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, cast

import gymnasium as gym
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from agents.evaluation.episodes import control_steps
from agents.policies.scripted import PolicyWithEnv
from jackbox_env import JackInBoxEnv
from jackbox_env.envs.decisions import ControlStep
from jackbox_env.recording.film import Frame, check_film, write_film
from jackbox_env.render.renderer import GAP, Renderer, tiled
from jackbox_env.tools.command_line import bar

WIDTH = 512  # of each picture [pixels]
_CAPTION_HEIGHT = 36  # [pixels] whatever the width: a page shows a wide film smaller


def film_episode(
    acts: dict[str, PolicyWithEnv], env_settings: dict[str, Any], path: Path, seed: int, count: int = 1
) -> None:
    """Film the first ``count`` whole episodes of these policies, whose starts ``seed`` decides, as one picture each.

    Prints the path and the returns.

    Args:
        acts: policies by name.
        env_settings: as :func:`.provenance.shared_environment` returns them.
        path: of the film.
        seed: of the first start.
        count: of the episodes.

    Raises:
        FileExistsError: there is something at ``path``.
    """
    seconds = env_settings["episode_steps"] * env_settings["control_dt"]
    named = {Path(name).name: act for name, act in acts.items()}
    named = named if len(named) == len(acts) else acts
    earned = film(named, env_settings, path, seed, seconds, WIDTH, count=count)
    print(f"Film of {', '.join(acts)}: {path}, the first {'episode' if count == 1 else f'{count} episodes'}")
    for name, one in zip(acts, earned.values(), strict=True):
        print(f"  {name}: {'return' if count == 1 else 'mean return'} {one:.1f}")


def film(
    acts: dict[str, PolicyWithEnv],
    env_settings: dict[str, Any],
    path: Path,
    seed: int,
    seconds: float = 10.0,
    width: int = WIDTH,
    progress: bool = True,
    begin: float = 0.0,
    count: int = 1,
) -> dict[str, float]:
    """Let each policy act from the same starts and write their frames side by side; return their mean returns.

    Args:
        acts: caption -> policy and its keywords of the environment. A picture stands still when its episode is over.
        env_settings: keyword arguments for ``gymnasium.make("JackInBox-v0", ...)``.
        path: .gif or .mp4; must not exist.
        seed: of the first start; the others follow.
        seconds: simulated time shown.
        width: of each picture [pixels].
        progress: show a progress bar.
        begin: simulated time before the first frame [s]; its rewards count.
        count: episodes of each policy; several are tiles of its picture, without readings.

    Raises:
        OSError, ValueError: no film can be written to ``path``.
    """
    check_film(path)
    control_dt = float(env_settings.get("control_dt", 0.02))
    every = max(1, round(0.04 / control_dt))  # 25 frames per second
    seeds = range(seed, seed + count)
    shown = [_Shown(caption, acting, env_settings, seeds, width) for caption, acting in acts.items()]
    frames, first = [], round(begin / control_dt)
    steps = range(first + max(1, round(seconds / control_dt)))
    with bar(len(steps), progress) as moved:
        for step in steps:
            if step >= first and (step - first) % every == 0:
                frames.append(np.concatenate([one.picture() for one in shown], axis=1))
            for one in shown:
                one.advance((step + 1) * control_dt)
            moved(1)
    write_film(frames, path, 1.0 / (every * control_dt), progress)
    return {one.caption: one.earned for one in shown}


class _Shown:
    """One or several episodes of a policy that are filmed."""

    def __init__(
        self, caption: str, acting: PolicyWithEnv, env_settings: dict[str, Any], seeds: Sequence[int], width: int
    ) -> None:
        self._episodes = [_Episode(acting, env_settings, seed) for seed in seeds]
        self.caption, self._width, self._renderer = caption, width, None
        if len(seeds) == 1:
            (one,) = self._episodes
            name = one.env.task if isinstance(one.env.task, str) else ", ".join(one.env.task.terms)
            fps = one.env.metadata["render_fps"]
            self._renderer = Renderer(one.env.scene, "rgb_array", fps, name, (width, width), True)
            self._renderer.reset(one.state, one.time)

    @property
    def earned(self) -> float:
        """Mean return so far."""
        return sum(episode.earned for episode in self._episodes) / len(self._episodes)

    def advance(self, time: float) -> None:
        """Go on to this time [s], or to the episodes' ends."""
        for episode in self._episodes:
            for step in episode.until(time):
                if self._renderer is not None:
                    self._renderer.record(step.state, step.time, step.torque, step.impacts, step.reward)

    def picture(self) -> Frame:
        """The present picture, with its caption and the return so far."""
        if self._renderer is not None:
            frame = self._renderer.drawn()
        else:
            side = max(16, (self._width + GAP) // math.ceil(math.sqrt(len(self._episodes))) - GAP)
            states = np.array([episode.state for episode in self._episodes])
            times = np.array([episode.time for episode in self._episodes])
            frame = tiled([episode.env.scene for episode in self._episodes], states, times, (side, side))
        return _captioned(frame, f"{self.caption}: {self.earned:.0f}", self._width)


class _Episode:
    """An episode of a policy, and its present state."""

    def __init__(self, acting: PolicyWithEnv, env_settings: dict[str, Any], seed: int) -> None:
        env = gym.make("JackInBox-v0", **{**env_settings, **acting.keywords})
        observation, info = env.reset(seed=seed)
        self.env, self.state, self.time = cast(JackInBoxEnv, env.unwrapped), info["state"], info["time"]
        self.earned, self._steps = 0.0, control_steps(env, acting, observation)

    def until(self, time: float) -> Iterator[ControlStep]:
        """The control steps up to this time [s], or to the episode's end."""
        while self.time < time - 1e-9 and (step := next(self._steps, None)) is not None:
            self.state, self.time = step.state, step.time
            self.earned += step.reward
            yield step


def _captioned(picture: Any, caption: str, width: int) -> Frame:
    """The picture with a caption above it."""
    page = Image.new("RGB", (width, width + _CAPTION_HEIGHT), "white")
    page.paste(Image.fromarray(picture), (0, _CAPTION_HEIGHT))
    font = ImageFont.load_default(size=0.6 * _CAPTION_HEIGHT)
    centre = width / 2, _CAPTION_HEIGHT / 2
    ImageDraw.Draw(page).text(centre, caption, fill="#222222", font=font, anchor="mm")
    return np.asarray(page)
