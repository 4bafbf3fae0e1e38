"""What is modelled, in pure functions: scene, state, mechanics, tasks, observations, actions, landings."""
