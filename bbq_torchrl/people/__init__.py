"""Dialogues with people: language, dialogue, chat and study.

``language`` turns sentences into acts and back, ``dialogue`` holds what chat and study share,
``chat`` talks in the terminal, and ``study`` has people talk with agents and rate them.
"""
