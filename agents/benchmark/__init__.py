"""``hydro benchmark``: speed, memory and start-up of everything here, with peers in turn, as one table."""
