"""Evaluation of trained agents: dialogues, statistics over seeds, tables and figures."""
