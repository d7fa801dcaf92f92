"""Things that no library knows: found in what nothing explains, remembered, and held by convex pieces."""
