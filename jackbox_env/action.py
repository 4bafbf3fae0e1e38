"""What an agent does."""

from jackbox_env.model.action import Action, action_of

__all__ = ["Action", "action_of"]  # the last one: pickles name it
