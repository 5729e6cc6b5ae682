"""The best found: commands that a predictive controller finds when it is told what no controller can know."""
