"""The arm's own links as cameras and lidars see them, made into measurements of their poses."""
