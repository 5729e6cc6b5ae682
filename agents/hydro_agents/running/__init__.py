"""What every computation needs: cases and seeds, jobs side by side, statistics, weights on disk, folders, console.

Comes in: a controller, or a function with arguments; goes out: trajectories, and results that do not depend on where
and in which order they were computed. Open ``cases.py`` first (a controller on episodes), then ``jobs.py``.
"""
