"""Dialogue state, success and beliefs: the parts that chat and study share."""
