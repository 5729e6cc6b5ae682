"""The challenge for leak detectors.

In comes a size and perhaps a secret key, later predictions or a program; out go recordings of drawn axes with
nameplates and hidden labels, and the score with its page. Open ``axes.py`` first: it says what a recording draws.
"""
