"""What every real arm lacks at once: all links' inertia, and friction, offset and rotor of every joint."""
