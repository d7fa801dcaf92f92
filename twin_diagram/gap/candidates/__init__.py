"""Which effects may explain a gap: of single joints, of the whole arm, and a user's own."""
