"""Recordings of many leaking axes with hidden answers come in, predictions of any program are scored."""
