"""Everything that acts on the servo axis or watches it: controllers, learning, leakage detection, evaluation."""
