"""A study: its settings, the training and comparison of its controllers, and its resumption."""
