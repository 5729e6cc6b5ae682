"""Files from a rig: columns of numbers; an ambiguous file is refused."""
