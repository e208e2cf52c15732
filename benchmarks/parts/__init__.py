"""What the benchmarks share: the yardstick, the things measured, and how times are compared."""
