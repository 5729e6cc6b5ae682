"""The figures of the paper, computed again: a picture and a table per figure, and a page that compares them."""
