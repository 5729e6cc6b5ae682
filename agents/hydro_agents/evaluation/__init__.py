"""Evaluation: the robustness protocol, control metrics, statistics."""
