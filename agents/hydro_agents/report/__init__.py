"""Presentation of results: pages with tables and figures.

Comes in: data frames, by the names of their CSV files. Goes out: one HTML page. Open ``kit.py`` first: a page is built
from headings, verdicts, tables and figures, from the top down.
"""
