"""Scenes and their drives."""

from jackbox_env.model.scene import Chirp, Drive, Scene, SceneNumbers

__all__ = ["Chirp", "Drive", "Scene", "SceneNumbers"]
