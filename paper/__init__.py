"""The figures of Kovari (2015), computed again: ``python -m paper``, in a checkout."""
