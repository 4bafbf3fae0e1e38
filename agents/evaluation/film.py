"""Films of policies side by side, as GIF or MP4."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import gymnasium as gym
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from agents.evaluation.episodes import control_steps
from agents.policies.scripted import PolicyWithEnv
from jackbox_env import JackInBoxEnv
from jackbox_env.recording.film import Frame, check_film, write_film
from jackbox_env.render.renderer import Renderer
from jackbox_env.tools.command_line import bar

WIDTH = 512  # of each picture [pixels]
_CAPTION_HEIGHT = 36  # [pixels] whatever the width: a page shows a wide film smaller


def film_episode(acts: dict[str, PolicyWithEnv], env_settings: dict[str, Any], path: Path, seed: int) -> None:
    """Film a whole episode of these policies, whose start ``seed`` decides.

    Prints the path and the returns.

    Args:
        acts: policies by name.
        env_settings: as :func:`.provenance.shared_environment` returns them.
        path: of the film.
        seed: of the start.

    Raises:
        FileExistsError: there is something at ``path``.
    """
    seconds = env_settings["episode_steps"] * env_settings["control_dt"]
    named = {Path(name).name: act for name, act in acts.items()}
    named = named if len(named) == len(acts) else acts
    earned = film(named, env_settings, path, seed, seconds, WIDTH)
    print(f"Film of {', '.join(acts)}: {path}, the first episode")
    for name, one in zip(acts, earned.values(), strict=True):
        print(f"  {name}: return {one:.1f}")


def film(
    acts: dict[str, PolicyWithEnv],
    env_settings: dict[str, Any],
    path: Path,
    seed: int,
    seconds: float = 10.0,
    width: int = WIDTH,
    progress: bool = True,
    begin: float = 0.0,
) -> dict[str, float]:
    """Let each policy act from the same start and write their frames side by side; return their returns.

    Args:
        acts: caption -> policy and its keywords of the environment. A picture stands still when its episode is over.
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
    control_dt = float(env_settings.get("control_dt", 0.02))
    every = max(1, round(0.04 / control_dt))  # 25 frames per second
    shown = [_Shown(caption, acting, env_settings, seed, width) for caption, acting in acts.items()]
    frames, first = [], round(begin / control_dt)
    steps = range(first + max(1, round(seconds / control_dt)))
    with bar(len(steps), progress) as moving:
        for step in steps:
            if step >= first and (step - first) % every == 0:
                frames.append(np.concatenate([one.picture() for one in shown], axis=1))
            for one in shown:
                one.advance((step + 1) * control_dt)
            moving.update(1)
    write_film(frames, path, 1.0 / (every * control_dt))
    return {one.caption: one.earned for one in shown}


class _Shown:
    """An episode of a policy that is filmed."""

    def __init__(
        self, caption: str, acting: PolicyWithEnv, env_settings: dict[str, Any], seed: int, width: int
    ) -> None:
        env = gym.make("JackInBox-v0", **{**env_settings, **acting.keywords})
        observation, info = env.reset(seed=seed)
        inner = cast(JackInBoxEnv, env.unwrapped)
        self.caption, self.earned, self._width, self._time = caption, 0.0, width, info["time"]
        self._steps = control_steps(env, acting, observation)
        name = inner.task if isinstance(inner.task, str) else ", ".join(inner.task.terms)
        fps = inner.metadata["render_fps"]
        self._renderer = Renderer(inner.scene, "rgb_array", fps, name, (width, width), True)
        self._renderer.reset(info["state"], self._time)

    def advance(self, time: float) -> None:
        """Go on to this time [s], or to the episode's end."""
        while self._time < time - 1e-9 and (step := next(self._steps, None)) is not None:
            self._time = step.time
            self.earned += step.reward
            self._renderer.record(step.state, step.time, step.torque, step.impacts, step.reward)

    def picture(self) -> Frame:
        """The present picture, with its caption and the return so far."""
        return _captioned(self._renderer.drawn(), f"{self.caption}: {self.earned:.0f}", self._width)


def _captioned(picture: Any, caption: str, width: int) -> Frame:
    """The picture with a caption above it."""
    page = Image.new("RGB", (width, width + _CAPTION_HEIGHT), "white")
    page.paste(Image.fromarray(picture), (0, _CAPTION_HEIGHT))
    font = ImageFont.load_default(size=0.6 * _CAPTION_HEIGHT)
    centre = width / 2, _CAPTION_HEIGHT / 2
    ImageDraw.Draw(page).text(centre, caption, fill="#222222", font=font, anchor="mm")
    return np.asarray(page)
