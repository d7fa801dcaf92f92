"""What joins bodies and effects to one torque law: gears, dry friction, backlash, onsets."""
