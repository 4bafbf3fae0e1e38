"""What is rewarded."""

from jackbox_env.model.tasks import Task, TaskError

__all__ = ["Task", "TaskError"]
