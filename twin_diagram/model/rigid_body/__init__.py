"""The arm as a tree of rigid bodies: its links, joints and inertias, on many samples at once."""
