"""Services for all packages: cases and their seeds, weights on disk, folders, progress on the console."""
