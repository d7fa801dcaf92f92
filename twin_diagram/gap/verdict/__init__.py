"""What a search's outcome allows to say: where, how sure, and what else could be."""
