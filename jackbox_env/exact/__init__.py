"""Everything that numba compiles, in the order in which data flows through it."""
