"""The command lines: configurations composed by Hydra, checked, and what they run."""
