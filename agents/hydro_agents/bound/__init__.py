"""The best found: commands of a predictive controller that knows the plant's true state."""
