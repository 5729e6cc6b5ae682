"""A study: a protocol whose controllers are tuned and trained before they are compared.

Comes in: a YAML file (``settings.py``); goes out: weights, gains, and the results of the comparison. Open ``run.py``
first; ``training.py`` shows the progress of each training, and trains the leakage head too.
"""
