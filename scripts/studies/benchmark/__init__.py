"""The study of docs/benchmark.md: what policies earn, and what algorithms learn."""
