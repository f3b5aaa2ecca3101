"""What holds of the source as a whole: imports, docstrings, words, names."""
