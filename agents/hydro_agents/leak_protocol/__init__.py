"""The leakage protocol: every detector under every condition, as independent jobs, with statistics and tables."""
