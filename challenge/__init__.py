"""The challenge for leak detectors: recordings of drawn axes with hidden labels, the score of a table, and entries."""
