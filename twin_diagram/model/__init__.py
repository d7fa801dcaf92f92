"""The arm's physics: its description, rigid bodies, named effects, and what they predict together."""
