"""Scores what `twin-diagram gap` said of a case against what is true of it: the only code that opens truth files."""
