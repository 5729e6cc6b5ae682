"""Services for the rooms above: cases and their seeds, weights on disk, folders, progress on the console."""
