"""Presentation of results: figures, numbers, sentences, pages."""
