"""Measurements of speed and accuracy: the modules of ``hydro benchmark``, and scripts; see README.md."""
