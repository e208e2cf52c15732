"""Runs: building, training, evaluating, resuming and loading them; shipped agents."""
