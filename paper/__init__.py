"""The figures of Kovari (2015), computed again: ``hydro reproduce`` or ``python -m paper``, in a checkout."""
