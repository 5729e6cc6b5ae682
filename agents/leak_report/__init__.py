"""The page of the leakage protocol: how small a leak is seen, how early, how surely, and when nothing can be said."""
