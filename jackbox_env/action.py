"""What an agent does."""

from jackbox_env.model.action import Action

__all__ = ["Action"]
