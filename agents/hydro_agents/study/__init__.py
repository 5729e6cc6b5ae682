"""A study: its settings, training and comparison of its controllers, and how it resumes."""
