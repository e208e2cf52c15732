"""The options of ``env=``: whom the agent talks with."""
