"""A control step that PyTorch differentiates."""

from jackbox_env.planning.torch_step import step

__all__ = ["step"]
