"""The robustness protocol: every controller under every condition, as independent jobs, with statistics and tables."""
