"""The page of the robustness protocol: who wins where, what it costs, and where each controller fails."""
