"""What the paper shows, computed again: one picture and one table per figure, and a page that sets them beside it."""
