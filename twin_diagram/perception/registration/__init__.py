"""From segments to poses: known objects are recognised, registered and tracked."""
