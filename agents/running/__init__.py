"""What everything above needs: cases and their seeds, weights on disk, folders, progress on the console."""
