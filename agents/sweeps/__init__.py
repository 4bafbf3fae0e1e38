"""Many trainings and evaluations, in this process or on Ray."""
