"""What is rewarded."""

from jackbox_env.model.tasks import Task, TaskError, task_of

__all__ = ["Task", "TaskError", "task_of"]  # the last one: pickles name it
