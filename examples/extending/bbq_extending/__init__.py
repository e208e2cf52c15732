"""Options for bbq-torchrl: a strategy, an agent, an intrinsic reward and an environment."""
