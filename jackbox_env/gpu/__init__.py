"""Rollouts on a GPU of NVIDIA, with the bits of the CPU: the same source, compiled to PTX, one row in each thread."""
