"""Measurements of speed, accuracy and answers: scripts of a checkout, which README.md lists."""
