"""A step of one environment of a compiled batch, repeated by a simulator: for its impacts, or to see why it failed."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from typing import NamedTuple

import numpy as np

from jackbox_env.envs.batch import bad_action
from jackbox_env.exact.workspace import TIME, Status
from jackbox_env.model.action import ACTIONS, clipped_share
from jackbox_env.model.observation import Observation, bad_observation
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import Array, Floats
from jackbox_env.model.tasks import TaskError
from jackbox_env.simulators.agent_functions import CompiledFunctions
from jackbox_env.simulators.exact import ExactSimulator, failure
from jackbox_env.simulators.plain_functions import ControlStep, Interface


class RepeatedStep(NamedTuple):
    """An environment before a step of its batch, a decision, and what acts on it."""

    number: int
    scene: Scene
    interface: Interface
    dt: float  # control step [s]
    row: Array  # before the step, (16,)
    controls: Array | None  # the numbers of its action, (n,); None: the drive acts

    def steps(self) -> Iterator[ControlStep]:
        """Its control steps, without end."""
        simulator, functions = ExactSimulator(self.scene), CompiledFunctions(self.scene, self.interface)
        simulator.reset(self.row[:12], float(self.row[TIME]))
        torque = None
        while True:
            if self.controls is not None:
                share = float(self.controls[0])
                if self.interface.action is not ACTIONS["torque"]:
                    share = functions.share(simulator.state, self.controls, simulator.time, self.dt)
                torque = clipped_share(share) * self.scene.torque_limit
            yield functions.step_and_score(simulator, self.dt, torque, False)

    def failure(self, ended: int, made: int, observations: Floats) -> Exception:
        """The error of a batch's step that failed with the status ``ended``, after ``made`` control steps.

        ``observations``: of all environments, (N, numbers).
        """
        if ended == Status.BAD_ACTION and self.controls is not None:
            return bad_action(float(self.controls[0]), self.number)
        if ended == Status.BAD_OBSERVATION:
            return bad_numbers(self.interface.observation, observations, self.number)
        time = float(np.add.accumulate([self.row[TIME], *[self.dt] * made])[-1])
        if ended in (Status.BAD_REWARD, Status.BAD_TORQUE, Status.TOO_LATE, Status.NO_DRIVE):
            try:
                next(islice(self.steps(), made, None))
            except TaskError as error:
                return TaskError(f"{error}, in environment {self.number}")
            except Exception as error:
                return error
            return RuntimeError(
                f"the drive of environment {self.number} failed at t = {time:g} s, but not when it was called again"
            )
        return failure(ended, self.scene, time, self.dt, f"the jack of environment {self.number}")


def bad_numbers(observation: Observation, observations: Floats, number: int) -> TaskError:
    """The error for the observation of one environment, with NaN."""
    return TaskError(f"{bad_observation(observation, observations[number].tolist())}, in environment {number}")
