"""The options of ``intrinsic=``: a reward of the agent's own."""
