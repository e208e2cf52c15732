"""Evaluation of finished runs: results, comparisons over seeds, tables and figures."""
