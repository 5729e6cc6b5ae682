"""Presentation of results: figures, numbers, sentences, pages.

Comes in: the tables of a run by the names of their CSV files (``content.Content``). Goes out: one HTML page with its
figures. Open ``sections.py`` first: a page is a list of sections, each a function from content to blocks.
"""
