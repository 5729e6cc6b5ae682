"""A study: which controllers are trained and compared, how it runs, and how it resumes."""
