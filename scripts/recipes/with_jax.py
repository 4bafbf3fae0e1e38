"""JAX differentiates the exact model: torques that throw the jack to the middle of the box."""

import jax
import jax.numpy as jnp
import numpy as np

from jackbox_env import Linearization, Scene, linearize
from jackbox_env.model.states import THETA_JACK, X_BOX, X_JACK, Y_BOX, Y_JACK

jax.config.update("jax_enable_x64", True)
SCENE, DT, REPEAT = Scene(drive=None), 0.02, 10


def linearized(states: jax.Array, torques: jax.Array) -> Linearization:
    """Ten torques in shares of the limit, each repeated for 10 steps of 0.02 s."""
    scaled = np.asarray(torques) * SCENE.torque_limit
    return linearize(SCENE, np.asarray(states), scaled, DT, repeat=REPEAT)


def pulled_back(
    states: jax.Array, torques: jax.Array, g: jax.Array
) -> tuple[np.ndarray, np.ndarray]:
    """The gradient by states and torques."""
    by_states, by_torques, _ = linearized(states, torques).vjp(np.asarray(g))
    return by_states, by_torques * SCENE.torque_limit


@jax.custom_vjp  # type: ignore[untyped-decorator]
def trajectories(states: jax.Array, torques: jax.Array) -> jax.Array:
    """All states, (n, 101, 12), from first states, (n, 12), under torques, (n, 10)."""
    shape = jax.ShapeDtypeStruct((len(states), 1 + REPEAT * torques.shape[1], 12), states.dtype)
    return jax.pure_callback(lambda *two: linearized(*two).trajectories, shape, states, torques)


trajectories.defvjp(
    lambda states, torques: (trajectories(states, torques), (states, torques)),
    lambda inputs, g: jax.pure_callback(pulled_back, inputs, *inputs, g),
)


def distances(torques: jax.Array) -> jax.Array:
    """Distance of the jack from the middle of the box at the end [m]."""
    starts = jnp.zeros((8, 12)).at[:, X_JACK].set(jnp.linspace(0.3, 1.0, 8))
    starts = starts.at[:, THETA_JACK].set(0.1)
    end = trajectories(starts, torques)[:, -1]
    return jnp.hypot(end[:, X_JACK] - end[:, X_BOX], end[:, Y_JACK] - end[:, Y_BOX])


improve = jax.jit(jax.grad(lambda torques: distances(torques).sum()))
torques = jnp.zeros((8, 10))
print("distances without torque [m]:", np.round(distances(torques), 2))
for number in range(200):
    gradient = improve(torques)
    torques -= 0.05 * 0.98**number * gradient / jnp.linalg.norm(gradient, axis=1, keepdims=True)
print("distances after 200 steps [m]:", np.round(distances(torques), 2))
