"""Shared parts of the benchmarks: the baseline, the measurements, and comparisons of times."""
