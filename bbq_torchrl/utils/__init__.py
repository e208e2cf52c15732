"""Utilities for every room: messages, output, signals, files, seeds, statistics, reports."""
