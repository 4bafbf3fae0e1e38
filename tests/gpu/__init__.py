"""Code for a GPU, run without one."""
