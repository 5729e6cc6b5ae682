"""``hydro benchmark``: speed, memory and start-up of this package and of comparable ones, as one table."""
