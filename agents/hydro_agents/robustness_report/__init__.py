"""The page of the robustness protocol: comparison by condition, costs, and worst cases of each controller."""
