"""Tests of the documentation: what it shows runs, and what it says is so."""
