"""Runs: built, trained, evaluated, their folders, resumed and loaded, and the shipped agents."""
