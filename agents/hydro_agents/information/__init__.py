"""Information of the measured signals about a leak: the Cramér–Rao bound as tables, and the move that lowers it."""
