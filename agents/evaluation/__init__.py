"""Proof: the robustness protocol, control metrics, statistics, report."""
