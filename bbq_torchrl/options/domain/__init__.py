"""The options of ``domain=``: what the dialogues are about."""
