"""What a display truly shows of a mesh, by casting rays."""
