"""How much the measured signals tell about a leak: the Cramér–Rao bound as tables, and the move that lowers it."""
