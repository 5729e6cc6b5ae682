"""What is drawn and written from results: figures, numbers, sentences, pages."""
